"""Every pose in which a body can rest on a plane, and which of them is the usual one.

On some faces of the convex hull the centre of mass is lower than in all directions near by: these are the
poses. Between two faces the body rolls over their common edge, and is highest when the centre of mass is
above it: that tells how far it can be tilted.

How people put an object is found by marks; more is better. It counts
- how far it can be tilted (0.75, in full from 20 degrees on, and 0.9, in full from 60 on);
- that it stands on end: its longest side, longer than the next by a tenth and than the shortest by a third at
  least, is upright (1.2, in full where it bears a tilt of 15 degrees, nothing below 9);
- that it opens upward: the water that it would hold, over its convex hull (4, in full from 15 % on), with
  small holes stopped and narrow clefts filled;
- that it has a vertical plane of symmetry (0.75) or axis of four turns (0.3), handles and spouts aside;
- that it has a broad base: the outline of what touches the table, over that of its shadow (4, from 70 % on);
- that its centre of mass is low (minus half its height over that of the object).

An object stays as authored if it rests so, within 8 degrees, and no pose has 0.9 marks more, or if no pose
bears a tilt of 10 degrees. The weights were found on objects whose files are known to be right
(`studies/benchmarks/upright.py`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree
from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.cloud import sample_faces
from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.assets.settle import upright_turn
from cluttergen_jax.assets.solid import Solid, Voxels, dilate
from cluttergen_jax.geometry import unit

_MIN_TIP = np.radians(5)
_SAME = np.cos(np.radians(12))
# A body that rolls so far with a push has left its pose: a can that lies, a ball.
_AWAY = np.cos(np.radians(30))
_MOST = 10
_MOST_TRIED = 60


@dataclass(frozen=True, eq=False)
class Stance:
    """One pose at rest.

    Attributes:
      up: f64[3], unit: the direction of the body's frame that points up.
      tip: radians by which the body can be tilted, in the weakest direction, and comes back.
      likelihood: share of all directions from which it rolls into this pose, if it rolls slowly.
      height: metres from the plane to the highest point.
    """

    up: np.ndarray
    tip: float
    likelihood: float
    height: float


def stances(points: np.ndarray, center: np.ndarray) -> list[Stance]:
    """The poses that bear a tilt of 5 degrees, the steadiest first and ten at most.

    Args:
      points: f64[N, 3], of which the convex hull is taken.
      center: f64[3], the centre of mass.
    """
    found = list(islice(_rests(points, center), _MOST_TRIED))
    steady = [stance for stance in found if stance.tip >= _MIN_TIP]
    return sorted(steady, key=lambda stance: -stance.tip)[:_MOST]


def upright_stance(points: np.ndarray, center: np.ndarray, within: float) -> Stance | None:
    """The steadiest pose in which z points up, to `within` radians; None if none bears a tilt of 5 degrees.

    Args:
      points: f64[N, 3], of which the convex hull is taken.
      center: f64[3], the centre of mass.
    """
    upright = [each for each in _rests(points, center) if each.up[2] > np.cos(within)]
    best = max(upright, key=lambda stance: stance.tip, default=None)
    return None if best is None or best.tip < _MIN_TIP else best


def _rests(points: np.ndarray, center: np.ndarray) -> Iterator[Stance]:
    """The poses at rest, the likeliest first; of poses 12 degrees apart or less, the likeliest alone."""
    points = points[ConvexHull(points).vertices] - center
    faces = _Faces.of(points)
    rest = faces.rests()
    likelihood = np.bincount(rest, faces.solid_angles(), len(rest))
    kept: list[int] = []
    for face in sorted(set(rest.tolist()), key=lambda face: -likelihood[face]):
        near = [other for other in kept if faces.normals[other] @ faces.normals[face] > _SAME]
        if near:
            likelihood[near[0]] += likelihood[face]
        else:
            kept.append(face)
    rolls = faces.rolls()
    for face in kept:
        up = -faces.normals[face]
        height = float(np.ptp(points @ up))
        yield Stance(up, faces.tip(face, rolls), float(likelihood[face]), height)


@dataclass(frozen=True, eq=False)
class _Faces:
    """A hull's triangles about the centre of mass."""

    corners: np.ndarray  # f64[F, 3, 3].
    normals: np.ndarray  # f64[F, 3], outward.
    heights: np.ndarray  # f64[F], of the centre of mass over each.
    neighbors: np.ndarray  # i64[F, 3], over the edge opposite of each corner.

    @staticmethod
    def of(points: np.ndarray) -> _Faces:
        hull = ConvexHull(points)
        planes = hull.equations
        return _Faces(points[hull.simplices], planes[:, :3], -planes[:, 3], hull.neighbors)

    def rests(self) -> np.ndarray:
        """i64[F]: the face on which a body that is set down on each comes to rest, rolling downwards."""
        faces = np.arange(len(self.normals))
        below = self.normals * self.heights[:, None]
        outside = np.empty((len(faces), 3))
        for k in range(3):
            start = self.corners[:, k - 2]
            end = self.corners[:, k - 1]
            side = np.cross(end - start, self.normals)
            side *= np.sign((side * (start - self.corners[:, k])).sum(1))[:, None]
            outside[:, k] = (side * (below - start)).sum(1) / np.maximum(
                np.linalg.norm(side, axis=1), 1e-30
            )
        worst = outside.argmax(1)
        to = self.neighbors[faces, worst]
        is_down = (outside[faces, worst] > 1e-9) & (self.heights[to] <= self.heights + 1e-12)
        rest = np.where(is_down, to, faces)
        for _ in range(int(np.ceil(np.log2(len(faces)))) + 1):
            rest = rest[rest]
        return rest

    def solid_angles(self) -> np.ndarray:
        """f64[F]: the share of all directions from the centre that go through each face."""
        a, b, c = (self.corners[:, k] for k in range(3))
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        volume = np.abs((a * np.cross(b, c)).sum(1))
        rest = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (a * c).sum(1) * lb
        return np.arctan2(volume, rest) / (2 * np.pi)

    def rolls(self) -> csr_array:
        """f64[F, F], sparse: the cheapest ways between faces; of each step the centre's greatest height."""
        here = np.repeat(np.arange(len(self.normals)), 3)
        there = self.neighbors.ravel()
        start = np.roll(self.corners, -1, axis=1).reshape(-1, 3)
        end = np.roll(self.corners, -2, axis=1).reshape(-1, 3)
        along = unit(end - start)
        lever = start - (start * along).sum(1)[:, None] * along
        length = np.linalg.norm(lever, axis=1)
        lever = unit(lever)
        normals = self.normals[here]
        others = self.normals[there]
        turn = (normals * others).sum(1) - 1e-9
        is_over = ((lever * normals).sum(1) >= turn) & ((lever * others).sum(1) >= turn)
        highest = np.where(is_over, length, np.maximum(self.heights[here], self.heights[there]))
        tree = minimum_spanning_tree(coo_array((highest, (here, there))).tocsr())
        return csr_array(tree + tree.T)

    def tip(self, face: int, rolls: csr_array) -> float:
        """Radians: the tilt over one edge that lifts the centre as much as the cheapest way out does."""
        order, before = breadth_first_order(rolls, face, directed=False)
        steps = np.asarray(rolls[order[1:], before[order[1:]]]).ravel()
        highest = np.full(len(self.normals), self.heights[face])
        for there, step in zip(order[1:].tolist(), steps.tolist(), strict=True):
            highest[there] = max(highest[before[there]], step)
        away = self.normals @ self.normals[face] < _AWAY
        return float(np.arccos(min(self.heights[face] / highest[away].min(), 1.0)))


_LEAD = 0.9
_STEADY = np.radians(10)
_AUTHORED = np.cos(np.radians(8))
_CELLS = 36
_NUM_POINTS = 6000
_NUM_TURNED = 400
# Shares of the object's size: how far a surface may lie off its mirror image, and how thick the base is.
_ALIKE = 0.03
_BASE = 0.01
_PLANES = np.radians(np.arange(0, 180, 3))
_TURNS = np.radians([90, 180])


@dataclass(frozen=True, eq=False)
class Choice:
    """The usual poses of an object, the best first."""

    poses: tuple[tuple[Stance, float], ...]  # With the marks of each.
    authored: Stance | None  # The one as authored; None if it does not rest so.
    is_kept: bool  # Whether the object stays as authored.


def usual_poses(solid: Solid, center: np.ndarray) -> Choice:
    """Marks the poses of a solid whose z axis is up as authored.

    Args:
      center: f64[3], the centre of mass.
    """
    found = stances(solid.mesh.vertices, center)
    look = _Look(solid, center)
    poses = sorted(((each, look.marks(each)) for each in found), key=lambda pair: -pair[1])
    own = [pair for pair in poses if pair[0].up[2] > _AUTHORED]
    best = max((marks for each, marks in poses if each.tip >= _STEADY), default=-np.inf)
    is_kept = best == -np.inf or (bool(own) and own[0][1] >= best - _LEAD)
    steady = tuple(pair for pair in poses if pair[0].tip >= _STEADY)
    return Choice(steady, own[0][0] if own else None, is_kept)


class _Look:
    """An object as it looks from its poses; points are about the centre of mass."""

    def __init__(self, solid: Solid, center: np.ndarray) -> None:
        self._mesh = solid.mesh.transform(np.eye(3), -center)
        self._is_convex = solid.is_convex
        hull = ConvexHull(self._mesh.vertices)
        self._corners = hull.points[hull.vertices]
        self._volume = float(hull.volume)
        self._points = sample_faces(self._mesh, _NUM_POINTS, 0)[0]
        self._tree = cKDTree(self._points)
        self._sides = np.sort(_sides(self._corners))
        self._size = float(np.linalg.norm(self._sides))

    def marks(self, stance: Stance) -> float:
        """See the module."""
        turn = self._along_axes(upright_turn(stance.up))
        tilt = np.degrees(stance.tip)
        corners = self._corners @ turn.T
        lowest = float(corners[:, 2].min())
        mirror, axis = self._symmetry(turn)
        return float(
            0.75 * min(tilt / 20, 1)
            + 0.9 * min(tilt / 60, 1)
            + 1.2 * self._on_end(stance.height) * np.clip((tilt - 9) / 6, 0, 1)
            + 4 * min(self._water(turn) / 0.15, 1)
            + 0.75 * np.clip((mirror - 0.85) / 0.15, 0, 1)
            + 0.3 * np.clip((axis - 0.5) / 0.4, 0, 1)
            + 4 * min(_base(corners, lowest + _BASE * self._size), 0.7)
            + 0.5 * lowest / stance.height
        )

    def _along_axes(self, turn: np.ndarray) -> np.ndarray:
        """The turn, and one about the vertical after it that lays the longer way along x."""
        level = (self._points @ turn.T)[:, :2]
        axes = np.linalg.eigh(np.cov(level.T))[1]
        x, y = axes[:, 1]
        return np.array([[x, y, 0], [-y, x, 0], [0, 0, 1]]) @ turn

    def _on_end(self, height: float) -> float:
        """From 0 to 1: whether the longest side is upright, and distinctly the longest."""
        shortest, middle, longest = self._sides
        is_long = np.clip(10 * (longest / middle - 1.1), 0, 1) * np.clip(
            2.5 * (longest / shortest - 1.3), 0, 1
        )
        return float(is_long) * (height >= 0.92 * longest)

    def _water(self, turn: np.ndarray) -> float:
        """What it would hold, over its hull, with all surfaces thicker by one cell."""
        if self._is_convex:
            return 0.0
        voxels = Voxels.of(self._mesh.transform(turn), _CELLS)
        thick = replace(voxels, outside=~dilate(voxels.solid))
        return float(thick.water().sum() * voxels.pitch**3 / self._volume)

    def _symmetry(self, turn: np.ndarray) -> tuple[float, float]:
        """The share of the surface that lies on itself after the best reflection, and the worst turn."""
        across = np.column_stack([np.cos(_PLANES), np.sin(_PLANES), np.zeros_like(_PLANES)]) @ turn
        mirrors = np.eye(3) - 2 * across[:, :, None] * across[:, None, :]
        turns = Rotation.from_rotvec(_TURNS[:, None] * turn[2]).as_matrix()
        return max(self._alike(mirrors)), min(self._alike(turns))

    def _alike(self, motions: np.ndarray) -> list[float]:
        moved = np.einsum("mij,pj->mpi", motions, self._points[:_NUM_TURNED])
        away, _ = self._tree.query(moved, distance_upper_bound=_ALIKE * self._size)
        return np.isfinite(away).mean(1).tolist()


def _base(corners: np.ndarray, below: float) -> float:
    """The area around the corners lower than `below`, over that of the shadow."""
    base = hull_of(corners[corners[:, 2] < below, :2])
    shadow = hull_of(corners[:, :2])
    return 0.0 if base is None or shadow is None else float(base.volume / shadow.volume)


def _sides(points: np.ndarray) -> np.ndarray:
    """f64[3]: the sides of the smallest box around points."""
    import trimesh

    return np.asarray(trimesh.bounds.oriented_bounds(points)[1])
