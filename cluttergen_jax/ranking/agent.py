"""The agent that ranks candidate poses."""

from __future__ import annotations

from dataclasses import dataclass

from cluttergen_jax.agent.agent import Agent
from cluttergen_jax.networks.ranking import Ranker, RankerConfig


@dataclass(frozen=True, eq=False)
class RankingAgent(Agent):
    """A ranker whose action is the number of a candidate in the observation, i32."""

    config: RankerConfig

    @property
    def network(self) -> Ranker:
        """See `Agent.network`."""
        return Ranker(self.config, self.max_objects)
