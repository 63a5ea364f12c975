"""Queried regions: from an action to a pose, and from a settled pose to "inside" or "outside"."""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import jaxlie
from flax import struct

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.numerics import with_own_settings
from cluttergen_jax.types import Array


class Region(struct.PyTreeNode):
    """A rectangle on the support's top in which objects are to be placed.

    Attributes:
      T_world_region: origin at the rectangle's centre on the top, x along its first side, z up.
      half_extents: f32[2], metres, along its x and y.
    """

    T_world_region: jaxlie.SE3
    half_extents: Array


class KeepOut(struct.PyTreeNode):
    """Upright boxes that settled objects must stay out of, seen from above.

    Attributes:
      center: f32[B, 2], world x and y, metres.
      half_extents: f32[B, 2], metres.
      yaw: f32[B], radians.
    """

    center: Array
    half_extents: Array
    yaw: Array


@with_own_settings
def make_region(
    center: Array, half_extents: Array, yaw: Array, top: Array, surface: Array | None = None
) -> Region:
    """A region on a flat top, or on a surface that is not level; all arguments may be traced.

    Args:
      center: f32[2], metres, world x and y.
      half_extents: f32[2], metres, half its sides, along its own x and y.
      yaw: f32, radians, from world x to its own x.
      top: f32, metres, the height of the support's top (`SupportAsset.top`).
      surface: f32[7], the pose of a surface's frame (`Surface.pose`), in which the others are then, `top`
        above it; None for the world's.
    """
    position = jnp.append(jnp.asarray(center, jnp.float32), jnp.asarray(top, jnp.float32))
    rotation = jaxlie.SO3.from_z_radians(jnp.asarray(yaw, jnp.float32))
    T = jaxlie.SE3.from_rotation_and_translation(rotation, position)
    if surface is not None:
        T = from_pose(jnp.asarray(surface, jnp.float32)) @ T
    return Region(T, jnp.asarray(half_extents, jnp.float32))


def no_keep_out() -> KeepOut:
    """No box at all."""
    return KeepOut(jnp.zeros((0, 2)), jnp.zeros((0, 2)), jnp.zeros((0,)))


def to_pose(transform: jaxlie.SE3) -> Array:
    """f32[..., 7]: position, then quaternion wxyz."""
    return jnp.concatenate([transform.translation(), transform.rotation().wxyz], axis=-1)


def from_pose(pose: Array) -> jaxlie.SE3:
    """The inverse of `to_pose`."""
    return jaxlie.SE3.from_rotation_and_translation(jaxlie.SO3(pose[..., 3:]), pose[..., :3])


def safe_poses(poses: Array, is_there: Array) -> Array:
    """f32[K, 7]: poses, the identity for objects that are not there, bool[K]: theirs may be anything."""
    return jnp.where(is_there[:, None], poses, jnp.eye(7, dtype=jnp.float32)[3])


def action_scale(region: Region, height_range: Array) -> tuple[Array, Array]:
    """The corner of action 0 and the size of the action box in the region frame, f32[3] each.

    Args:
      height_range: f32, metres: the tallest placed object's height plus that of the current object.
    """
    lower = jnp.append(-region.half_extents, 0.0)
    return lower, jnp.append(2 * region.half_extents, height_range)


def pose_of_action(
    action: Array, region: Region, height_range: Array, quaternion: Array | None = None
) -> Array:
    """The world pose f32[7] that an action in (0,1)^4 proposes for the object's origin (docs/contract.md).

    Args:
      quaternion: f32[4], wxyz, the orientation that is turned about z; None for upright.
    """
    lower, size = action_scale(region, height_range)
    rotation = jaxlie.SO3.from_z_radians(2 * jnp.pi * action[3])
    if quaternion is not None:
        rotation = rotation @ jaxlie.SO3(quaternion)
    T_region_object = jaxlie.SE3.from_rotation_and_translation(rotation, lower + action[:3] * size)
    return to_pose(region.T_world_region @ T_region_object)


def action_of_pose(position: Array, yaw: Array, region: Region, height_range: Array) -> Array:
    """The action that proposes a position in the region frame, f32[3] metres, and a yaw in radians.

    Clipped to [0, 1]: a pose outside the region has no action.
    """
    lower, size = action_scale(region, height_range)
    turn = jnp.mod(yaw / (2 * jnp.pi), 1.0)
    return jnp.clip(jnp.append((position - lower) / size, turn), 0.0, 1.0)


def box_corners(pose: Array, half_extents: Array) -> Array:
    """The eight world corners of an object's box: f32[8, 3] from f32[7] and f32[3]."""
    ends = [jnp.array([-1.0, 1.0])] * 3
    signs = jnp.stack(jnp.meshgrid(*ends, indexing="ij"), axis=-1).reshape(8, 3)
    return jax.vmap(from_pose(pose).apply)(signs * half_extents)


def is_inside(pose: Array, half_extents: Array, region: Region, containment: str) -> Array:
    """Whether a settled object lies in the region.

    Args:
      pose: f32[7], world; half_extents: f32[3] of the object's box; containment: "center" or "footprint".
    """
    points = pose[None, :3] if containment == "center" else box_corners(pose, half_extents)
    local = jax.vmap(region.T_world_region.inverse().apply)(points)[:, :2]
    return jnp.all(jnp.abs(local) <= region.half_extents + 1e-6)


def is_in_polygon(xy: Array, polygon: Array) -> Array:
    """bool[...]: whether points f32[..., 2] are within a polygon f32[E, 2], by the edges to their right."""
    start = polygon
    end = jnp.roll(polygon, -1, axis=0)
    x = xy[..., 0, None]
    y = xy[..., 1, None]
    is_level = (start[:, 1] > y) != (end[:, 1] > y)
    rise = jnp.where(start[:, 1] == end[:, 1], 1.0, end[:, 1] - start[:, 1])
    crossing = start[:, 0] + (y - start[:, 1]) / rise * (end[:, 0] - start[:, 0])
    return jnp.sum(is_level & (x < crossing), axis=-1) % 2 == 1


def is_kept_out(pose: Array, half_extents: Array, keep_out: KeepOut) -> Array:
    """Whether an object's footprint meets any keep-out box: separating axes, never too lenient."""
    corners = box_corners(pose, half_extents)[:, :2]
    heading = from_pose(pose).rotation().as_matrix()[:2, 0]
    heading = heading / jnp.maximum(jnp.linalg.norm(heading), 1e-6)

    def meets(center: Array, half: Array, yaw: Array) -> Array:
        side = jnp.array([jnp.cos(yaw), jnp.sin(yaw)])
        signs = jnp.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
        box = center + (signs * half @ jnp.stack([side, _perpendicular(side)]))
        axes = jnp.stack([side, _perpendicular(side), heading, _perpendicular(heading)])
        ours = corners @ axes.T
        theirs = box @ axes.T
        return jnp.all((ours.min(0) <= theirs.max(0)) & (theirs.min(0) <= ours.max(0)))

    return jnp.any(jax.vmap(meets)(keep_out.center, keep_out.half_extents, keep_out.yaw))


def _perpendicular(direction: Array) -> Array:
    return jnp.array([-direction[1], direction[0]])


SMALLEST_HALF = 0.05
"""Metres: no half extent is made smaller than this, but to fit a turned region onto its table."""
_TRIED = 256
"""First sides that are tried when a turned region has to be shrunk."""
_TINY = 1e-9


@dataclass(frozen=True)
class RegionChange:
    """How much a region is changed at most; every draw is uniform.

    Attributes:
      translation: metres to either side, in x and in y.
      rotation: radians to either side.
      shrinkage, expansion: metres by which each half extent, by itself, becomes smaller or larger.
    """

    translation: float = 0.0
    rotation: float = 0.0
    shrinkage: float = 0.0
    expansion: float = 0.0


REGION_CHANGES = {
    "none": RegionChange(),
    "translation": RegionChange(translation=0.15),
    "rotation": RegionChange(rotation=math.pi),
    "shrinkage": RegionChange(shrinkage=0.10),
    "expansion": RegionChange(expansion=0.10),
    "all": RegionChange(translation=0.15, rotation=math.pi, shrinkage=0.10, expansion=0.10),
}
"""The paper's changes, with its ranges."""


def find_change(name: str) -> RegionChange:
    """The change called `name`; ConfigError where there is none."""
    if name not in REGION_CHANGES:
        raise ConfigError(
            f"region change {name!r}",
            ", ".join(REGION_CHANGES),
            meant=closest(name, REGION_CHANGES),
        )
    return REGION_CHANGES[name]


@dataclass(frozen=True)
class ChangedRegion:
    """Draws a region for each episode around `base`, wholly inside `bounds`; two that draw alike are equal.

    What is too large for the bounds once turned is shrunk, one side or both, so that the most area is left,
    then moved inwards by as little as it takes: a region stays on its table.

    Attributes:
      base: the region to change; bounds: the part of the top that may be used; both world, metres.
      top, surface: see `make_region`.
    """

    change: RegionChange
    base: Rectangle
    bounds: Rectangle
    top: float
    surface: tuple[float, ...] | None = None

    def __call__(self, key: Array) -> Region:
        """A region drawn with `key`, consumed."""
        change = self.change
        base = self.base
        bounds = self.bounds
        key_shift, key_turn, key_size = jax.random.split(key, 3)
        shift = jax.random.uniform(key_shift, (2,), minval=-1.0) * change.translation
        turn = jax.random.uniform(key_turn, (), minval=-1.0) * change.rotation
        growth = jax.random.uniform(
            key_size, (2,), minval=-change.shrinkage, maxval=change.expansion
        )
        least = jnp.minimum(SMALLEST_HALF, min(base.half_extents))
        half = jnp.maximum(jnp.array(base.half_extents) + growth, least)
        yaw = base.yaw + turn
        cos = jnp.abs(jnp.cos(yaw - bounds.yaw))
        sin = jnp.abs(jnp.sin(yaw - bounds.yaw))
        room = jnp.array(bounds.half_extents)
        half = _fit_half_extents(half, cos, sin, room)
        reach = jnp.stack([cos * half[0] + sin * half[1], sin * half[0] + cos * half[1]])
        along = [math.cos(bounds.yaw), math.sin(bounds.yaw)]
        to_world = jnp.array([[along[0], -along[1]], [along[1], along[0]]])
        offset = to_world.T @ (jnp.array(base.center) + shift - jnp.array(bounds.center))
        slack = jnp.maximum(room - reach, 0.0)
        center = jnp.array(bounds.center) + to_world @ jnp.clip(offset, -slack, slack)
        pose = None if self.surface is None else jnp.array(self.surface, jnp.float32)
        return make_region(center, half, yaw, jnp.float32(self.top), pose)


def _fit_half_extents(half: Array, cos: Array, sin: Array, room: Array) -> Array:
    """The largest half extents f32[2], none above `half`, of a turned rectangle that fits into `room`."""
    first = half[0] * jnp.linspace(1 / _TRIED, 1.0, _TRIED)
    second = jnp.minimum(
        (room[0] - cos * first) / jnp.maximum(sin, _TINY),
        (room[1] - sin * first) / jnp.maximum(cos, _TINY),
    )
    second = jnp.minimum(second, half[1])
    best = jnp.argmax(first * second)
    return jnp.stack([first[best], second[best]])
