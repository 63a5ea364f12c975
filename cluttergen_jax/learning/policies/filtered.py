"""A policy whose proposals are compared by geometry before physics is paid for."""

from __future__ import annotations

import jax.numpy as jnp
from flax import struct

from cluttergen_jax.learning.policies.policy import TrainedPolicy
from cluttergen_jax.placement.region import action_scale
from cluttergen_jax.placement.search import Search
from cluttergen_jax.placement.search.fit import Candidates
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.types import Array


class FilteredPolicy(struct.PyTreeNode, eq=False):
    """Many draws from a policy, lowered vertically to first contact; the cheapest by a search's cost.

    The policy says where and how turned; how high follows from what lies below.

    Attributes:
      policy: draws poses.
      search: says what is cheap, with `clear`'s cost for instance.
      num_draws: how many.
    """

    policy: TrainedPolicy
    search: Search
    num_draws: int = struct.field(pytree_node=False, default=64)

    def __call__(self, key: Array, episode: Episode) -> Array:
        """See `placement.rules.Proposer`."""
        actions = self.policy.draw(key, episode, self.num_draws)
        rules = self.search.rules
        lower, size = action_scale(episode.region, rules.height_range(episode))
        xy = lower[:2] + actions[:, :2] * size[:2]
        found = self.search.narrow(Candidates(xy, 2 * jnp.pi * actions[:, 3]), episode)
        return found.action[jnp.argmin(found.cost)]
