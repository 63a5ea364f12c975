"""How people put an object: which of its poses at rest is the usual one.

Every pose gets marks; more is better. It counts
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

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.cloud import sample_faces
from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.assets.settle import upright_turn
from cluttergen_jax.assets.solid import Solid
from cluttergen_jax.assets.stances import Stance, stances
from cluttergen_jax.assets.voxels import Voxels

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
        voxels = Voxels.of(self._mesh.transform(turn, np.zeros(3)), _CELLS)
        thick = replace(voxels, outside=~binary_dilation(voxels.solid, np.ones((3, 3, 3), bool)))
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
