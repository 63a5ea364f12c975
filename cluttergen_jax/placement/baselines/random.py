"""Rejection sampling: anywhere in the region, at the object's own height unless that is free."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

from cluttergen_jax.placement.region import action_of_pose
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.search.search import CLEARANCE
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.types import Array


class Random(struct.PyTreeNode, eq=False):
    """A uniform position and turn on the support's surface (the paper's RRS, with its height mended).

    With `PlacementConfig.height` "free" the height is uniform in the region's range, too.
    """

    rules: Rules

    def __call__(self, key: Array, episode: Episode) -> Array:
        """See `placement.rules.Proposer`."""
        key_position, key_turn = jax.random.split(key)
        region, focus = episode.region, self.rules.focus(episode)
        xy = jax.random.uniform(key_position, (2,), minval=-1.0) * region.half_extents
        yaw = jax.random.uniform(key_turn, maxval=2 * jnp.pi)
        height, height_range = (
            self.rules.geometry.half_extents[focus, 2] + CLEARANCE,
            self.rules.height_range(episode),
        )
        if self.rules.config.height == "free":
            height = jax.random.uniform(jax.random.fold_in(key, 0), maxval=height_range)
        return action_of_pose(jnp.append(xy, height), yaw, region, height_range)
