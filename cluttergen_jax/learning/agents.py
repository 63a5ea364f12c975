"""Agents: networks bound to a world's objects, which PPO trains and a policy acts with, and their kinds."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
from flax import struct

from cluttergen_jax.learning.networks import cloud_encoder
from cluttergen_jax.learning.networks.actor_critic import ActorCritic
from cluttergen_jax.learning.networks.config import AgentConfig, NetworkConfig
from cluttergen_jax.learning.networks.distributions import ActionDistribution
from cluttergen_jax.learning.networks.footprint import FootprintFeatures
from cluttergen_jax.learning.networks.ranking import Ranker, RankerConfig
from cluttergen_jax.learning.ppo.ppo import as_seen
from cluttergen_jax.learning.ranking_env import RankingEnv
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.observation import ObservationConfig
from cluttergen_jax.placement.rules import Rules
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
        weights = cloud_encoder.init_encoder(self.encoder, key_encoder, self.cloud, self.half_extents)
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
        objects = cloud_encoder.encode_objects(self.encoder, weights, self.cloud, self.half_extents)

        def encode(observation: Any) -> Any:
            scenes = cloud_encoder.encode_scenes(self.encoder, weights, self.cloud, observation)
            return observation | {
                "encoded": jnp.concatenate([scenes, objects[observation["focus"]]], axis=-1)
            }

        return encode


class RankingAgent(Agent, eq=False):
    """A ranker whose action is the number of a candidate in the observation, i32."""

    config: RankerConfig = struct.field(pytree_node=False)

    @property
    def network(self) -> Ranker:
        """See `Agent.network`."""
        return Ranker(self.config, self.max_objects)


class Kind(NamedTuple):
    """A kind of agent.

    Attributes:
      config: the class of its network's sizes.
      agent: binds the network to a world.
      env: whose observations it reads, and whose actions it chooses.
    """

    config: type[AgentConfig]
    agent: type[Agent]
    env: type[PlacementEnv]


KINDS = {
    "pose": Kind(NetworkConfig, PoseAgent, PlacementEnv),
    "ranking": Kind(RankerConfig, RankingAgent, RankingEnv),
}
"""By the name that stands in a checkpoint's record (`AgentConfig.kind`)."""


def make_agent(rules: Rules, network: AgentConfig) -> tuple[PlacementEnv, Agent]:
    """The environment and the agent of the kind that `network` is of."""
    kind, geometry = KINDS[network.kind], rules.geometry
    agent = kind.agent(
        network,
        geometry.cloud,
        geometry.half_extents,
        min(rules.num_slots, geometry.num_objects),
        region_side=2 * float(rules.region.half_extents.max()),
    )
    return kind.env(rules, ObservationConfig(num_cells=network.num_cells_read)), agent
