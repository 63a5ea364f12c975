"""Registration by iterated closest points: of upright objects in x, y, z and yaw, and without any rule."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from cluttergen_jax.assets import ROUND
from cluttergen_jax.downstream.perception.pose.models import ObjectModel
from cluttergen_jax.downstream.transforms import inverse
from cluttergen_jax.errors import MissingExtraError
from cluttergen_jax.geometry import yaw_matrix

NUM_YAWS = 24
_STEPS = 12
# Metres beyond which points pair with nothing, at the first and at the last step.
_FIRST_TRIM = 0.04
_LAST_TRIM = 0.010

# What a point's own distance counts for beside that from its plane; and what keeps an open move at none.
_POINTS = 0.2
_DAMPING = 1e-8


def starting_yaws(symmetry: int) -> np.ndarray:
    """f64[n]: turns to begin with, radians; fewer where turns look alike."""
    if symmetry >= ROUND:
        return np.zeros(1)
    number = max(NUM_YAWS // symmetry, 3)
    return 2 * np.pi / symmetry * np.arange(number) / number


def register_upright(
    model: ObjectModel,
    points: np.ndarray,
    eyes: np.ndarray,
    yaw: float,
    bottom: float | None,
    offset: np.ndarray | None = None,
) -> np.ndarray:
    """f64[4, 4]: T_world_object near a turn, by iterated closest points on tangent planes.

    Args:
      points: f64[P, 3], of the object, world frame. eyes: f64[P, 3], from where each was seen.
      yaw: radians. bottom: the height of what it stands on; None leaves z free.
      offset: f64[2], metres, added to the first guess in plan; none if None.
    """
    pose = _first_guess(model, points, eyes, yaw, bottom)
    if offset is not None:
        pose[:2, 3] += offset
    fixed = bottom is not None
    for step in range(_STEPS):
        trim = _FIRST_TRIM * (_LAST_TRIM / _FIRST_TRIM) ** (step / (_STEPS - 1))
        rotation = pose[:3, :3]
        local = (points - pose[:3, 3]) @ rotation
        distance, nearest = model.tree.query(local, distance_upper_bound=trim)
        is_near = np.isfinite(distance)
        if is_near.sum() < 8:
            return pose
        near = local[is_near]
        index = nearest[is_near]
        normal = model.normals[index]
        # A surface that faces away from the eye was not what was seen.
        view = near - ((eyes[is_near] - pose[:3, 3]) @ rotation)
        faces = (normal * view).sum(1) < 0
        weight = np.where(faces, 1.0, 0.2)
        weight *= np.clip(1 - (distance[is_near] / trim) ** 2, 0.0, None)
        change = _solve_move(near, model.points[index], normal, weight, fixed)
        turn = yaw_matrix(change[3])
        moved = np.eye(4)
        moved[:3, :3] = turn
        moved[:3, 3] = change[:3]
        pose = pose @ moved
    return pose


def _first_guess(
    model: ObjectModel, points: np.ndarray, eyes: np.ndarray, yaw: float, bottom: float | None
) -> np.ndarray:
    """The middle of what would be seen at this turn lies in the middle of what was seen."""
    turn = yaw_matrix(yaw)
    toward = (eyes.mean(0) - points.mean(0)) @ turn
    is_seen = model.normals @ toward > 0
    seen = model.points[is_seen] if is_seen.sum() > 20 else model.points
    pose = np.eye(4)
    pose[:3, :3] = turn
    pose[:3, 3] = points.mean(0) - turn @ seen.mean(0)
    if bottom is not None:
        pose[2, 3] = bottom + model.asset.half_extents[2]
    return pose


def _solve_move(
    near: np.ndarray, target: np.ndarray, normal: np.ndarray, weight: np.ndarray, fixed: bool
) -> np.ndarray:
    """f64[4]: the move x, y, z, yaw of the object, in its frame, that brings its planes to the points.

    Args:
      near, target, normal: f64[P, 3], seen points, the surface's points and normals; weight: f64[P].
      fixed: z does not change.
    """
    apart = near - target
    none = np.zeros(len(near))
    one = np.ones(len(near))
    # A point p of the object moves by t + w x p.
    about = target[:, 0] * normal[:, 1] - target[:, 1] * normal[:, 0]
    planes = np.column_stack([normal[:, :2], none if fixed else normal[:, 2], about])
    # Slides that the planes leave open are held by the points themselves, a little.
    along_x = _POINTS * np.column_stack([one, none, none, -target[:, 1]])
    along_y = _POINTS * np.column_stack([none, one, none, target[:, 0]])
    aims = (apart * normal).sum(1), _POINTS * apart[:, 0], _POINTS * apart[:, 1]
    matrix = _DAMPING * np.eye(4)
    right = np.zeros(4)
    for rows, aim in zip((planes, along_x, along_y), aims, strict=True):
        weighted = rows * weight[:, None]
        matrix += weighted.T @ rows
        right += weighted.T @ aim
    change = np.linalg.solve(matrix, right)
    change[3] = np.clip(change[3], -0.3, 0.3)
    return change


EXTRA = "perception"
_FREE_REACH = 0.012
_FREE_STEPS = 20


def need_gicp() -> Any:
    """The module `small_gicp`. Raises MissingExtraError: it is not installed."""
    try:
        return importlib.import_module("small_gicp")
    except ImportError as error:
        raise MissingExtraError(EXTRA, "pose estimation") from error


class FreeRegistration:
    """Moves poses of one object, all six coordinates, to where its surface meets points."""

    def __init__(self, model: ObjectModel) -> None:
        self._gicp = need_gicp()
        self._target = self._gicp.PointCloud(model.points)
        self._tree = self._gicp.KdTree(self._target, num_threads=1)
        self._gicp.estimate_normals_covariances(
            self._target, self._tree, num_neighbors=12, num_threads=1
        )

    def __call__(self, points: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """f64[4, 4]: T_world_object near `pose` f64[4, 4] for points f64[P, 3] of it, world frame."""
        # In the frame of the guess, so that rotations and lengths weigh alike.
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        found = self._gicp.align(
            self._target,
            self._gicp.PointCloud(local),
            self._tree,
            registration_type="PLANE_ICP",
            max_correspondence_distance=_FREE_REACH,
            num_threads=1,
            max_iterations=_FREE_STEPS,
            translation_epsilon=1e-5,
            rotation_epsilon=1e-4,
        )
        T = np.asarray(found.T_target_source, np.float64)
        if not np.isfinite(T).all():
            return pose
        return pose @ inverse(T)
