"""The network bound to a world's objects: what PPO trains and what a trained policy proposes with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from cluttergen_jax.networks.actor_critic import ActorCritic, NetworkConfig
from cluttergen_jax.networks.distributions import ActionDistribution
from cluttergen_jax.placement.observation import ObservationConfig, observe
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.types import Array

Params = Any


@dataclass(frozen=True, eq=False)
class Learner:
    """An actor-critic that knows a world's clouds.

    Attributes:
      rules: the decision process, for its geometry and observations.
      config: the network's sizes.
    """

    rules: Rules
    config: NetworkConfig

    @property
    def network(self) -> ActorCritic:
        """The module; its parameters do not depend on the world, only on sizes in the config."""
        return ActorCritic(self.config, min(self.rules.num_slots, self.rules.geometry.num_objects))

    def init(self, key: Array) -> Params:
        """Fresh parameters."""
        episode = jax.eval_shape(self.rules.begin, jax.random.key(0))
        shapes = jax.eval_shape(lambda e: observe(self.rules, e, ObservationConfig()), episode)
        blank = jax.tree.map(lambda leaf: jnp.zeros((1, *leaf.shape), leaf.dtype), shapes)
        geometry = self.rules.geometry
        return jax.jit(self.network.init)(key, geometry.cloud, geometry.half_extents, blank)

    def apply(self, params: Params, observation: Any) -> tuple[ActionDistribution, Array]:
        """The action distribution and the values f32[B] of observations with a leading axis B."""
        geometry = self.rules.geometry
        return self.network.apply(params, geometry.cloud, geometry.half_extents, observation)

    def propose(self, params: Params, key: Array, episode: Episode, is_sampled: bool) -> Array:
        """An action f32[4] for one episode: a draw, or the mean."""
        seen = observe(self.rules, episode, ObservationConfig())
        dist, _ = self.apply(params, jax.tree.map(lambda leaf: leaf[None], seen))
        action = dist.sample(key) if is_sampled else dist.mean()
        return action[0]
