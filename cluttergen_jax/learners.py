"""The network that a config asks for, bound to a world's objects."""

from __future__ import annotations

from cluttergen_jax.agent.pose_agent import Learner
from cluttergen_jax.networks.config import NetworkConfig
from cluttergen_jax.networks.ranking import RankerConfig
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.ranking.agent import RankingLearner


def make_learner(rules: Rules, network: NetworkConfig | RankerConfig) -> Learner | RankingLearner:
    """One that proposes poses, or one that ranks those that geometry proposes."""
    geometry = rules.geometry
    bound = (geometry.cloud, geometry.half_extents, min(rules.num_slots, geometry.num_objects))
    if isinstance(network, RankerConfig):
        return RankingLearner(network, *bound)
    return Learner(network, *bound, region_side=2 * float(rules.region.half_extents.max()))
