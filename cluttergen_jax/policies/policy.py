"""A trained policy, read from a checkpoint and bound to a world."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.agent.checkpoint import read_policy, read_policy_record
from cluttergen_jax.agent.pose_agent import Learner
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.learners import make_learner
from cluttergen_jax.networks.config import NetworkConfig
from cluttergen_jax.networks.distributions import ActionDistribution
from cluttergen_jax.networks.ranking import RankerConfig
from cluttergen_jax.placement.observation import ObservationConfig, observe
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.policies.ranked import Ranked
from cluttergen_jax.ranking.agent import RankingLearner
from cluttergen_jax.search import LowestFit
from cluttergen_jax.types import Array


@dataclass(frozen=True, eq=False)
class Policy:
    """A proposer that draws from a trained actor, or takes its mean.

    Attributes:
      rules, learner, params: of the world to act in, and the actor.
      is_sampled: draw actions; else take the mean.
      num_attempts: how many failed attempts the actor reads; those that the rules do not allow are empty.
    """

    rules: Rules
    learner: Learner
    params: Any
    is_sampled: bool
    num_attempts: int

    def __call__(self, key: Array, episode: Episode) -> Array:
        """See `placement.proposer.Proposer`."""
        dist = self.distribution(episode)
        return dist.sample(key) if self.is_sampled else dist.mean()

    def draw(self, key: Array, episode: Episode, number: int) -> Array:
        """Many actions for the same attempt, f32[number, 4]."""
        return jax.vmap(self.distribution(episode).sample)(jax.random.split(key, number))

    def distribution(self, episode: Episode) -> ActionDistribution:
        """Over the actions of one attempt."""
        dist, _ = self.learner.apply(self.params, jax.tree.map(lambda leaf: leaf[None], self.look(episode)))
        return jax.tree.map(lambda leaf: leaf[0], dist)

    def look(self, episode: Episode) -> dict[str, Any]:
        """What it sees of an episode."""
        cells = self.learner.config.num_cells_read
        seen = observe(self.rules, episode, ObservationConfig(num_cells=cells))
        missing = self.num_attempts - self.rules.config.max_attempts
        return seen | {"history": jax.tree.map(lambda rows: _padded(rows, missing), seen["history"])}


def _padded(rows: Array, missing: int) -> Array:
    return jnp.pad(rows, [(0, missing)] + [(0, 0)] * (rows.ndim - 1))


def load_policy(path: Path, rules: Rules, is_sampled: bool | None = None) -> Policy | Ranked:
    """A proposer that acts with the weights in `path`.

    Args:
      rules: of the world to act in. It must remember what the policy was trained to look back on.
      is_sampled: draw actions, or take the distribution's mean; by default poses are drawn, and of
        candidates the best is taken.

    Raises:
      PoolError: the checkpoint is missing or damaged.
      ConfigError: the world's history is not what the policy reads. Fewer attempts are; more are not.
    """
    record = read_policy_record(path)
    network, trained = _settings_of(path, record)
    if isinstance(network, RankerConfig):
        policy = make_policy(rules, network, None, bool(is_sampled))
    else:
        _check_history(trained, rules)
        policy = make_policy(rules, network, None, is_sampled is not False)
        policy = replace(policy, num_attempts=trained["max_attempts"])
    # Only shapes are needed: drawing fresh parameters would take longer to compile than acting does.
    seen = jax.eval_shape(lambda: policy.look(rules.begin(jax.random.key(0))))
    shapes = jax.eval_shape(policy.learner.init, jax.random.key(0), seen)
    blank = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes)
    return replace(policy, params=read_policy(path, blank))


def _settings_of(path: Path, record: dict[str, Any]) -> tuple[NetworkConfig | RankerConfig, dict[str, Any]]:
    """The network's sizes and the decision process that a policy was trained in."""
    try:
        stored = record["network"]
        kind = RankerConfig if "cost_scale" in stored else NetworkConfig
        return kind(**stored), record["placement"]
    except (KeyError, TypeError) as error:
        raise PoolError(
            f"{path / 'record.json'} does not say what network it holds ({error})",
            hint="a policy that `cluttergen train` of this version left",
        ) from error


def _check_history(trained: dict[str, Any], rules: Rules) -> None:
    """Refuses rules whose history a policy cannot read; fewer attempts than it knows it can."""
    most, stride = trained["max_attempts"], trained["history_stride"]
    if rules.config.max_attempts > most:
        raise ConfigError(
            f"max_attempts = {rules.config.max_attempts} with a policy trained with {most}",
            f"1 to {most}",
            f"cluttergen train --attempts {rules.config.max_attempts}",
        )
    if rules.config.history_stride != stride:
        raise ConfigError(
            f"history_stride = {rules.config.history_stride} with a policy trained with {stride}",
            f"history_stride = {stride}",
        )


def make_policy(
    rules: Rules, network: NetworkConfig | RankerConfig, params: Any, is_sampled: bool
) -> Policy | Ranked:
    """A proposer with given weights; with other weights it is `dataclasses.replace(policy, params=...)`."""
    learner = make_learner(rules, network)
    if isinstance(learner, RankingLearner):
        return Ranked(LowestFit(rules), learner, params, is_sampled)
    return Policy(rules, learner, params, is_sampled, rules.config.max_attempts)
