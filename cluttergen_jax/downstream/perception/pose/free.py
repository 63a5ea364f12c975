"""Registration without any rule about the pose, by small_gicp (extra `perception`)."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from cluttergen_jax.downstream.perception.pose.models import ObjectModel
from cluttergen_jax.downstream.robot.frames import inverse
from cluttergen_jax.errors import MissingExtraError

EXTRA = "perception"
_REACH = 0.012
_STEPS = 20


def need_gicp() -> Any:
    """The module `small_gicp`.

    Raises:
      MissingExtraError: it is not installed.
    """
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
        self._gicp.estimate_normals_covariances(self._target, self._tree, num_neighbors=12, num_threads=1)

    def __call__(self, points: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """f64[4, 4]: T_world_object near `pose` f64[4, 4] for points f64[P, 3] of it, world frame."""
        # In the frame of the guess, so that rotations and lengths weigh alike.
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        found = self._gicp.align(
            self._target,
            self._gicp.PointCloud(local),
            self._tree,
            registration_type="PLANE_ICP",
            max_correspondence_distance=_REACH,
            num_threads=1,
            max_iterations=_STEPS,
            translation_epsilon=1e-5,
            rotation_epsilon=1e-4,
        )
        T = np.asarray(found.T_target_source, np.float64)
        if not np.isfinite(T).all():
            return pose
        return pose @ inverse(T)
