"""Trained policies as proposers: an agent with its weights in a world."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from cluttergen_jax.errors import ConfigError, range_text
from cluttergen_jax.learning.agents import Agent, make_agent
from cluttergen_jax.learning.networks.config import NetworkConfig
from cluttergen_jax.learning.policies.checkpoint import Checkpoint, TrainedPlacement
from cluttergen_jax.learning.ppo.checkpoint import blank, read_policy
from cluttergen_jax.numerics import new_key
from cluttergen_jax.placement import Episode, Rules
from cluttergen_jax.placement.observation import Observation, observe
from cluttergen_jax.types import Array


class TrainedPolicy(struct.PyTreeNode, eq=False):
    """A proposer that draws from an agent's distribution, or takes its mean.

    Attributes:
      rules: of the world.
      agent, params: the network and its weights.
      is_sampled: draw actions; else take the mean.
      num_attempts: how many failed attempts the agent reads; those that the rules do not allow are empty.
    """

    rules: Rules
    agent: Agent
    params: Any
    is_sampled: bool = struct.field(pytree_node=False)
    num_attempts: int = struct.field(pytree_node=False)

    in_parts = False
    """Large layers are fastest over many episodes, and give other bits over fewer."""

    def __call__(self, key: Array, episode: Episode) -> Array:
        """See `placement.rules.Proposer`."""
        seen = jax.tree.map(lambda leaf: leaf[None], self.observe(episode))
        dist = jax.tree.map(lambda leaf: leaf[0], self.agent.apply(self.params, seen)[0])
        return dist.sample(key) if self.is_sampled else dist.mean()

    def observe(self, episode: Episode) -> Observation:
        """What the agent sees of an episode."""
        seen = observe(self.rules, episode, self.agent.observation)
        missing = self.num_attempts - self.rules.config.max_attempts
        if missing == 0:
            return seen
        return seen | {
            "history": jax.tree.map(lambda rows: _pad_rows(rows, missing), seen["history"])
        }


def _pad_rows(rows: Array, missing: int) -> Array:
    return jnp.pad(rows, [(0, missing)] + [(0, 0)] * (rows.ndim - 1))


def make_policy(
    rules: Rules, network: NetworkConfig, params: Any = None, is_sampled: bool = True
) -> TrainedPolicy:
    """A policy with given weights; with other weights it is `dataclasses.replace(policy, params=...)`.

    Args:
      is_sampled: draw actions; else take the distribution's mean.
    """
    agent = make_agent(rules, network)
    return TrainedPolicy(rules, agent, params, is_sampled, rules.config.max_attempts)


def load_policy(checkpoint: Checkpoint, rules: Rules, is_sampled: bool = True) -> TrainedPolicy:
    """A policy with the weights of a checkpoint.

    Args:
      rules: of the world to act in. It must remember what the policy was trained to look back on.
      is_sampled: see `make_policy`.

    Raises:
      PoolError: the checkpoint is damaged.
      ConfigError: the world's history is not what the policy reads. Fewer attempts are; more are not.
    """
    policy = make_policy(rules, checkpoint.network, None, is_sampled)
    trained = checkpoint.trained.placement
    _check_history(trained, rules)
    policy = replace(policy, num_attempts=trained.max_attempts)
    # Only shapes are needed: drawing fresh parameters would take longer to compile than acting does.
    seen = jax.eval_shape(lambda: policy.observe(rules.begin(new_key(0))))
    fresh = blank(policy.agent.init, new_key(0), seen)
    return replace(policy, params=read_policy(checkpoint.path, fresh))


def _check_history(trained: TrainedPlacement, rules: Rules) -> None:
    """Refuses rules whose history a policy cannot read; fewer attempts than it knows it can."""
    most = trained.max_attempts
    stride = trained.history_stride
    if rules.config.max_attempts > most:
        raise ConfigError(
            f"max_attempts = {rules.config.max_attempts} with a policy trained with {most}",
            range_text(1, most),
            f"cluttergen train --max-attempts {rules.config.max_attempts}",
        )
    if rules.config.history_stride != stride:
        raise ConfigError(
            f"history_stride = {rules.config.history_stride} with a policy trained with {stride}",
            f"history_stride = {stride}",
        )
