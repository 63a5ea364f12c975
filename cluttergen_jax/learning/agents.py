"""Agents: networks bound to a world's objects, which PPO trains and a policy acts with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from cluttergen_jax.learning.networks import cloud_encoder
from cluttergen_jax.learning.networks.actor_critic import ActorCritic
from cluttergen_jax.learning.networks.config import NetworkConfig
from cluttergen_jax.learning.networks.distributions import ActionDistribution
from cluttergen_jax.learning.networks.footprint import FootprintFeatures
from cluttergen_jax.placement.observation import ObservationConfig
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.types import Array

Params = Any


ENCODER = "encoder"
"""Where the weights of the two networks on clouds are."""


class Agent(struct.PyTreeNode, eq=False):
    """An actor-critic that knows a world's point clouds; its action is a pose, f32[4] (docs/contract.md).

    Attributes:
      config: the network's sizes.
      cloud: f32[K, P, 3], every object's, object frames, metres.
      half_extents: f32[K, 3], metres.
      max_objects: the most objects that can stand at once.
      region_side: of the larger regions to be expected, metres.
      room: the objects' footprints, where the network reads them; made here if not given.
    """

    config: NetworkConfig = struct.field(pytree_node=False)
    cloud: Array
    half_extents: Array
    max_objects: int = struct.field(pytree_node=False)
    region_side: float = struct.field(pytree_node=False, default=0.7)
    room: FootprintFeatures | None = None

    def __post_init__(self) -> None:
        if self.config.reads_room and self.room is None:
            object.__setattr__(self, "room", self._footprints())

    @property
    def network(self) -> ActorCritic:
        """The module; its parameters depend on sizes in the config alone, not on the world."""
        return ActorCritic(self.config, self.max_objects)

    @property
    def observation(self) -> ObservationConfig:
        """How much of an episode it has to be shown."""
        return ObservationConfig(num_cells=self.config.num_cells_read)

    @property
    def encoder(self) -> cloud_encoder.CloudEncoder:
        """The networks on clouds, if there are any."""
        return cloud_encoder.CloudEncoder(self.config, self.max_objects)

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
        """Fresh parameters; `observation` is one, or its shapes, without a leading axis."""
        blank = jax.tree.map(lambda leaf: jnp.zeros((1, *leaf.shape), leaf.dtype), observation)
        if self.room is not None:
            blank |= {"room": jnp.zeros((1, *self.room.shape))}
        if not self.config.reads_clouds:
            return jax.jit(self.network.init)(key, self.cloud, self.half_extents, blank)
        key_encoder, key = jax.random.split(key)
        size = self.config.scene_features + self.config.object_features
        blank |= {"encoded": jnp.zeros((1, size))}
        params = jax.jit(self.network.init)(key, self.cloud, self.half_extents, blank)["params"]
        weights = cloud_encoder.init_encoder(self.encoder, key_encoder, self.cloud, self.half_extents)
        return {"params": params | {ENCODER: weights}}

    def apply(self, params: Params, observation: Any) -> tuple[ActionDistribution, Array]:
        """The action distribution and the values f32[B] of observations with a leading axis B."""
        observation = self._with_room(observation)
        if self.config.reads_clouds and "encoded" not in observation:
            observation = self._encode(params)(observation)
        return self.network.apply(params, self.cloud, self.half_extents, observation)

    def encode(self, params: Params) -> Callable[[Any], Any]:
        """A function that adds to observations with a leading axis what no later update changes.

        That is the room for the current object, and the features of a frozen encoder; those of an encoder
        that learns change with every step. `apply` takes it from there, however often it is called with that
        observation.
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
        objects = cloud_encoder.encode_objects(self.encoder, weights, self.cloud, self.half_extents)

        def encode(observation: Any) -> Any:
            scenes = cloud_encoder.encode_scenes(self.encoder, weights, self.cloud, observation)
            return observation | {
                "encoded": jnp.concatenate([scenes, objects[observation["focus"]]], axis=-1)
            }

        return encode


def make_agent(rules: Rules, network: NetworkConfig) -> Agent:
    """The agent of a network in a world."""
    geometry = rules.geometry
    return Agent(
        network,
        geometry.cloud,
        geometry.half_extents,
        min(rules.num_slots, geometry.num_objects),
        region_side=2 * float(rules.region.half_extents.max()),
    )
