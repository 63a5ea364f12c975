"""What a policy sees, everything in the queried region's frame (paper, section 3.1)."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.clouds import MAX_POINTS, placed_points, scene_cloud
from cluttergen_jax.placement.region import Region, from_pose, to_pose
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.types import Episode, History
from cluttergen_jax.types import Array

Observation = dict[str, Array | dict[str, Array]]
"""What `observe` gives, by name."""


@dataclass(frozen=True)
class ObservationConfig:
    """How much of it is spelled out.

    Attributes:
      num_scene_points: points of the scene's cloud (paper: 20,480); 0 leaves clouds out of the observation,
        to be made from poses by `placement.clouds.scene_cloud` where they are needed.
      num_object_points: points of the cloud of the current object (paper: 1,024), at most 1,024.
      num_cells: G, cells along each side of the region whose heights are told; 0 for none.
    """

    num_scene_points: int = 0
    num_object_points: int = 1024
    num_cells: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.num_cells <= 256:
            raise ConfigError(f"num_cells = {self.num_cells}", "0 to 256", "8")
        if not (0 <= self.num_scene_points <= MAX_POINTS and 1 <= self.num_object_points <= 1024):
            raise ConfigError(
                f"{self.num_scene_points} scene points and {self.num_object_points} object points",
                f"0 to {MAX_POINTS} and 1 to 1024",
            )


def observe(rules: Rules, episode: Episode, config: ObservationConfig) -> Observation:
    """The observation of one episode.

    Returns:
      region: f32[3], the region's half extents and the height range of actions, metres.
      focus: i32, the current object; is_placed: bool[K].
      T_region_object: f32[K, 7], poses of the placed objects, zero elsewhere.
      history: the failed attempts of the current object: action f32[A, 4], region f32[A, 3],
        trajectory f32[A, H, 13] (position, wxyz, linear and angular velocity), num_steps i32[A],
        is_tried bool[A]; rows not tried are zero.
      heights: f32[G, G], metres, where asked for (`height_grid`).
      scene_cloud: f32[N, 3], scene_mask: bool[N], object_cloud: f32[M, 3] (object frame), where asked for.
    """
    region = episode.region
    focus = rules.focus(episode)

    def in_region(pose: Array) -> Array:
        return to_pose(region.T_world_region.inverse() @ from_pose(pose))

    local = jax.vmap(in_region)(episode.poses)
    local = jnp.where(episode.is_placed[:, None], local, 0.0)
    observation: Observation = {
        "region": jnp.append(region.half_extents, rules.height_range(episode)),
        "focus": focus,
        "is_placed": episode.is_placed,
        "T_region_object": local,
        "history": _local_history(episode.history, region, rules.config.history_stride),
    }
    if config.num_cells:
        observation["heights"] = height_grid(
            rules.geometry.cloud, local, episode.is_placed, region.half_extents, config.num_cells
        )
    if config.num_scene_points:
        most = min(rules.geometry.num_objects, rules.num_slots)
        cloud, mask = scene_cloud(
            rules.geometry.cloud,
            local,
            episode.is_placed,
            region.half_extents,
            config.num_scene_points,
            most,
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


_GRID_POINTS = 128


def height_grid(
    cloud: Array, T_region_object: Array, is_placed: Array, half_extents: Array, num_cells: int
) -> Array:
    """The highest point of the scene's cloud over each cell of the region, f32[G, G] metres, 0 where bare.

    Args:
      cloud: f32[K, P, 3], object frames, farthest-point ordered; a prefix of it is used.
      T_region_object: f32[K, 7]; is_placed: bool[K]; half_extents: f32[2] of the region, metres.
      num_cells: G; axis 0 runs along the region's x.
    """
    points = placed_points(cloud[:, :_GRID_POINTS], T_region_object, is_placed)
    cell = jnp.floor((points[..., :2] / half_extents + 1) / 2 * num_cells).astype(jnp.int32)
    is_over = jnp.all((cell >= 0) & (cell < num_cells), axis=-1) & is_placed[:, None]
    index = jnp.where(is_over, cell[..., 0] * num_cells + cell[..., 1], num_cells**2)
    flat = jnp.zeros(num_cells**2 + 1).at[index.reshape(-1)].max(points[..., 2].reshape(-1))
    return flat[:-1].reshape(num_cells, num_cells)
