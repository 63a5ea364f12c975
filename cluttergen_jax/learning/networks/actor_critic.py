"""The policy and the value: two heads of five layers on what the encoders saw (paper, section 3.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

from cluttergen_jax.learning.networks.config import MIXTURE, NetworkConfig
from cluttergen_jax.learning.networks.distributions import EDGE, HEADS, ActionDistribution, Mixture
from cluttergen_jax.placement.clouds import BARE
from cluttergen_jax.types import Array

LENGTH_SCALE = 10.0
"""Metres are multiplied by this before a network sees them: tabletop lengths become about 1."""


class MLP(nn.Module):
    """Dense layers with a nonlinearity after each, the last one included."""

    widths: Sequence[int]

    @nn.compact
    def __call__(self, x: Array) -> Array:
        for width in self.widths:
            x = nn.tanh(nn.Dense(width, kernel_init=nn.initializers.orthogonal(jnp.sqrt(2)))(x))
        return x


class PointNet(nn.Module):
    """A shared network over points, then the maximum over those that count (Qi et al., CVPR 2017).

    Attributes:
      widths: of the shared network.
      num_features: F.
    """

    widths: Sequence[int] = (32, 64)
    num_features: int = 64

    @nn.compact
    def __call__(self, cloud: Array, mask: Array | None = None) -> Array:
        """f32[..., F] from a cloud f32[..., P, 3] in metres and a mask bool[..., P] of points that count."""
        x = cloud * LENGTH_SCALE
        for width in (*self.widths, self.num_features):
            x = nn.relu(nn.Dense(width)(x))
        if mask is not None:
            # Features are non-negative, so zero is as good as absent.
            x = jnp.where(mask[..., None], x, 0.0)
        return jnp.max(x, axis=-2)


def rotation_features(quaternion: Array) -> Array:
    """The first two columns of the rotation matrix, f32[..., 6]: continuous, and equal for q and -q."""
    w, x, y, z = jnp.moveaxis(quaternion, -1, 0)
    return jnp.stack(
        [
            1 - 2 * (y * y + z * z),
            2 * (x * y + w * z),
            2 * (x * z - w * y),
            2 * (x * y - w * z),
            1 - 2 * (x * x + z * z),
            2 * (y * z + w * x),
        ],
        axis=-1,
    )


class SetEncoder(nn.Module):
    """What stands there, seen from the current object: attention over the placed objects.

    Every placed object (its cloud's features, its size, its pose) is read together with the current object
    and the region by a shared network; each head pools its share of the result by additive attention, and
    the maximum stands beside. The result does not change when the objects are renumbered.

    Attributes:
      width: W, of an object's token; num_heads: of the attention.
      max_tokens: placed objects that can be seen at once.
    """

    width: int = 96
    num_heads: int = 4
    max_tokens: int = 10

    @nn.compact
    def __call__(
        self, features: Array, half_extents: Array, observation: Mapping[str, Any]
    ) -> Array:
        """Scene features seen from the current object, f32[B, 3 W].

        Args:
          features: f32[K, F], of every object's cloud; half_extents: f32[K, 3], metres.
          observation: of `placement.observation.observe`, with a leading axis B on every leaf.
        """
        is_placed = observation["is_placed"]
        poses = observation["T_region_object"]
        focus = observation["focus"]
        region = observation["region"]
        size = jnp.concatenate([features, half_extents * LENGTH_SCALE], axis=-1)
        order = jnp.argsort(~is_placed, axis=1, stable=True)[:, : self.max_tokens]
        mask = jnp.take_along_axis(is_placed, order, axis=1)
        poses = jnp.take_along_axis(poses, order[..., None], axis=1)
        place = jnp.concatenate(
            [poses[..., :3] * LENGTH_SCALE, rotation_features(poses[..., 3:])], axis=-1
        )
        # A sum of three layers is one layer over the three side by side; the first needs no batch.
        asked = nn.Dense(self.width, name="in_hand")(
            jnp.concatenate([size[focus], region * LENGTH_SCALE], axis=-1)
        )
        tokens = nn.Dense(self.width, name="object")(size)[order] + nn.Dense(
            self.width, name="place"
        )(place)
        tokens = nn.relu(tokens + asked[:, None])
        tokens = jnp.where(mask[..., None], nn.relu(nn.Dense(self.width)(tokens)), 0.0)
        score = jnp.where(mask[..., None], nn.Dense(self.num_heads)(tokens), -1e9)
        shares = tokens.reshape(*tokens.shape[:2], self.num_heads, -1)
        pooled = jnp.einsum("bmh,bmhw->bhw", nn.softmax(score, axis=1), shares)
        pooled = pooled.reshape(pooled.shape[0], self.width)
        return jnp.concatenate([asked, pooled, jnp.max(tokens, axis=1)], axis=-1)


# Cells along the sides of the squares around a cell whose crowding it is told.
_NEAR = 3
_FAR = 9

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
        cells = (
            nn.Dense(first)(jnp.concatenate(seen, axis=-1))
            + nn.Dense(first)(context)[:, None, None]
        )
        cells = nn.relu(nn.Dense(second)(nn.relu(cells)))
        score += nn.Dense(self.num_turns, kernel_init=zeros)(cells)
        return score, jnp.concatenate(
            [jnp.mean(cells, axis=(1, 2)), jnp.max(cells, axis=(1, 2))], axis=-1
        )


__all__ = ["ActorCritic", "HistoryEncoder", "NetworkConfig"]

ACTION_SIZE = 4
_STEPS_OF_Z = 4.0
# Metres: the mixture's z lies in a window about where the object would rest on what lies below.
_BELOW_REST = 0.001
_WINDOW = 0.01

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
            features = PointNet(num_features=config.object_features)(
                cloud[:, : config.object_points]
            )
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
            seen.append(
                HistoryEncoder(config.history_width, config.history_length)(observation["history"])
            )
        state = jnp.concatenate(seen, axis=-1)
        layers = [config.width] * config.num_layers
        small = nn.initializers.orthogonal(0.01)
        unit = nn.initializers.orthogonal(1.0)
        raw = nn.Dense(2 * ACTION_SIZE, kernel_init=small, name="action")(
            MLP(layers, name="actor")(state)
        )
        value = nn.Dense(1, kernel_init=unit, name="value")(MLP(layers, name="critic")(state))
        raw = raw.reshape(*raw.shape[:-1], ACTION_SIZE, 2)
        half_height = half_extents[focus, 2]
        height_range = observation["region"][:, 2]
        if config.head == MIXTURE:
            bottom, width = _windows(observation["heights"], half_height, height_range)
            raw = raw.at[:, 2].add(jnp.array(_JUST_ABOVE_REST))
            return Mixture.from_scores(scores, raw, bottom, width, config.turn_symmetry), value[
                ..., 0
            ]
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


def _about_bare_height(
    raw: Array, half_height: Array, height_range: Array, config: NetworkConfig
) -> Array:
    """Raw outputs f32[B, 4, 2] that, when zero, mean a height just above rest on the bare top.

    The first of z is then counted in a few standard deviations, so that a gradient step moves it by about as
    much as it is wide.
    """
    rest = jnp.clip((half_height + config.height_clearance) / height_range, 0.01, 0.99)
    location = (
        _STEPS_OF_Z * config.height_precision**-0.5 * raw[:, 2, 0]
        + jnp.log(rest)
        - jnp.log1p(-rest)
    )
    raw = raw.at[:, 2, 0].set(location)
    return raw.at[:, 2, 1].add(jnp.log(config.height_precision))
