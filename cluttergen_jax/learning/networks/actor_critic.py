"""The policy and the value: two heads of five layers on what the encoders saw (paper, section 3.2)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

from cluttergen_jax.learning.networks.config import MIXTURE, NetworkConfig
from cluttergen_jax.learning.networks.distributions import EDGE, HEADS, ActionDistribution, Mixture
from cluttergen_jax.learning.networks.encoders import LENGTH_SCALE, MLP, PointNet, SetEncoder
from cluttergen_jax.placement.clouds import BARE
from cluttergen_jax.types import Array

_NEAR, _FAR = 3, 9
"""Cells along the sides of the squares around a cell whose crowding it is told."""

_TOUCH = 0.02
"""A share of a footprint that already matters half as much as all of it: a board over a fork."""

_STEPS_OF_SCORE = 10.0
"""What a gradient step changes in the weights of room, in those of other layers."""


class CellEncoder(nn.Module):
    """The same small network at every cell, told what is to be placed.

    Attributes:
      num_turns: T; widths: of its two layers.
    """

    num_turns: int
    widths: tuple[int, int] = (32, 16)

    @nn.compact
    def __call__(self, heights: Array, room: Array | None, context: Array) -> tuple[Array, Array]:
        """Scores f32[B, G, G, T], zero before learning, and a summary f32[B, 2 widths[1]].

        Args:
          heights: f32[B, G, G], metres; room: f32[B, G, G, T, 2], `FootprintFeatures`, if read.
          context: f32[B, C], of the current object and the region.
        """
        side = heights.shape[-1]
        is_taken = (heights > BARE).astype(jnp.float32)[..., None]
        line = (jnp.arange(side) + 0.5) / side * 2 - 1
        place = jnp.stack(jnp.meshgrid(line, line, indexing="ij"), axis=-1)
        seen = [
            heights[..., None] * LENGTH_SCALE,
            *(nn.avg_pool(is_taken, (size, size), padding="SAME") for size in (_NEAR, _FAR)),
            jnp.broadcast_to(place, (*heights.shape, 2)),
        ]
        zeros = nn.initializers.zeros
        score = jnp.float32(0)
        if room is not None:
            room = jnp.maximum(room, 0.0)
            room = room / (room + _TOUCH)
            seen.append(room.reshape(*heights.shape, -1))
            weight = _STEPS_OF_SCORE * nn.Dense(2, kernel_init=zeros)(context)
            score = jnp.einsum("bxytc,bc->bxyt", room, weight)
        first, second = self.widths
        cells = nn.Dense(first)(jnp.concatenate(seen, axis=-1)) + nn.Dense(first)(context)[:, None, None]
        cells = nn.relu(nn.Dense(second)(nn.relu(cells)))
        score += nn.Dense(self.num_turns, kernel_init=zeros)(cells)
        return score, jnp.concatenate([jnp.mean(cells, axis=(1, 2)), jnp.max(cells, axis=(1, 2))], axis=-1)


__all__ = ["ActorCritic", "HistoryEncoder", "NetworkConfig"]

ACTION_SIZE = 4
_STEPS_OF_Z = 4.0
_BELOW_REST, _WINDOW = 0.001, 0.01
"""Metres: the mixture's z lies in a window about where the object would rest on what lies below."""

_JUST_ABOVE_REST = (-1.1, 2.3)
"""Raw outputs from which z is learned: about 2 mm above rest, give or take 1 mm."""


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
          observation: of `placement.observation.observe`, with a leading axis B on every leaf. The learner
            adds what is made from it: where the scene is seen as a point cloud `encoded`, f32[B, E], the
            features of the scene and of the current object; for a mixture `room` (`FootprintFeatures`).
        """
        config = self.config
        focus = observation["focus"]
        if config.reads_clouds:
            seen = [observation["encoded"]]
        else:
            features = PointNet(num_features=config.object_features)(cloud[:, : config.object_points])
            features = jax.lax.stop_gradient(features) if config.encoder_frozen else features
            encoder = SetEncoder(config.token_width, config.num_heads, self.max_objects)
            seen = [encoder(features, half_extents, observation), features[focus]]
        seen += [observation["region"] * LENGTH_SCALE, half_extents[focus] * LENGTH_SCALE]
        if config.head == MIXTURE:
            scores, summary = CellEncoder(config.num_turns)(
                observation["heights"], observation.get("room"), jnp.concatenate(seen[-3:], axis=-1)
            )
            seen.append(summary)
        if config.history_width:
            seen.append(HistoryEncoder(config.history_width, config.history_length)(observation["history"]))
        state = jnp.concatenate(seen, axis=-1)
        layers = [config.width] * config.num_layers
        small, unit = nn.initializers.orthogonal(0.01), nn.initializers.orthogonal(1.0)
        raw = nn.Dense(2 * ACTION_SIZE, kernel_init=small, name="action")(MLP(layers, name="actor")(state))
        value = nn.Dense(1, kernel_init=unit, name="value")(MLP(layers, name="critic")(state))
        raw = raw.reshape(*raw.shape[:-1], ACTION_SIZE, 2)
        half_height, height_range = half_extents[focus, 2], observation["region"][:, 2]
        if config.head == MIXTURE:
            bottom, width = _windows(observation["heights"], half_height, height_range)
            raw = raw.at[:, 2].add(jnp.array(_JUST_ABOVE_REST))
            return Mixture.from_scores(scores, raw, bottom, width, config.turn_symmetry), value[..., 0]
        if config.height_precision:
            raw = _about_bare_height(raw, half_height, height_range, config)
        return HEADS[config.head](raw), value[..., 0]


def _windows(heights: Array, half_height: Array, height_range: Array) -> tuple[Array, Array]:
    """Where z may lie over each cell, as actions: the bottoms f32[B, G, G] and the width f32[B].

    Wholly inside the range of actions: a draw that had to be clipped would have no honest density.
    """
    width = jnp.minimum(_WINDOW / height_range, 0.5)
    rest = heights + half_height[:, None, None]
    bottom = (rest - _BELOW_REST) / height_range[:, None, None]
    return jnp.clip(bottom, EDGE, 1 - 2 * EDGE - width[:, None, None]), width


def _about_bare_height(raw: Array, half_height: Array, height_range: Array, config: NetworkConfig) -> Array:
    """Raw outputs f32[B, 4, 2] that, when zero, mean a height just above rest on the bare top.

    The first of z is then counted in a few standard deviations, so that a gradient step moves it by about as
    much as it is wide.
    """
    rest = jnp.clip((half_height + config.height_clearance) / height_range, 0.01, 0.99)
    location = _STEPS_OF_Z * config.height_precision**-0.5 * raw[:, 2, 0] + jnp.log(rest) - jnp.log1p(-rest)
    raw = raw.at[:, 2, 0].set(location)
    return raw.at[:, 2, 1].add(jnp.log(config.height_precision))
