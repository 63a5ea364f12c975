"""The agent that ranks candidate poses."""

from __future__ import annotations

from flax import struct

from cluttergen_jax.learning.networks.ranking import Ranker, RankerConfig
from cluttergen_jax.learning.ppo.agent import Agent


class RankingAgent(Agent, eq=False):
    """A ranker whose action is the number of a candidate in the observation, i32."""

    config: RankerConfig = struct.field(pytree_node=False)

    @property
    def network(self) -> Ranker:
        """See `Agent.network`."""
        return Ranker(self.config, self.max_objects)
