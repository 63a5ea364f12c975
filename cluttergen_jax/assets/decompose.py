"""Convex decomposition with CoACD, or one hull where that is enough; neighbouring parts are merged."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import coacd
import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from cluttergen_jax.assets.cloud import sample_solid, sample_surface
from cluttergen_jax.assets.config import DecompositionConfig
from cluttergen_jax.assets.deviation import deviation, is_within_parts
from cluttergen_jax.assets.exact_parts import exact_parts
from cluttergen_jax.assets.hollow import find_hollow
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.parts import heights_over, hull_of
from cluttergen_jax.assets.solid import Solid, simplify_solid
from cluttergen_jax.assets.voxels import Voxels
from cluttergen_jax.errors import AssetError

ALWAYS = 0.02
"""Parts that are one hull at the cost of this deviation or less, over the diagonal, become one."""
# What fills so much of its hull, as cans and bottles do, is merged to 4 parts, other things to 16.
FEW = 4
_OTHER_PARTS = 16
_CONVEX_SHARE = 0.8

_REACH = 0.03
_NUM_BURIED = 2000
_NUM_DENSE = 40_000
_NUM_ON_HULL = 250
_CELLS = 100
_NOWHERE = np.zeros((0, 3))


def parts_enough(solid: Solid) -> int:
    """How many parts an object needs at most: what is nearly its hull and not hollow 4, else 16."""
    hull = hull_of(solid.mesh.vertices)
    is_full = hull is not None and solid.volume >= _CONVEX_SHARE * hull.volume
    return FEW if is_full and find_hollow(solid) is None else _OTHER_PARTS


def merge_parts(
    parts: Sequence[np.ndarray],
    solid: Solid,
    limits: Sequence[float],
    enough: int,
    most: int,
    free: np.ndarray = _NOWHERE,
) -> list[list[np.ndarray]]:
    """For each limit, the parts with neighbours made one, the pair first whose hull is nearest to the solid.

    It goes on while a hull is within `ALWAYS`; within the limit while there are more parts than `enough`;
    and however far it is while there are more than `most`.

    Args:
      parts: f64[V, 3] each, convex.
      limits: over the diagonal.
      free: f64[N, 3]: none of these points gets into a part, unless there are more than `most`.
    """
    judge = _Judge(solid, max(limits), free)
    kept = dict(enumerate(parts))
    unions: dict[tuple[int, int], tuple[float, np.ndarray]] = {}
    pairs: Iterable[tuple[int, int]] = combinations(kept, 2)
    done: dict[float, list[np.ndarray]] = {}
    for fresh in range(len(parts), 2 * len(parts)):
        near = [pair for pair in pairs if _gap(kept, pair) < _REACH * solid.diagonal]
        if not near and not unions and len(kept) > most:
            near = list(combinations(kept, 2))
        unions |= {(one, other): judge.union(kept[one], kept[other]) for one, other in near}
        if not unions:
            break
        best = min(unions, key=lambda pair: unions[pair][0])
        cost, points = unions[best]
        if len(kept) <= most:
            over = [each for each in limits if cost > (each if len(kept) > enough else ALWAYS)]
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


class _Judge:
    """How far the hull of two parts would be from the surface of a solid."""

    def __init__(self, solid: Solid, limit: float, free: np.ndarray) -> None:
        self._limit = limit
        self._diagonal = solid.diagonal
        self._free = free
        self._voxels = Voxels.of(solid.mesh if solid.is_exact else solid.surface, _CELLS)
        dense = sample_solid(solid, _NUM_DENSE, 0)
        # Nothing can get between pieces that nearly touch.
        dense = dense[self._voxels.is_exposed(dense)]
        self._some = dense[:_NUM_BURIED]
        self._tree = cKDTree(dense)

    def union(self, one: np.ndarray, other: np.ndarray) -> tuple[float, np.ndarray]:
        """The hull's distance over the diagonal, and its vertices f64[V, 3].

        The larger of two: how deep the hull buries a point of the surface, and, where that is within the
        limit, how far a point of the hull that is outside of the solid is from it.
        """
        points = np.concatenate([one, other])
        hull = hull_of(points)
        if hull is None:
            return np.inf, points
        corners = points[hull.vertices]
        if (_depths(self._free, hull) > 0).any():
            return np.inf, corners
        depth = _depths(self._some, hull)
        if depth.max(initial=0.0) > self._limit * self._diagonal:
            return float(depth.max() / self._diagonal), corners
        spots = sample_surface(Mesh(hull.points, hull.simplices), _NUM_ON_HULL, 0)
        spots = spots[self._voxels.outside[self._voxels.index(spots)]]
        away = self._tree.query(spots)[0] if len(spots) else np.zeros(0)
        return float(max(depth.max(initial=0.0), away.max(initial=0.0)) / self._diagonal), corners


def _depths(points: np.ndarray, hull: ConvexHull) -> np.ndarray:
    """f64[M]: how deep those of the points are inside of a hull that are in the box around it."""
    near = points[((points > hull.min_bound) & (points < hull.max_bound)).all(1)]
    return -heights_over(near, hull).max(1, initial=-np.inf)


_MOST_RAW = 96
_LIMITS = (0.055, 0.05, 0.045, 0.03, ALWAYS)
"""How far from the surface, over the diagonal, merged parts may be, in the order in which it is tried. The
distance is an estimate: what is made of it is measured again."""
_EXACT_LIMITS = (0.03, ALWAYS)
"""The same of parts that are near as they are."""


def decompose(solid: Solid, config: DecompositionConfig, jitter: float = 0.0) -> list[np.ndarray]:
    """The first of `decompositions`."""
    return next(decompositions(solid, config, jitter))


def decompositions(
    solid: Solid, config: DecompositionConfig, jitter: float = 0.0
) -> Iterator[list[np.ndarray]]:
    """Sets of convex parts, f64[V, 3] each, in the solid's frame: first the fewest, then nearer ones.

    They have as many vertices as CoACD and merging give them.

    Args:
      jitter: share of the diagonal by which each vertex that CoACD sees is moved at most, always in the same
        way. There are closed meshes over which it crashes or never ends, and the slightest change helps.

    Raises:
      AssetError: neither CoACD nor Qhull can make anything of the mesh.
    """
    hull = hull_of(solid.mesh.vertices)
    if hull is None:
        raise AssetError(
            "a mesh so flat that it has no convex hull", "a mesh of an object with some thickness"
        )
    one = [solid.mesh.vertices[hull.vertices]]
    is_full = solid.volume >= config.one_hull_volume * hull.volume
    if config.max_parts == 1 or (
        is_full and (solid.is_convex or deviation(one, solid) <= config.one_hull_deviation)
    ):
        yield one
        return
    enough = parts_enough(solid)
    exact = exact_parts(solid, _MOST_RAW) if config.exact else None
    if exact is not None and exact.parts:
        of_rest = [part for each in exact.rest for part in _run(each, solid, config, jitter)]
        raw = [*exact.parts, *of_rest]
        free = exact.free[~is_within_parts(exact.free, raw)]
        merged = merge_parts(raw, solid, _EXACT_LIMITS, enough, config.max_parts, free)
        sets = [*merged, *([raw] if len(raw) <= config.max_parts else [])]
        small = [each for each in _distinct(sets) if len(each) <= enough]
        # More than enough only for the sake of holes, into which a peg may have to go.
        is_pierced = not small and len(free) > 0 and find_hollow(solid) is None
        yield from _distinct(sets) if is_pierced else small
    sets = merge_parts(
        _run(solid.mesh, solid, config, jitter), solid, _LIMITS, enough, config.max_parts
    )
    first = sets[0] or one
    is_few = len(sets[0]) <= enough
    if is_few:
        yield first
    # Which cuts leave few parts of a can is a matter of luck.
    for other in _others(config) if enough == FEW and len(first) <= 2 * FEW else ():
        (few,) = merge_parts(
            _run(solid.mesh, solid, other, jitter), solid, _LIMITS[:1], enough, config.max_parts
        )
        if 0 < len(few) <= enough:
            yield few
    yield from list(_distinct(sets))[1 if is_few else 0 :]


def _distinct(sets: Sequence[list[np.ndarray]]) -> Iterator[list[np.ndarray]]:
    """Sets, the fewest parts first, without those that are the same again."""
    for index, parts in enumerate(sets):
        if index == 0 or len(parts) > len(sets[index - 1]):
            yield parts


def _others(config: DecompositionConfig) -> list[DecompositionConfig]:
    tries = ((1, 1.0), (0, 4 / 3), (1, 4 / 3))[: config.tries]
    return [
        replace(config, seed=config.seed + seed, threshold=min(factor * config.threshold, 1.0))
        for seed, factor in tries
    ]


def _run(mesh: Mesh, solid: Solid, config: DecompositionConfig, jitter: float) -> list[np.ndarray]:
    """CoACD's parts of a closed surface of a solid, which may be all of it."""
    share = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))) / solid.diagonal
    mesh = simplify_solid(mesh, config.simplify * solid.diagonal)
    if jitter:
        reach = jitter * solid.diagonal
        rng = np.random.default_rng(config.seed)
        mesh = Mesh(mesh.vertices + rng.uniform(-reach, reach, mesh.vertices.shape), mesh.faces)
    coacd.set_log_level("error")
    found = coacd.run_coacd(
        coacd.Mesh(mesh.vertices, mesh.faces),
        # CoACD measures concavity over the size of what it is given.
        threshold=min(config.threshold / min(share, 1.0), 1.0),
        # Its own merging changes the object more than `merge_parts` does, but is far faster.
        max_convex_hull=_MOST_RAW,
        preprocess_mode="off",
        resolution=config.resolution,
        mcts_nodes=config.nodes,
        mcts_iterations=config.iterations,
        mcts_max_depth=config.depth,
        seed=config.seed,
    )
    # CoACD now and then returns a sliver that Qhull refuses; the rest is whole without it.
    parts = [np.asarray(vertices, np.float64) for vertices, _ in found]
    return [points for points in parts if hull_of(points) is not None]
