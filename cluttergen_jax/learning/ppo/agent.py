"""The agent protocol: a network bound to a world's objects, which PPO trains and a policy acts with."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
from flax import struct

from cluttergen_jax.learning.ppo.ppo import as_seen
from cluttergen_jax.types import Array

Params = Any


class Agent(struct.PyTreeNode, ABC, eq=False):
    """A network that knows a world's point clouds.

    A kind of agent says what its `network` is, and where needed how observations are prepared for it.

    Attributes:
      config: the network's sizes (`learning.networks.config.AgentConfig`).
      cloud: f32[K, P, 3], every object's, object frames, metres.
      half_extents: f32[K, 3], metres.
      max_objects: the most objects that can stand at once.
      region_side: of the larger regions to be expected, metres.
    """

    config: Any = struct.field(pytree_node=False)
    cloud: Array
    half_extents: Array
    max_objects: int = struct.field(pytree_node=False)
    region_side: float = struct.field(pytree_node=False, default=0.7)

    @property
    @abstractmethod
    def network(self) -> nn.Module:
        """The module; its parameters depend on sizes in the config alone, not on the world."""

    def init(self, key: Array, observation: Any) -> Params:
        """Fresh parameters; `observation` is one, or its shapes, without a leading axis."""
        return jax.jit(self.network.init)(key, self.cloud, self.half_extents, blank_batch(observation))

    def apply(self, params: Params, observation: Any) -> tuple[Any, Array]:
        """The action distribution and the values f32[B] of observations with a leading axis B."""
        return self.network.apply(params, self.cloud, self.half_extents, observation)

    def encode(self, params: Params) -> Callable[[Any], Any]:
        """A function that adds to observations with a leading axis what no later update changes.

        `apply` then takes it from there, however often it is called with that observation.
        """
        return as_seen(params)


def blank_batch(observation: Any) -> Any:
    """Zeros of an observation's shapes, as a batch of one."""
    return jax.tree.map(lambda leaf: jnp.zeros((1, *leaf.shape), leaf.dtype), observation)
