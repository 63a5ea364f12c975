"""Scenes by object index, and where their objects lie in the queried region."""

from __future__ import annotations

import numpy as np

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import rotate_in_plane


def by_object(
    object_index: np.ndarray, is_placed: np.ndarray, slot_poses: np.ndarray, num_objects: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scenes by slot (`placement.scenes.SceneBatch`) as scenes by object.

    Args:
      object_index: i[N, S], the object of each slot, -1 where there is none.
      is_placed: bool[N, S], the slot was filled.
      slot_poses: f[N, S, 7], world, metres, wxyz.
      num_objects: K, objects in the compiled world.

    Returns:
      poses f64[N, K, 7] (at the origin, unturned, where not placed), is_placed bool[N, K], and slot i32[N,
      K], the place in the order of placement, -1 where not placed.
    """
    object_index = np.asarray(object_index)
    is_placed = np.asarray(is_placed, bool)
    num_scenes = len(object_index)
    poses = np.tile(np.eye(7)[3], (num_scenes, num_objects, 1))
    placed = np.zeros((num_scenes, num_objects), bool)
    slot = np.full((num_scenes, num_objects), -1, np.int32)
    scene, place = np.nonzero(is_placed & (object_index >= 0))
    which = object_index[scene, place]
    poses[scene, which] = np.asarray(slot_poses)[scene, place]
    placed[scene, which] = True
    slot[scene, which] = place
    return poses, placed, slot


def check_scenes(poses: np.ndarray, is_placed: np.ndarray, num_objects: int | None = None) -> None:
    """Refuses arrays that are not scenes by object index.

    Raises:
      ConfigError: shapes other than [N, K, 7] and [N, K], or a placed object without a finite pose.
    """
    shape = np.shape(is_placed)
    right = len(shape) == 2 and np.shape(poses) == (*shape, 7)
    if not right or (num_objects is not None and shape[1] != num_objects):
        raise ConfigError(
            f"poses of shape {np.shape(poses)} and is_placed of shape {shape}",
            f"(N, K, 7) and (N, K){'' if num_objects is None else f' with K = {num_objects}'}",
            "arrangement.by_object, which makes them of slots",
        )
    if not np.isfinite(np.asarray(poses)[np.asarray(is_placed, bool)]).all():
        raise ConfigError("a placed object whose pose is not finite", "finished scenes only")


def region_positions(poses: np.ndarray, region: Rectangle) -> np.ndarray:
    """f64[..., 2]: where poses f[..., 7] lie in the region's frame, metres from its centre."""
    offset = np.asarray(poses, np.float64)[..., :2] - np.asarray(region.center)
    return rotate_in_plane(offset, -region.yaw)
