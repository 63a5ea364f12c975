"""How far the parts' surface is from the mesh, and whether pieces, mesh and parts can be one object.

The former is the symmetric Hausdorff distance, by sampling.
"""

from __future__ import annotations

from collections.abc import Sequence

import manifold3d
import numpy as np

from cluttergen_jax.assets.cloud import sample_exposed, sample_solid
from cluttergen_jax.assets.config import ALARM_FACTOR
from cluttergen_jax.assets.mesh import Mesh, join_meshes
from cluttergen_jax.assets.parts import heights_over, hull_of, sound_points
from cluttergen_jax.assets.solid import Solid, Voxels

NUM_SAMPLES = 10_000
_DENSITY = 20
# Cells along the longest side: gaps of up to two of them, 1.4 % of it, count as closed.
_FINE = 144


def is_within_parts(points: np.ndarray, parts: Sequence[np.ndarray]) -> np.ndarray:
    """bool[N]: whether points lie in one of the convex parts."""
    inside = np.zeros(len(points), bool)
    for hull in map(hull_of, parts):
        if hull is None:
            continue
        near = np.flatnonzero(
            ((points >= hull.min_bound) & (points <= hull.max_bound)).all(1) & ~inside
        )
        inside[near] = heights_over(points[near], hull).max(1, initial=-np.inf) < 0
    return inside


def deviation(parts: Sequence[np.ndarray], solid: Solid, seed: int = 0) -> float:
    """Symmetric Hausdorff distance between parts and mesh, 10,000 samples each way, over the diagonal.

    Each sample's distance is taken to the nearest of 200,000 points of the other surface, which can only
    make it larger than it is. Faces along which pieces or parts touch, or nearly so, are no surface: nothing
    can get there.
    """
    dense = NUM_SAMPLES * _DENSITY
    on_solid = sample_solid(solid, dense, seed)
    hulls = [hull for hull in map(hull_of, parts) if hull is not None]
    surface = join_meshes([Mesh(hull.points, hull.simplices) for hull in hulls])
    on_parts = sample_exposed(surface, dense, seed + 1000, is_convex=len(parts) == 1)
    some = on_solid[:NUM_SAMPLES]
    there = _farthest(some, on_parts)
    back = _farthest(on_parts[:NUM_SAMPLES], on_solid)
    if solid.is_exact and there > back:
        # Pieces that only touch are united with a gap between them, which nothing can enter.
        is_outer = Voxels.of(solid.mesh, _FINE).is_exposed(some)
        there = there if is_outer.all() else _farthest(some[is_outer], on_parts)
    return float(max(there, back) / solid.diagonal)


def _farthest(points: np.ndarray, others: np.ndarray) -> float:
    """The largest distance from one of the points to the nearest of the others, metres.

    A few of the others tell of most points that they are not the farthest one.
    """
    from scipy.spatial import cKDTree

    if not len(points):
        return 0.0
    bound = np.full(len(points), np.inf)
    largest = 0.0
    start = 0
    for end in (len(others) // 10, len(others) // 3, len(others)):
        # Asked so little, a tree that is made quickly is the quicker one.
        tree = cKDTree(others[start:end], balanced_tree=False, compact_nodes=False)
        bound = np.minimum(bound, tree.query(points)[0])
        if end == len(others):
            break
        worst = points[bound.argmax()]
        largest = max(largest, float(np.sqrt(((others - worst) ** 2).sum(1).min())))
        points = points[bound > largest]
        bound = bound[bound > largest]
        start = end
        if not len(points):
            break
    return max(largest, float(bound.max(initial=0.0)))


def size_alarm(surface: np.ndarray, colliding: np.ndarray) -> str:
    """Why what is seen and what collides can hardly be one object; empty if they can.

    The space that both take together is held against that of the smaller: so it matters as well whether they
    lie in one place. Space is that of the convex hull or of the box around it, whichever differs less: hollow
    things, thin shells and boxes around forks are all sound.

    Args:
      surface, colliding: f64[N, 3], all vertices of each.
    """
    spaces = [
        _spaces(points) for points in (surface, colliding, np.concatenate([surface, colliding]))
    ]
    ratio = float((spaces[2] / np.minimum(spaces[0], spaces[1])).min())
    if ratio < ALARM_FACTOR:
        return ""
    seen, hit = (
        " x ".join(f"{1000 * side:.0f}" for side in np.ptp(each, axis=0))
        for each in (surface, colliding)
    )
    return (
        f"what is seen ({seen} mm) and what collides ({hit} mm) do not match in size or place: "
        f"together they take {ratio:.3g} times the space of the smaller"
    )


def _spaces(points: np.ndarray) -> np.ndarray:
    """f64[2]: the volumes of the hull and of the box around it, m^3; what is flat is given a thickness."""
    points = sound_points(points)
    hull = hull_of(points)
    box = float(np.ptp(points, axis=0).prod())
    return np.array([box if hull is None else hull.volume, box])


_SHARE = 0.02
"""Of an object's size: what is nearer, as a drawer to its frame, touches; what is smaller is no piece."""
_MOST_PIECES = 50


def gap_alarm(solid: Solid) -> str:
    """How far pieces of an object are from all others, in words; empty if each touches another."""
    gaps = piece_gaps(solid)
    if not gaps:
        return ""
    pieces = "a piece does" if len(gaps) == 1 else f"{len(gaps)} pieces do"
    return f"{pieces} not touch the rest of it: the gap is {1000 * max(gaps):.0f} mm"


def piece_gaps(solid: Solid) -> list[float]:
    """Metres from each piece, but the first, to the nearest one before it, where they do not touch."""
    least = _SHARE * solid.diagonal
    pieces = sorted((each for each in solid.shells() if _size(each) > least), key=_size)
    left = dict(enumerate(pieces[-_MOST_PIECES:]))
    distance = {len(left) - 1: 0.0}
    gaps: list[float] = []
    while left:
        near = min(left, key=lambda index: distance.get(index, np.inf))
        shell = left.pop(near)
        gaps += [distance[near]] if distance[near] > least else []
        for index, other in left.items():
            known = distance.get(index, 2 * solid.diagonal)
            if known > least and _box_gap(shell, other) < known:
                distance[index] = _min_gap(shell, other, least, known)
    return gaps


def _min_gap(
    one: manifold3d.Manifold, other: manifold3d.Manifold, least: float, most: float
) -> float:
    """Metres between two solids, or `most` if that is less; looked for nearby first, which costs far less."""
    reach = least
    gap = one.min_gap(other, reach)
    while gap >= reach and reach < most:
        reach = min(4 * reach, most)
        gap = one.min_gap(other, reach)
    return float(min(gap, most))


def _box_gap(one: manifold3d.Manifold, other: manifold3d.Manifold) -> float:
    """Metres between the boxes around two solids, along the axis along which they are farthest apart."""
    low, high = np.array(one.bounding_box()).reshape(2, 3)
    other_low, other_high = np.array(other.bounding_box()).reshape(2, 3)
    return float(np.maximum(low - other_high, other_low - high).max())


def _size(shell: manifold3d.Manifold) -> float:
    """Metres across the box around it."""
    box = np.array(shell.bounding_box())
    return float(np.linalg.norm(box[3:] - box[:3]))
