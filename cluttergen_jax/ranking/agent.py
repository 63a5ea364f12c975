"""The ranker bound to a world's objects: what PPO trains and what a trained ranking proposes with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from cluttergen_jax.networks.distributions import Categorical
from cluttergen_jax.networks.ranking import Ranker, RankerConfig
from cluttergen_jax.types import Array

Params = Any


@dataclass(frozen=True, eq=False)
class RankingLearner:
    """A ranker that knows a world's clouds.

    Attributes:
      config: the network's sizes.
      cloud: f32[K, P, 3], every object's, object frames, metres.
      half_extents: f32[K, 3], metres.
      max_objects: the most objects that can stand at once.
    """

    config: RankerConfig
    cloud: Array
    half_extents: Array
    max_objects: int

    @property
    def network(self) -> Ranker:
        """The module; its parameters depend on sizes in the config alone, not on the world."""
        return Ranker(self.config, self.max_objects)

    def init(self, key: Array, observation: Any) -> Params:
        """Fresh parameters; `observation` is one, or its shapes, without a leading axis."""
        blank = jax.tree.map(lambda leaf: jnp.zeros((1, *leaf.shape), leaf.dtype), observation)
        return jax.jit(self.network.init)(key, self.cloud, self.half_extents, blank)

    def apply(self, params: Params, observation: Any) -> tuple[Categorical, Array]:
        """The distribution over the menu and the values f32[B] of observations with a leading axis B."""
        return self.network.apply(params, self.cloud, self.half_extents, observation)
