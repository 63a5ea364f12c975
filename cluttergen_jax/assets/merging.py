"""Fewer convex parts that are near enough: those far from a solid are cut in half, neighbours are made one.

What is far is told by `Nearness`, from samples, and is an estimate: a body that is made of the parts is
measured again (`deviation`). Every number here is a bound on work, so that no shape takes long.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Sequence
from itertools import combinations, count

import manifold3d
import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from cluttergen_jax.assets.cloud import sample_solid, sample_surface
from cluttergen_jax.assets.hollow import find_hollow
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.parts import heights_over, hull_of
from cluttergen_jax.assets.solid import Solid, Voxels, as_manifold, as_mesh
from cluttergen_jax.phases import say_phase

ALWAYS = 0.02
"""Parts that are one hull at the cost of this deviation or less, over the diagonal, become one."""
# What fills so much of its hull, as cans and bottles do, is merged to 4 parts, other things to 16.
FEW = 4
_OTHER_PARTS = 16
_CONVEX_SHARE = 0.8

_NEIGHBOURS = 0.03
_NUM_BURIED = 2000
_NUM_DENSE = 40_000
_NUM_ON_HULL = 250
_NUM_IN_CAVITY = 4000
_CAVITY_WEIGHT = 2.0
_CELLS = 100
_NOWHERE = np.zeros((0, 3))
_SLIVER = 1e-6
"""Of a solid's volume: smaller pieces are dropped."""


class Nearness:
    """How far convex hulls are from the surface of a solid, over its diagonal.

    The largest of three: how deep a hull buries a point of the surface; how far a point of the hull that is
    outside of the solid is from it; and twice the share of the solid's cavity that the hull covers. Nothing
    can get between pieces that nearly touch, so what lies there does not count.

    Attributes:
      diagonal: of the solid, metres.
      enough: how many parts the solid needs at most: what is nearly its hull and not hollow 4, else 16.
    """

    def __init__(self, solid: Solid) -> None:
        self.diagonal = solid.diagonal
        hull = hull_of(solid.mesh.vertices)
        hollow = find_hollow(solid)
        is_full = hull is not None and solid.volume >= _CONVEX_SHARE * hull.volume
        self.enough = FEW if is_full and hollow is None else _OTHER_PARTS
        self._cavity = _NOWHERE
        if hollow is not None:
            self._cavity = hollow.points[:: 1 + len(hollow.points) // _NUM_IN_CAVITY]
        self._voxels = Voxels.of(solid.mesh if solid.is_exact else solid.surface, _CELLS)
        dense = sample_solid(solid, _NUM_DENSE, 0)
        dense = dense[self._voxels.is_exposed(dense)]
        self._some = dense[:_NUM_BURIED]
        self._tree = cKDTree(dense)

    def distance(self, hull: ConvexHull, limit: float = np.inf) -> float:
        """Over the diagonal; where more than `limit` is buried or covered, how much that is."""
        buried = float(_depths(self._some, hull).max(initial=0.0)) / self.diagonal
        if len(self._cavity):
            covered = (_depths(self._cavity, hull) > 0).sum() / len(self._cavity)
            buried = max(buried, _CAVITY_WEIGHT * float(covered))
        if buried > limit:
            return buried
        spots = sample_surface(Mesh(hull.points, hull.simplices), _NUM_ON_HULL, 0)
        spots = spots[self._voxels.outside[self._voxels.index(spots)]]
        away = self._tree.query(spots)[0] if len(spots) else np.zeros(0)
        return max(buried, float(away.max(initial=0.0)) / self.diagonal)


def _depths(points: np.ndarray, hull: ConvexHull) -> np.ndarray:
    """f64[M]: how deep those of the points are inside of a hull that are in the box around it."""
    near = points[((points > hull.min_bound) & (points < hull.max_bound)).all(1)]
    return -heights_over(near, hull).max(1, initial=-np.inf)


def halve_parts(
    parts: Sequence[np.ndarray], mesh: Mesh, nearness: Nearness, reach: float, most: int
) -> list[np.ndarray]:
    """The parts with those that are farther than `reach` cut in half, the farthest first, up to `most`.

    Args:
      parts: f64[V, 3] each, convex.
      mesh: the closed surface that they were cut from.
      reach: over the diagonal.
    """
    whole = as_manifold(mesh)
    number = count()
    heap: list[tuple[float, int, np.ndarray]] = []

    def push(points: np.ndarray) -> None:
        hull = hull_of(points)
        if hull is not None:
            entry = (-nearness.distance(hull), next(number), points[hull.vertices])
            heapq.heappush(heap, entry)

    for part in parts:
        push(part)
    uncut: list[np.ndarray] = []
    while heap and -heap[0][0] > reach and len(heap) + len(uncut) < most:
        _, _, points = heapq.heappop(heap)
        pieces = _halves(manifold3d.Manifold.hull_points(points) ^ whole)
        for piece in pieces:
            if piece.volume() > _SLIVER * whole.volume():
                push(as_mesh(piece).vertices)
        uncut += [] if pieces else [points]
    return [*uncut, *(points for _, _, points in heap)]


def _halves(solid: manifold3d.Manifold) -> list[manifold3d.Manifold]:
    """The connected pieces of a solid cut across the middle of that axis which leaves the smallest hulls."""
    if solid.is_empty():
        return []
    points = as_mesh(solid).vertices
    _, axes = np.linalg.eigh(np.cov(points.T))
    cuts = []
    for axis in axes.T:
        along = points @ axis
        sides = solid.split_by_plane(tuple(axis), float(along.min() + along.max()) / 2)
        if not any(side.is_empty() for side in sides):
            cuts.append(sides)
    best = min(cuts, key=lambda sides: sum(side.hull().volume() for side in sides), default=())
    return [piece for side in best for piece in side.decompose()]


def merge_parts(
    parts: Sequence[np.ndarray],
    nearness: Nearness,
    limits: Sequence[float],
    enough: int,
    most: int,
    free: np.ndarray = _NOWHERE,
) -> list[list[np.ndarray]]:
    """For each limit, the parts with neighbours made one, the pair first whose hull is nearest to the solid.

    It goes on while a hull is within `ALWAYS`, or within the limit if that is less; within the limit while
    there are more parts than `enough`; and however far it is while there are more than `most`.

    Args:
      parts: f64[V, 3] each, convex.
      limits: over the diagonal.
      free: f64[N, 3]: none of these points gets into a part, unless there are more than `most`.
    """
    say_phase(f"joining its convex parts ({len(parts)})")
    kept = dict(enumerate(parts))
    unions: dict[tuple[int, int], tuple[float, np.ndarray]] = {}
    pairs: Iterable[tuple[int, int]] = combinations(kept, 2)
    done: dict[float, list[np.ndarray]] = {}
    for fresh in range(len(parts), 2 * len(parts)):
        near = [pair for pair in pairs if _gap(kept, pair) < _NEIGHBOURS * nearness.diagonal]
        if not near and not unions and len(kept) > most:
            near = list(combinations(kept, 2))
        unions |= {
            (one, other): _union(kept[one], kept[other], nearness, max(limits), free)
            for one, other in near
        }
        if not unions:
            break
        best = min(unions, key=lambda pair: unions[pair][0])
        cost, points = unions[best]
        if len(kept) <= most:
            over = [
                limit
                for limit in limits
                if cost > (limit if len(kept) > enough else min(limit, ALWAYS))
            ]
            done |= {limit: list(kept.values()) for limit in over if limit not in done}
            if len(done) == len(set(limits)):
                break
        kept = {index: part for index, part in kept.items() if index not in best}
        unions = {pair: union for pair, union in unions.items() if not set(pair) & set(best)}
        pairs = [(index, fresh) for index in kept]
        kept[fresh] = points
    return [done.get(limit, list(kept.values())) for limit in limits]


def _gap(parts: dict[int, np.ndarray], pair: tuple[int, int]) -> float:
    """Metres between the boxes around two parts; below zero where they overlap."""
    one, other = (parts[index] for index in pair)
    return float(np.maximum(one.min(0) - other.max(0), other.min(0) - one.max(0)).max())


def _union(
    one: np.ndarray, other: np.ndarray, nearness: Nearness, limit: float, free: np.ndarray
) -> tuple[float, np.ndarray]:
    """How far the hull of two parts is, over the diagonal, and its vertices f64[V, 3]."""
    points = np.concatenate([one, other])
    hull = hull_of(points)
    if hull is None:
        return np.inf, points
    is_open = not (_depths(free, hull) > 0).any()
    return nearness.distance(hull, limit) if is_open else np.inf, points[hull.vertices]
