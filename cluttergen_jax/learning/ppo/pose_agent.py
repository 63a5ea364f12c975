"""The agent that proposes poses: an actor-critic on point clouds, heights and failed attempts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from cluttergen_jax.learning.networks.actor_critic import ActorCritic
from cluttergen_jax.learning.networks.cloud_encoder import (
    CloudEncoder,
    encode_objects,
    encode_scenes,
    init_encoder,
)
from cluttergen_jax.learning.networks.config import NetworkConfig
from cluttergen_jax.learning.networks.distributions import ActionDistribution
from cluttergen_jax.learning.networks.footprint import FootprintFeatures
from cluttergen_jax.learning.ppo.agent import Agent, Params, blank_batch
from cluttergen_jax.types import Array

ENCODER = "encoder"
"""Where the weights of the two networks on clouds are."""


class PoseAgent(Agent, eq=False):
    """An actor-critic whose action is a pose, f32[4] (docs/contract.md).

    Attributes:
      room: the objects' footprints, where the network reads them; made here if not given.
    """

    config: NetworkConfig = struct.field(pytree_node=False)
    room: FootprintFeatures | None = None

    def __post_init__(self) -> None:
        if self.config.reads_room and self.room is None:
            object.__setattr__(self, "room", self._footprints())

    @property
    def network(self) -> ActorCritic:
        """See `Agent.network`."""
        return ActorCritic(self.config, self.max_objects)

    @property
    def encoder(self) -> CloudEncoder:
        """The networks on clouds, if there are any."""
        return CloudEncoder(self.config, self.max_objects)

    def _footprints(self) -> FootprintFeatures:
        config = self.config
        return FootprintFeatures.of(
            self.cloud,
            self.region_side,
            config.num_cells,
            config.num_turns,
            config.turn_symmetry,
            config.undersides,
        )

    def init(self, key: Array, observation: Any) -> Params:
        """See `Agent.init`."""
        blank = blank_batch(observation)
        if self.room is not None:
            blank |= {"room": jnp.zeros((1, *self.room.shape))}
        if not self.config.reads_clouds:
            return jax.jit(self.network.init)(key, self.cloud, self.half_extents, blank)
        key_encoder, key = jax.random.split(key)
        size = self.config.scene_features + self.config.object_features
        blank |= {"encoded": jnp.zeros((1, size))}
        params = jax.jit(self.network.init)(key, self.cloud, self.half_extents, blank)["params"]
        weights = init_encoder(self.encoder, key_encoder, self.cloud, self.half_extents)
        return {"params": params | {ENCODER: weights}}

    def apply(self, params: Params, observation: Any) -> tuple[ActionDistribution, Array]:
        """See `Agent.apply`."""
        observation = self._with_room(observation)
        if self.config.reads_clouds and "encoded" not in observation:
            observation = self._encode(params)(observation)
        return super().apply(params, observation)

    def encode(self, params: Params) -> Callable[[Any], Any]:
        """See `Agent.encode`: adds the room for the current object, and the features of a frozen encoder.

        Those of an encoder that learns change with every step.
        """
        if self.config.reads_clouds and self.config.encoder_frozen:
            encode = self._encode(params)
            return lambda observation: encode(self._with_room(observation))
        return self._with_room

    def _with_room(self, observation: Any) -> Any:
        if self.room is None or "room" in observation:
            return observation
        return observation | {"room": jax.vmap(self.room)(observation)}

    def _encode(self, params: Params) -> Callable[[Any], Any]:
        weights = params["params"][ENCODER]
        weights = jax.lax.stop_gradient(weights) if self.config.encoder_frozen else weights
        objects = encode_objects(self.encoder, weights, self.cloud, self.half_extents)

        def encode(observation: Any) -> Any:
            scenes = encode_scenes(self.encoder, weights, self.cloud, observation)
            return observation | {
                "encoded": jnp.concatenate([scenes, objects[observation["focus"]]], axis=-1)
            }

        return encode
