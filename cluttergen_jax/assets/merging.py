"""Fewer convex parts that are near enough: those far from a solid are cut in half, neighbours are made one.

What is far is told by `Nearness`, from samples, and is an estimate: a body that is made of the parts is
measured again (`deviation`).
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
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
_NUM_BETWEEN = 6
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
      is_hollow: the solid has a cavity.
      enough: how many parts the solid needs at most: what is nearly its hull and not hollow 4, else 16.
    """

    def __init__(self, solid: Solid) -> None:
        self.diagonal = solid.diagonal
        hull = hull_of(solid.mesh.vertices)
        hollow = find_hollow(solid)
        is_full = hull is not None and solid.volume >= _CONVEX_SHARE * hull.volume
        self.is_hollow = hollow is not None
        self.enough = FEW if is_full and not self.is_hollow else _OTHER_PARTS
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

    def bounds(self, one: np.ndarray, others: Sequence[np.ndarray]) -> np.ndarray:
        """f64[N]: how far the hull of a part with each of others is at least, from points between them."""
        if not others:
            return np.zeros(0)
        points = np.stack([_between(one, other) for other in others])
        flat = points.reshape(-1, 3)
        is_outside = self._voxels.outside[self._voxels.index(flat)]
        away = np.zeros(len(flat))
        away[is_outside] = self._tree.query(flat[is_outside])[0]
        return away.reshape(len(others), -1).max(1) / self.diagonal


def _between(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """f64[M, 3]: middles between some of the points of one and some of another."""
    some = [each[np.linspace(0, len(each) - 1, _NUM_BETWEEN).astype(int)] for each in (one, other)]
    return ((some[0][:, None] + some[1][None]) / 2).reshape(-1, 3)


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
    pairs = Pairs(nearness, max(limits), free)
    for part in parts:
        pairs.add(part)
    done: dict[float, list[np.ndarray]] = {}
    while len(done) < len(set(limits)):
        best = pairs.nearest(is_forced=len(pairs.parts) > most)
        if best is None:
            break
        number = len(pairs.parts)
        if number <= most:
            for limit in limits:
                if best.distance > (limit if number > enough else min(limit, ALWAYS)):
                    done.setdefault(limit, list(pairs.parts.values()))
        pairs.join(best)
    return [done.get(limit, list(pairs.parts.values())) for limit in limits]


@dataclass(frozen=True, order=True)
class _Pair:
    """Two parts, and how far their hull is, over the diagonal; at least so far where there is no hull yet."""

    distance: float
    one: int
    other: int
    hull: np.ndarray | None = field(default=None, compare=False)  # f64[V, 3], its corners.


class Pairs:
    """Parts by number and, nearest first, the pairs of neighbours among them, measured when they come up.

    Attributes:
      parts: f64[V, 3] each, convex.
    """

    def __init__(self, nearness: Nearness, limit: float, free: np.ndarray) -> None:
        self.parts: dict[int, np.ndarray] = {}
        self._nearness = nearness
        self._limit = limit
        self._free = free
        self._heap: list[_Pair] = []
        self._number = count()

    def add(self, part: np.ndarray) -> None:
        """One more part, and its pairs with those that are near."""
        reach = _NEIGHBOURS * self._nearness.diagonal
        fresh = next(self._number)
        near = [number for number, other in self.parts.items() if _gap(part, other) < reach]
        bounds = self._nearness.bounds(part, [self.parts[number] for number in near])
        for number, bound in zip(near, bounds, strict=True):
            heapq.heappush(self._heap, _Pair(float(bound), number, fresh))
        self.parts[fresh] = part

    def nearest(self, *, is_forced: bool) -> _Pair | None:
        """The pair whose hull is nearest; None where no two are neighbours, unless it `is_forced`."""
        while self._heap:
            pair = heapq.heappop(self._heap)
            if pair.one not in self.parts or pair.other not in self.parts:
                continue
            if pair.hull is not None:
                return pair
            heapq.heappush(self._heap, self._measure(pair))
        if is_forced and len(self.parts) > 1:
            self._heap = [self._measure(_Pair(0.0, *both)) for both in combinations(self.parts, 2)]
            heapq.heapify(self._heap)
            return heapq.heappop(self._heap)
        return None

    def join(self, pair: _Pair) -> None:
        """The hull of a pair in place of both."""
        del self.parts[pair.one]
        del self.parts[pair.other]
        assert pair.hull is not None
        self.add(pair.hull)

    def _measure(self, pair: _Pair) -> _Pair:
        points = np.concatenate([self.parts[pair.one], self.parts[pair.other]])
        hull = hull_of(points)
        if hull is None:
            return replace(pair, distance=np.inf, hull=points)
        corners = points[hull.vertices]
        if (_depths(self._free, hull) > 0).any():
            return replace(pair, distance=np.inf, hull=corners)
        distance = self._nearness.distance(hull, self._limit)
        return replace(pair, distance=max(pair.distance, distance), hull=corners)


def _gap(one: np.ndarray, other: np.ndarray) -> float:
    """Metres between the boxes around two parts; below zero where they overlap."""
    return float(np.maximum(one.min(0) - other.max(0), other.min(0) - one.max(0)).max())
