"""From the rules of an episode and a network's sizes to an environment and the agent that acts in it."""

from __future__ import annotations

from typing import NamedTuple

from cluttergen_jax.learning.networks.config import AgentConfig, NetworkConfig
from cluttergen_jax.learning.networks.ranking import RankerConfig
from cluttergen_jax.learning.ppo.agent import Agent
from cluttergen_jax.learning.ppo.pose_agent import PoseAgent
from cluttergen_jax.learning.ranking.agent import RankingAgent
from cluttergen_jax.learning.ranking.env import RankingEnv
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.observation import ObservationConfig
from cluttergen_jax.placement.rules import Rules


class Kind(NamedTuple):
    """A kind of agent.

    Attributes:
      config: the class of its network's sizes.
      agent: binds the network to a world.
      env: whose observations it reads, and whose actions it chooses.
    """

    config: type[AgentConfig]
    agent: type[Agent]
    env: type[PlacementEnv]


KINDS = {
    "pose": Kind(NetworkConfig, PoseAgent, PlacementEnv),
    "ranking": Kind(RankerConfig, RankingAgent, RankingEnv),
}
"""By the name that stands in a checkpoint's record (`AgentConfig.kind`)."""


def make_agent(rules: Rules, network: AgentConfig) -> tuple[PlacementEnv, Agent]:
    """The environment and the agent of the kind that `network` is of."""
    kind, geometry = KINDS[network.kind], rules.geometry
    agent = kind.agent(
        network,
        geometry.cloud,
        geometry.half_extents,
        min(rules.num_slots, geometry.num_objects),
        region_side=2 * float(rules.region.half_extents.max()),
    )
    return kind.env(rules, ObservationConfig(num_cells=network.num_cells_read)), agent
