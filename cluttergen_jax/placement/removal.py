"""Ruin and recreate: which placed objects to take away from a scene that is stuck (Schrimpf et al., 2000)."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from cluttergen_jax.placement.types import Episode, Geometry
from cluttergen_jax.types import Array

_SHARE = (0.5, 3.5)
"""Of the current object's footprint: so much is freed at least, drawn anew each time."""


def footprint_area(geometry: Geometry) -> Array:
    """f32[K], square metres: of each object's box, seen from above."""
    return 4 * geometry.half_extents[:, 0] * geometry.half_extents[:, 1]


def choose_removal(episode: Episode, geometry: Geometry, is_started: Array) -> Array:
    """The placed objects nearest to a random one, until enough footprint is free: bool[K].

    Drawn with the episode's key, anew after every attempt. What leans on them is for `Rules.remove` to find.

    Args:
      is_started: bool[K], those that stood there from the beginning and stay.
    """
    # Those who step an episode by themselves need not change its key.
    key = jax.random.fold_in(jax.random.fold_in(episode.key, 2), episode.counts.attempts.sum())
    key_center, key_share = jax.random.split(key)
    is_mine = episode.is_placed & ~is_started
    center = jnp.argmax(jax.random.gumbel(key_center, is_mine.shape) + jnp.where(is_mine, 0.0, -jnp.inf))
    offset = episode.poses[:, :2] - episode.poses[center, :2]
    order = jnp.argsort(jnp.where(is_mine, jnp.sum(offset**2, axis=1), jnp.inf))
    area = footprint_area(geometry)
    focus = jnp.maximum(episode.object_index[jnp.minimum(episode.slot, len(episode.object_index) - 1)], 0)
    wanted = area[focus] * jax.random.uniform(key_share, minval=_SHARE[0], maxval=_SHARE[1])
    freed = jnp.cumsum(area[order])
    is_taken = freed - area[order] < wanted
    return jnp.zeros_like(is_mine).at[order].set(is_taken) & is_mine
