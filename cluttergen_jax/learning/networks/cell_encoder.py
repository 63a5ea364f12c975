"""A scene as the cells of a grid over the queried region: each is judged by what the object finds there."""

from __future__ import annotations

import flax.linen as nn
import jax.numpy as jnp

from cluttergen_jax.learning.networks.points import LENGTH_SCALE
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
