"""What a policy sees, everything in the queried region's frame (paper, section 3.1)."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.region import Region, from_pose, to_pose
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.types import Episode, Geometry, History
from cluttergen_jax.types import Array

MAX_POINTS = 200_000


@dataclass(frozen=True)
class ObservationConfig:
    """How much of it is spelled out.

    Attributes:
      num_scene_points: points of the scene's cloud (paper: 20,480); 0 leaves clouds out of the observation,
        to be made from poses by `scene_cloud` where they are needed.
      num_object_points: points of the cloud of the object in hand (paper: 1,024), at most 1,024.
    """

    num_scene_points: int = 0
    num_object_points: int = 1024

    def __post_init__(self) -> None:
        if not (0 <= self.num_scene_points <= MAX_POINTS and 1 <= self.num_object_points <= 1024):
            raise ConfigError(
                f"{self.num_scene_points} scene points and {self.num_object_points} object points",
                f"0 to {MAX_POINTS} and 1 to 1024",
            )


def observe(rules: Rules, episode: Episode, config: ObservationConfig) -> dict[str, Array | dict[str, Array]]:
    """The observation of one episode.

    Returns:
      region: f32[3], the region's half extents and the height range of actions, metres.
      focus: i32, the object in hand; is_placed: bool[K].
      T_region_object: f32[K, 7], poses of the placed objects, zero elsewhere.
      history: the failed attempts of the object in hand: action f32[A, 4], region f32[A, 3],
        trajectory f32[A, H, 13] (position, wxyz, linear and angular velocity), num_steps i32[A],
        is_tried bool[A]; rows not tried are zero.
      scene_cloud: f32[N, 3], scene_mask: bool[N], object_cloud: f32[M, 3] (object frame), where asked for.
    """
    region, focus = episode.region, rules.focus(episode)
    local = jax.vmap(lambda pose: to_pose(region.T_world_region.inverse() @ from_pose(pose)))(episode.poses)
    local = jnp.where(episode.is_placed[:, None], local, 0.0)
    observation: dict[str, Array | dict[str, Array]] = {
        "region": jnp.append(region.half_extents, rules.height_range(episode)),
        "focus": focus,
        "is_placed": episode.is_placed,
        "T_region_object": local,
        "history": _local_history(episode.history, region, rules.config.history_stride),
    }
    if config.num_scene_points:
        most = min(rules.geometry.num_objects, rules.num_slots)
        cloud, mask = scene_cloud(
            rules.geometry, local, episode.is_placed, region.half_extents, config.num_scene_points, most
        )
        observation |= {"scene_cloud": cloud, "scene_mask": mask}
        observation["object_cloud"] = rules.geometry.cloud[focus, : config.num_object_points]
    return observation


def _local_history(history: History, region: Region, stride: int) -> dict[str, Array]:
    """The history as the policy reads it: trajectories turned into the region's frame."""
    T_region_world = region.T_world_region.inverse()

    def local(row: Array) -> Array:
        pose = to_pose(T_region_world @ from_pose(row[:7]))
        turn = T_region_world.rotation()
        return jnp.concatenate([pose, turn.apply(row[7:10]), turn.apply(row[10:])])

    steps = jnp.arange(history.trajectory.shape[1]) * stride
    is_used = history.is_tried[:, None] & (steps <= history.num_steps[:, None])
    trajectory = jax.vmap(jax.vmap(local))(history.trajectory)
    return {
        "action": history.action,
        "region": history.region,
        "trajectory": jnp.where(is_used[..., None], trajectory, 0.0),
        "num_steps": history.num_steps,
        "is_tried": history.is_tried,
    }


def scene_cloud(
    geometry: Geometry,
    T_region_object: Array,
    is_placed: Array,
    half_extents: Array,
    num_points: int,
    max_objects: int,
) -> tuple[Array, Array]:
    """The scene's point cloud in the region frame, made from poses: every object's cloud is known.

    The support's top and each placed object get an equal share; an object's share is a prefix of its
    farthest-point ordered cloud.

    Args:
      T_region_object: f32[K, 7]; is_placed: bool[K]; half_extents: f32[2] of the region, metres.
      num_points: N; max_objects: the most that can be placed at once (static).

    Returns:
      f32[N, 3] metres, and bool[N], which of them count.
    """
    share = min(num_points // (max_objects + 1), geometry.cloud.shape[1])
    chosen = jnp.nonzero(is_placed, size=max_objects, fill_value=-1)[0]
    poses = from_pose(T_region_object[chosen])
    points = jax.vmap(lambda pose, cloud: jax.vmap(pose.apply)(cloud))(poses, geometry.cloud[chosen, :share])
    counts = jnp.broadcast_to((chosen >= 0)[:, None], points.shape[:2])
    ground = num_points - max_objects * share
    top = jnp.asarray(_even_points(ground)) * half_extents
    top = jnp.concatenate([top, jnp.zeros((ground, 1))], axis=1)
    cloud = jnp.concatenate([top, jnp.where(counts[..., None], points, 0.0).reshape(-1, 3)])
    return cloud, jnp.concatenate([jnp.ones(ground, bool), counts.reshape(-1)])


def _even_points(number: int) -> np.ndarray:
    """Evenly spread points in [-1, 1]^2, f32[number, 2]: an additive recurrence of the plastic number."""
    plastic = 1.32471795724474602596
    steps = np.arange(1, number + 1)[:, None] * np.array([1 / plastic, 1 / plastic**2])
    return ((0.5 + steps) % 1.0 * 2 - 1).astype(np.float32)
