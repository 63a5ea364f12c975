"""Ruin and recreate: which placed objects to take away from a scene that is stuck (Schrimpf et al., 2000)."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from cluttergen_jax.placement.boxes import footprint_area
from cluttergen_jax.placement.related import RelatedObjects
from cluttergen_jax.placement.support_graph import graph_without, supported_by
from cluttergen_jax.placement.types import Episode, Geometry, Start
from cluttergen_jax.types import Array

_SHARE = (0.5, 3.5)
"""Of the current object's footprint: so much is freed at least, drawn anew each time."""


def choose_removal(episode: Episode, geometry: Geometry, is_started: Array) -> Array:
    """The placed objects nearest to a random one, until enough footprint is free: bool[K].

    Drawn with the episode's key, anew after every attempt. What leans on them is for `remove` to find.

    Args:
      is_started: bool[K], those that stood there from the beginning and stay.
    """
    # Those who step an episode by themselves need not change its key.
    key = jax.random.fold_in(jax.random.fold_in(episode.key, 2), episode.counts.attempts.sum())
    key_center, key_share = jax.random.split(key)
    is_mine = episode.is_placed & ~is_started
    center = jnp.argmax(
        jax.random.gumbel(key_center, is_mine.shape) + jnp.where(is_mine, 0.0, -jnp.inf)
    )
    offset = episode.poses[:, :2] - episode.poses[center, :2]
    order = jnp.argsort(jnp.where(is_mine, jnp.sum(offset**2, axis=1), jnp.inf))
    area = footprint_area(geometry.half_extents)
    focus = jnp.maximum(
        episode.object_index[jnp.minimum(episode.slot, len(episode.object_index) - 1)], 0
    )
    wanted = area[focus] * jax.random.uniform(key_share, minval=_SHARE[0], maxval=_SHARE[1])
    freed = jnp.cumsum(area[order])
    is_taken = freed - area[order] < wanted
    return jnp.zeros_like(is_mine).at[order].set(is_taken) & is_mine


def remove(
    episode: Episode, which: Array, geometry: Geometry, related: RelatedObjects | None = None
) -> Episode:
    """The episode without some placed objects, and without all that leans on them.

    They come again, after the current object. What was spent on them stays counted, in their new slots.

    Args:
      which: bool[K]; of what stood there from the beginning nothing is taken.
    """
    is_mine = episode.is_placed & ~episode.is_started
    which = supported_by(which & is_mine, episode.support_graph.leans_on & is_mine[:, None])
    slots = jnp.arange(len(episode.object_index))
    index = jnp.maximum(episode.object_index, 0)
    is_kept = (slots < episode.slot) & ~which[index]
    group = jnp.where(is_kept, 0, jnp.where(slots == episode.slot, 1, 2))
    last = 3
    if related is not None and episode.roles is not None:
        # Nothing comes before that to which it is placed.
        group = jnp.where(is_kept, 0, 1 + related.priority(episode.roles)[index])
        last = related.num_roles + 2
    order = jnp.argsort(jnp.where(episode.object_index < 0, last, group), stable=True)
    counts = episode.counts
    return episode.replace(
        object_index=episode.object_index[order],
        slot=is_kept.sum().astype(jnp.int32),
        attempt=jnp.int32(0),
        poses=jnp.where(which[:, None], Start.empty(len(which)).poses, episode.poses),
        is_placed=episode.is_placed & ~which,
        history=jax.tree.map(jnp.zeros_like, episode.history),
        counts=counts.replace(
            attempts=counts.attempts[order],
            steps=counts.steps[order],
            rest_steps=jnp.where(is_kept, counts.rest_steps, 0)[order],
        ),
        support_graph=graph_without(episode.support_graph, which, geometry),
    )
