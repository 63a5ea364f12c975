"""`packed`: objects upright, shoulder to shoulder, each box a clearance away from the next."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from cluttergen_jax.placement.methods.baselines import LowestFit
from cluttergen_jax.placement.region import action_of_pose, from_pose, safe_poses
from cluttergen_jax.placement.search import CLEARANCE, FORBIDDEN, Candidates
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.types import Array

_MOST_PLACES = 8192
"""Looked at for an object; where there are more, so many are drawn."""
# Metres beyond the clearance at which boxes count as side by side; of float32.
_TOUCHING = 0.002
_ROUNDING = 1e-5

# Cost of the far corner over that of a perimeter that touches nothing; noise after a failed attempt.
_FAR = 0.6
_SHY = 0.5


class Packed(LowestFit, eq=False):
    """Puts a box where most of its perimeter is next to other boxes and to the region's sides.

    Boxes are seen from above, along the region's sides (touching perimeter: Lodi, Martello and Vigo, 1999).
    Looked at are all places at which the box is next to something on one side in x and in y; those near one
    corner come first, which depends on the scene's objects. Where the top has no room, the object is lowered
    to where it lies lowest, as by `drop`.
    """

    def __call__(self, key: Array, episode: Episode) -> Array:
        """See `placement.rules.Proposer`."""
        key_place, key_half, key_cost, key_drop = jax.random.split(key, 4)
        rules = self.rules
        region = episode.region
        focus = self.rules.focus(episode)
        half = rules.geometry.half_extents[focus]
        clearance = rules.config.clearance
        center, side, is_there = self._standing(episode)
        xy, size = _places(
            key_place, region.half_extents, half[:2], center, side, is_there, clearance
        )
        yaw = jnp.where(size[:, 0] == half[0], 0.0, jnp.pi / 2)
        yaw += jnp.pi * jax.random.bernoulli(key_half, shape=yaw.shape)
        is_free = jnp.all(jnp.abs(xy) <= region.half_extents - size - clearance + _ROUNDING, axis=1)
        reach = size[:, None] + side + clearance - _ROUNDING
        overlaps = jnp.all(jnp.abs(xy[:, None] - center) < reach, axis=-1) & is_there
        is_free &= ~jnp.any(overlaps, axis=1) & self._is_allowed(
            self.scene(episode), Candidates(xy, yaw)
        )
        touched = _touching_share(xy, size, region.half_extents, center, side, is_there, clearance)
        corner = jnp.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])[episode.object_index[0] % 4]
        away = jnp.linalg.norm(xy - corner * region.half_extents, axis=1)
        noise = jax.random.uniform(key_cost, yaw.shape) * _SHY * (episode.attempt > 0)
        cost = _FAR * away / (2 * jnp.linalg.norm(region.half_extents)) - touched + noise
        best = jnp.argmin(jnp.where(is_free, cost, FORBIDDEN))
        position = jnp.append(xy[best], half[2] + CLEARANCE)
        action = action_of_pose(position, yaw[best], region, rules.height_range(episode))
        return jnp.where(is_free.any(), action, super().__call__(key_drop, episode))

    def _standing(self, episode: Episode) -> tuple[Array, Array, Array]:
        """Boxes that stand there, in the region frame, seen from above: f32[S, 2], half sides, bool[S]."""
        index = jnp.maximum(episode.object_index, 0)
        is_there = (jnp.arange(len(index)) < episode.slot) & (episode.object_index >= 0)
        pose = safe_poses(episode.poses[index], is_there)
        T_region_object = jax.vmap(
            lambda each: episode.region.T_world_region.inverse() @ from_pose(each)
        )(pose)
        turn = T_region_object.rotation().as_matrix()
        half = jnp.einsum("sij,sj->si", jnp.abs(turn), self.rules.geometry.half_extents[index])
        return T_region_object.translation()[:, :2], half[:, :2], is_there


def _places(
    key: Array,
    room: Array,
    half: Array,
    center: Array,
    side: Array,
    is_there: Array,
    clearance: float,
) -> tuple[Array, Array]:
    """Where a box is next to something in x and in y, unturned and turned: f32[M, 2] and half sides."""
    sizes = jnp.stack([half, half[::-1]])

    def along(axis: int, size: Array) -> Array:
        reach = side[:, axis] + size[axis] + clearance
        beside = jnp.concatenate([center[:, axis] - reach, center[:, axis] + reach])
        # What does not stand there makes places beyond the region.
        beside = jnp.where(jnp.tile(is_there, 2), beside, 2 * room[axis])
        limit = room[axis] - size[axis] - clearance
        return jnp.concatenate([jnp.stack([-limit, limit]), beside])

    places = jnp.stack([jnp.stack([along(0, size), along(1, size)]) for size in sizes])
    number = places.shape[-1]
    total = 2 * number * number
    is_many = total > _MOST_PLACES
    chosen = jax.random.randint(key, (_MOST_PLACES,), 0, total) if is_many else jnp.arange(total)
    turned = chosen // number**2
    i = chosen // number % number
    j = chosen % number
    return jnp.stack([places[turned, 0, i], places[turned, 1, j]], axis=-1), sizes[turned]


def _touching_share(
    xy: Array,
    size: Array,
    room: Array,
    center: Array,
    side: Array,
    is_there: Array,
    clearance: float,
) -> Array:
    """f32[M]: the share of each box's perimeter that is next to a side of the region or to another box."""
    near = clearance + _TOUCHING
    offset = xy[:, None] - center
    reach = size[:, None] + side
    touched = jnp.zeros(len(xy))
    for axis in (0, 1):
        across = 1 - axis
        low = jnp.maximum(xy[:, None] - size[:, None], center - side)[..., across]
        high = jnp.minimum(xy[:, None] + size[:, None], center + side)[..., across]
        shared = jnp.maximum(high - low, 0.0) * is_there
        for sign in (-1.0, 1.0):
            gap = sign * offset[..., axis] - reach[..., axis]
            beside = jnp.where((gap > 0) & (gap < near), shared, 0.0).sum(1)
            is_wall = room[axis] + sign * xy[:, axis] - size[:, axis] < near
            touched += jnp.where(
                is_wall, 2 * size[:, across], jnp.minimum(beside, 2 * size[:, across])
            )
    return touched / (4 * size.sum(1))
