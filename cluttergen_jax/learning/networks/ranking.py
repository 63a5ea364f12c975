"""A network that ranks candidate poses, beginning where the search's own order ends."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import flax.linen as nn
import jax
import jax.numpy as jnp

from cluttergen_jax.learning.networks.config import AgentConfig
from cluttergen_jax.learning.networks.distributions import Categorical
from cluttergen_jax.learning.networks.encoders import LENGTH_SCALE, MLP, PointNet, SetEncoder
from cluttergen_jax.types import Array

_HIGH_COST, _ABOVE = 0.2, 0.02
"""Metres: above the first the search's cost says little, and grows by the second for each factor of e."""


@dataclass(frozen=True)
class RankerConfig(AgentConfig):
    """Sizes of the network that ranks candidate poses.

    Attributes:
      object_points, object_features, token_width, num_heads: as in `NetworkConfig`.
      width: of the layers that judge a candidate; value_width: of those that judge the scene.
      cost_scale: metres of the search's cost that make a pose e times less likely before any learning.
    """

    kind: ClassVar[str] = "ranking"
    is_sampled: ClassVar[bool] = False

    object_points: int = 64
    object_features: int = 32
    token_width: int = 64
    num_heads: int = 4

    width: int = 64
    value_width: int = 128
    cost_scale: float = 0.005


class Ranker(nn.Module):
    """The distribution over candidate poses, and the value of the scene."""

    config: RankerConfig
    max_objects: int

    @nn.compact
    def __call__(
        self, cloud: Array, half_extents: Array, observation: Mapping[str, Any]
    ) -> tuple[Categorical, Array]:
        """See `ActorCritic`; the observation holds candidates, too (`candidate_features`)."""
        config, menu = self.config, observation["menu"]
        features = PointNet((32,), config.object_features)(cloud[:, : config.object_points])
        focus = observation["focus"]
        scene = SetEncoder(config.token_width, config.num_heads, self.max_objects)(
            features, half_extents, observation
        )
        remaining = observation["is_placed"].sum(-1, keepdims=True) / self.max_objects
        state = jnp.concatenate(
            [
                scene,
                features[focus],
                observation["region"] * LENGTH_SCALE,
                half_extents[focus] * LENGTH_SCALE,
                remaining,
            ],
            axis=-1,
        )
        hidden = nn.Dense(config.width)(menu["features"]) + nn.Dense(config.width)(state)[:, None]
        for _ in range(2):
            hidden = nn.Dense(config.width)(nn.gelu(hidden))
        hidden = nn.gelu(hidden)
        score = nn.Dense(1, kernel_init=nn.initializers.zeros)(hidden)[..., 0]
        high = _HIGH_COST + _ABOVE * jnp.log(jnp.maximum(menu["cost"], _HIGH_COST) / _HIGH_COST)
        cost = jnp.where(menu["cost"] < _HIGH_COST, menu["cost"], high)
        logits = score - cost / config.cost_scale
        seen = jnp.concatenate([state, jnp.max(hidden, axis=1), jnp.mean(hidden, axis=1)], axis=-1)
        value = nn.Dense(1)(MLP([config.value_width] * 2)(seen))[..., 0]
        return Categorical(jax.nn.log_softmax(logits)), value
