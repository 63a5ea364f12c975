"""Turns after which an object looks the same: about its own z, and in all of space."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.cloud import coloured_points
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.geometry import ROUND, across, yaw_matrix

TOLERANCE = 0.005
"""Metres that a symmetric object's surface may lie off itself once it is turned; points lie 2 mm apart. It
is the error below which a pose counts as right: depth cameras do not tell such turns apart."""
_ORDERS = (ROUND, 8, 6, 5, 4, 3, 2)
_NUM_POINTS = 40_000
_NUM_TURNED = 1000
_SHARE_OF_SIZE = 0.04
"""Of the object's size: in `symmetries_of` a turned surface may lie off by so much, if that is less than
`TOLERANCE`: small objects have small details."""
# Colours are alike if red, green and blue, in [0, 1], differ by less; so many points have to be alike.
_COLOUR_STEP = 0.12
_SHARE_ALIKE = 0.99

_SAME_AXIS = np.cos(np.radians(10))
_SAME_FRAME = np.cos(np.radians(0.1))


@dataclass(frozen=True, eq=False)
class Symmetries:
    """Rigid motions of an object onto itself, in its own frame, as BOP states them.

    Any of them may be followed by any turn about one of the axes.

    Attributes:
      axes: f64[A, 3], unit vectors: the axis of a body of revolution, or three of a ball.
      point: f64[3], metres: all axes go through it, and no motion moves it.
      motions: f64[M, 4, 4], metres; the one that moves nothing is left out.
    """

    axes: np.ndarray
    point: np.ndarray
    motions: np.ndarray


def turn_symmetry(asset: ObjectAsset) -> int:
    """The most equal turns about its z axis after which the object looks the same, colours aside; 1 for none.

    What is drawn of it decides; of an object without surfaces, its collision parts.
    """
    surfaces = [trimesh.Trimesh(piece.mesh.vertices, piece.mesh.faces) for piece in asset.pieces]
    surfaces = surfaces or [trimesh.convex.convex_hull(part.vertices) for part in asset.parts]
    surface = trimesh.util.concatenate(surfaces)
    dense, _ = trimesh.sample.sample_surface(surface, _NUM_POINTS, seed=0)
    tree = cKDTree(dense)
    sparse = dense[: _NUM_POINTS // 20]
    for order in _ORDERS:
        turned = (sparse @ yaw_matrix(angle).T for angle in _angles(order))
        if all(tree.query(points)[0].max() <= TOLERANCE for points in turned):
            return order
    return 1


def _angles(order: int) -> np.ndarray:
    return 2 * np.pi * np.arange(1, order // 2 + 1) / order


def symmetries_of(pieces: Sequence[Piece]) -> Symmetries:
    """The symmetries of coloured surfaces: of bodies of revolution, boxes, prisms and balls.

    Axes are sought along the object's own, the principal ones of its convex hull and those of the smallest
    box around it, all through the hull's centre of mass. Colours count: a can is round, and its label is not.
    """
    hull = trimesh.convex.convex_hull(np.concatenate([piece.mesh.vertices for piece in pieces]))
    middle = np.asarray(hull.center_mass)
    frames = _frames(hull)
    test = _Test(pieces, middle)
    axes = _distinct([axis for frame in frames for axis in frame if test.is_round(axis)])
    if len(axes) > 1:
        return Symmetries(np.eye(3), middle, np.zeros((0, 4, 4)))
    if axes:
        over = Rotation.from_rotvec(np.pi * across(axes[0])).as_matrix()
        turns = [over] if test.has(over) else []
    else:
        groups = sorted(
            (group for frame in frames for group in _groups(frame)), key=len, reverse=True
        )
        turns = next((group for group in groups if all(map(test.has, group))), [])
    return Symmetries(np.array(axes).reshape(-1, 3), middle, _motions(turns, middle))


def _frames(hull: trimesh.Trimesh) -> list[np.ndarray]:
    """f64[3, 3] each: orthogonal axes to try, as rows, without those that are the same as earlier ones."""
    frames: list[np.ndarray] = []
    for frame in (
        np.eye(3),
        np.asarray(hull.principal_inertia_vectors),
        trimesh.bounds.oriented_bounds(hull)[0][:3, :3],
    ):
        if all(np.abs(frame @ other.T).max(1).min() < _SAME_FRAME for other in frames):
            frames.append(frame)
    return frames


class _Test:
    """Whether surfaces look the same after a turn about a point."""

    def __init__(self, pieces: Sequence[Piece], middle: np.ndarray) -> None:
        areas = np.array([piece.mesh.areas.sum() for piece in pieces])
        counts = np.ceil(_NUM_POINTS * areas / areas.sum()).astype(int).tolist()
        samples = [
            coloured_points(piece, count, 0) for piece, count in zip(pieces, counts, strict=True)
        ]
        points = np.concatenate([spots for spots, _ in samples]) - middle
        diameter = 2 * np.linalg.norm(points, axis=1).max()
        self._tolerance = min(TOLERANCE, _SHARE_OF_SIZE * diameter)
        # Colours as three more coordinates, so that the other side of a thin wall is not near.
        shades = np.concatenate([shades for _, shades in samples]) * self._tolerance / _COLOUR_STEP
        self._tree = cKDTree(points)
        self._coloured = cKDTree(np.hstack([points, shades]))
        rng = np.random.default_rng(0)
        some = rng.choice(len(points), _NUM_TURNED, replace=False)
        self._points = points[some]
        self._shades = shades[some]
        # A small detail has few of the points, and vertices of its own.
        vertices = np.unique(
            np.concatenate([piece.mesh.vertices for piece in pieces]) - middle, axis=0
        )
        self._vertices = vertices[rng.permutation(len(vertices))[:_NUM_TURNED]]

    def has(self, turn: np.ndarray) -> bool:
        """Whether the turn f64[3, 3] changes nothing."""
        turned = self._points @ turn.T
        moved = np.concatenate([turned, self._vertices @ turn.T])
        if not self._is_near(self._tree, moved).all():
            return False
        return bool(
            self._is_near(self._coloured, np.hstack([turned, self._shades])).mean() >= _SHARE_ALIKE
        )

    def _is_near(self, tree: cKDTree, points: np.ndarray) -> np.ndarray:
        return np.isfinite(tree.query(points, distance_upper_bound=self._tolerance)[0])

    def is_round(self, axis: np.ndarray) -> bool:
        """Whether no turn about the axis f64[3] changes anything."""
        return all(
            self.has(Rotation.from_rotvec(angle * axis).as_matrix()) for angle in _angles(ROUND)
        )


def _distinct(axes: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Of axes that are nearly the same, the first."""
    kept: list[np.ndarray] = []
    for axis in axes:
        if all(abs(axis @ other) < _SAME_AXIS for other in kept):
            kept.append(axis)
    return kept


def _groups(frame: np.ndarray) -> Iterator[list[np.ndarray]]:
    """Groups of turns, without the identity: a cube's, and prisms' and pyramids' about a frame's rows."""
    cube = Rotation.create_group("O").as_matrix()
    yield [frame.T @ turn @ frame for turn in cube if not np.allclose(turn, np.eye(3))]
    for axis, side in zip(frame, np.roll(frame, -1, axis=0), strict=True):
        over = Rotation.from_rotvec(np.pi * side).as_matrix()
        for order in _ORDERS[1:]:
            steps = 2 * np.pi * np.arange(order) / order
            turns = [Rotation.from_rotvec(angle * axis).as_matrix() for angle in steps]
            yield [*turns[1:], *(turn @ over for turn in turns)]
            yield turns[1:]


def _motions(turns: Sequence[np.ndarray], middle: np.ndarray) -> np.ndarray:
    """f64[M, 4, 4]: the turns about a point."""
    motions = np.tile(np.eye(4), (len(turns), 1, 1))
    for motion, turn in zip(motions, turns, strict=True):
        motion[:3, :3] = turn
        motion[:3, 3] = middle - turn @ middle
    return motions
