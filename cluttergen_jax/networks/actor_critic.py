"""The policy and the value: one encoder, two heads of five layers (paper, section 3.2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import flax.linen as nn
import jax.numpy as jnp

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.networks.distributions import HEADS, ActionDistribution
from cluttergen_jax.networks.points import LENGTH_SCALE, MLP, PointNet
from cluttergen_jax.networks.set_encoder import SetEncoder
from cluttergen_jax.types import Array

ACTION_SIZE = 4


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes and kinds.

    Attributes:
      head: "beta" (the paper's) or "normal".
      object_points: points of each object's cloud that are read.
      object_features: F of the point encoder.
      token_width, num_heads, num_blocks: of the set encoder.
      history_width: of the three layers that read failed attempts; 0 reads none (variant `open_loop`).
      history_length: how many of the latest attempts are read (variant `short_memory`: 1).
      num_layers, width: of actor and critic (paper: 5 of 256).
    """

    head: str = "beta"
    object_points: int = 64
    object_features: int = 64
    token_width: int = 96
    num_heads: int = 4
    num_blocks: int = 2
    history_width: int = 128
    history_length: int = 5
    num_layers: int = 5
    width: int = 256

    def __post_init__(self) -> None:
        if self.head not in HEADS:
            raise ConfigError(f"head {self.head!r}", ", ".join(HEADS), "--network.head beta")


class HistoryEncoder(nn.Module):
    """Three layers over the flattened attempts, zeros where there is none yet (paper, section 3.2)."""

    width: int
    length: int

    @nn.compact
    def __call__(self, history: Mapping[str, Array]) -> Array:
        """f32[B, width] from the observation's history (see `placement.observation.observe`)."""
        tried = history["is_tried"]
        batch, attempts = tried.shape
        trajectory = history["trajectory"]
        scale = jnp.array([LENGTH_SCALE] * 3 + [1.0] * 4 + [1.0] * 3 + [0.1] * 3)
        rows = jnp.concatenate(
            [
                tried[..., None].astype(jnp.float32),
                history["action"],
                history["region"] * LENGTH_SCALE,
                jnp.clip(trajectory * scale, -10, 10).reshape(batch, attempts, -1),
            ],
            axis=-1,
        )
        age = jnp.sum(tried, axis=1, keepdims=True) - jnp.arange(attempts)
        is_read = tried & (age <= self.length)
        return MLP([self.width] * 3)(jnp.where(is_read[..., None], rows, 0.0).reshape(batch, -1))


class ActorCritic(nn.Module):
    """Actions and values from observations.

    Attributes:
      config: sizes and kinds.
      max_objects: the most objects that can stand at once.
    """

    config: NetworkConfig
    max_objects: int

    @nn.compact
    def __call__(
        self, cloud: Array, half_extents: Array, observation: Mapping[str, Any]
    ) -> tuple[ActionDistribution, Array]:
        """The action's distribution (batch B, 4 coordinates) and the value f32[B].

        Args:
          cloud: f32[K, P, 3], object frames, metres; half_extents: f32[K, 3], metres. Features of the K
            clouds are computed once for the whole batch.
          observation: of `placement.observation.observe`, with a leading axis B on every leaf.
        """
        config = self.config
        features = PointNet(num_features=config.object_features)(cloud[:, : config.object_points])
        scene = SetEncoder(config.token_width, config.num_heads, config.num_blocks, self.max_objects)(
            features,
            half_extents,
            observation["T_region_object"],
            observation["is_placed"],
            observation["focus"],
            observation["region"],
        )
        seen = [scene, features[observation["focus"]], observation["region"] * LENGTH_SCALE]
        seen.append(half_extents[observation["focus"]] * LENGTH_SCALE)
        if config.history_width:
            seen.append(HistoryEncoder(config.history_width, config.history_length)(observation["history"]))
        state = jnp.concatenate(seen, axis=-1)
        layers = [config.width] * config.num_layers
        small, unit = nn.initializers.orthogonal(0.01), nn.initializers.orthogonal(1.0)
        raw = nn.Dense(2 * ACTION_SIZE, kernel_init=small, name="action")(MLP(layers, name="actor")(state))
        value = nn.Dense(1, kernel_init=unit, name="value")(MLP(layers, name="critic")(state))
        return HEADS[config.head].from_raw(raw.reshape(*raw.shape[:-1], ACTION_SIZE, 2)), value[..., 0]
