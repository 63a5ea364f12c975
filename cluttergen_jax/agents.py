"""What is trained: an environment and the network that acts in it, made for each other."""

from __future__ import annotations

from dataclasses import dataclass

from cluttergen_jax.agent.pose_agent import Learner
from cluttergen_jax.agent.ppo import Encode, as_seen
from cluttergen_jax.learners import make_learner
from cluttergen_jax.networks.config import NetworkConfig
from cluttergen_jax.networks.ranking import RankerConfig
from cluttergen_jax.physics.brax_env import Env
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.observation import ObservationConfig
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.ranking.agent import RankingLearner
from cluttergen_jax.ranking.env import RankingEnv
from cluttergen_jax.search import LowestFit


@dataclass(frozen=True, eq=False)
class Task:
    """An environment and its learner.

    Attributes:
      env: whose actions are poses, or numbers of candidate poses.
      learner: the network, bound to the world's objects.
    """

    env: Env
    learner: Learner | RankingLearner

    @property
    def encode(self) -> Encode:
        """What is added to observations when they are made (`Learner.encode`)."""
        return self.learner.encode if isinstance(self.learner, Learner) else as_seen


def make_task(rules: Rules, network: NetworkConfig | RankerConfig) -> Task:
    """The task of a policy that proposes poses, or of one that ranks those that geometry proposes."""
    learner = make_learner(rules, network)
    if isinstance(network, RankerConfig):
        return Task(RankingEnv(PlacementEnv(rules), LowestFit(rules)), learner)
    return Task(PlacementEnv(rules, ObservationConfig(num_cells=network.num_cells_read)), learner)
