"""The network bound to a world's objects: what PPO trains and what a trained policy proposes with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp

from cluttergen_jax.networks.actor_critic import ActorCritic
from cluttergen_jax.networks.cloud_encoder import (
    CloudEncoder,
    encode_objects,
    encode_scenes,
    init_encoder,
)
from cluttergen_jax.networks.config import NetworkConfig
from cluttergen_jax.networks.distributions import ActionDistribution
from cluttergen_jax.networks.room import Room
from cluttergen_jax.types import Array

Params = Any
ENCODER = "encoder"
"""Where the weights of the two networks on clouds are."""


@dataclass(frozen=True, eq=False)
class Learner:
    """An actor-critic that knows a world's clouds.

    Attributes:
      config: the network's sizes.
      cloud: f32[K, P, 3], every object's, object frames, metres.
      half_extents: f32[K, 3], metres.
      max_objects: the most objects that can stand at once.
      region_side: of the larger regions to be expected, metres; of a mixture (`room.Room`).
    """

    config: NetworkConfig
    cloud: Array
    half_extents: Array
    max_objects: int
    region_side: float = 0.7

    @property
    def network(self) -> ActorCritic:
        """The module; its parameters depend on sizes in the config alone, not on the world."""
        return ActorCritic(self.config, self.max_objects)

    @property
    def encoder(self) -> CloudEncoder:
        """The networks on clouds, if there are any."""
        return CloudEncoder(self.config, self.max_objects)

    @cached_property
    def room(self) -> Room:
        """The objects' footprints."""
        config = self.config
        return Room.of(
            self.cloud,
            self.region_side,
            config.num_cells,
            config.num_turns,
            config.turn_symmetry,
            config.undersides,
        )

    def init(self, key: Array, observation: Any) -> Params:
        """Fresh parameters; `observation` is one, or its shapes, without a leading axis."""
        blank = jax.tree.map(lambda leaf: jnp.zeros((1, *leaf.shape), leaf.dtype), observation)
        if self.config.reads_room:
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
        """The action distribution and the values f32[B] of observations with a leading axis B."""
        observation = self._with_room(observation)
        if self.config.reads_clouds and "encoded" not in observation:
            observation = self._encode(params)(observation)
        return self.network.apply(params, self.cloud, self.half_extents, observation)

    def encode(self, params: Params) -> Callable[[Any], Any]:
        """A function that adds to observations with a leading axis what no later update changes.

        `apply` then takes it from there, however often it is called with that observation: the room for the
        object in hand, and the features of a frozen encoder; those of one that learns change with every step.
        """
        if self.config.reads_clouds and self.config.encoder_frozen:
            encode = self._encode(params)
            return lambda observation: encode(self._with_room(observation))
        return self._with_room

    def _with_room(self, observation: Any) -> Any:
        if not self.config.reads_room or "room" in observation:
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
