"""Finished episodes as scenes: the product, without what was only needed on the way."""

from __future__ import annotations

import jax.numpy as jnp
from flax import struct

from cluttergen_jax.placement.types import Counts, Episode
from cluttergen_jax.types import Array

BLOCK_SIZE = 256
"""Scenes of a full block, sampled and stored as one; block b begins with scene 256 b (docs/contract.md)."""


class Scenes(struct.PyTreeNode):
    """Finished episodes, failures included. S slots, any leading axes.

    Attributes:
      object_index: i32[S], the compiled world's object in each slot, -1 where there is none.
      is_placed: bool[S], the slot was filled.
      T_world_object: f32[S, 7], world pose of each slot's object (zero and identity where not placed).
      is_success: bool, every slot filled and the finished scene stands.
      is_filled: bool, every slot filled.
      verdict: i32, the last check's `Verdict`, or the last failed attempt's.
      drift: f32, metres, the largest movement in the last check.
      counts: the episode's figures.
    """

    object_index: Array
    is_placed: Array
    T_world_object: Array
    is_success: Array
    is_filled: Array
    verdict: Array
    drift: Array
    counts: Counts


def scenes_of(episode: Episode) -> Scenes:
    """The product of one finished episode."""
    index = episode.object_index
    is_placed = (jnp.arange(index.shape[0]) < episode.slot) & (index >= 0)
    poses = jnp.where(
        is_placed[:, None], episode.poses[jnp.maximum(index, 0)], jnp.eye(7, dtype=jnp.float32)[3]
    )
    return Scenes(
        object_index=index,
        is_placed=is_placed,
        T_world_object=poses,
        is_success=episode.is_success,
        is_filled=episode.slot >= episode.num_slots,
        verdict=episode.verdict,
        drift=episode.drift,
        counts=episode.counts,
    )
