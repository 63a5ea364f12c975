"""A scene as heights over the queried region: each cell is judged by what lies around it."""

from __future__ import annotations

import flax.linen as nn
import jax.numpy as jnp

from cluttergen_jax.networks.points import LENGTH_SCALE
from cluttergen_jax.types import Array


class HeightEncoder(nn.Module):
    """The same small network at every cell, told what is to be placed: a convolution and two layers.

    Attributes:
      channels: of the layers; num_turns: T, scores at each cell; reach: cells that are seen on each side.
    """

    channels: int = 32
    num_turns: int = 8
    reach: int = 4

    @nn.compact
    def __call__(self, heights: Array, context: Array) -> tuple[Array, Array]:
        """Scores f32[B, G, G, T], zero before learning, and a summary f32[B, 2 channels].

        Args:
          heights: f32[B, G, G], metres; context: f32[B, C], of the object in hand and the region.
        """
        side, reach = heights.shape[-1], self.reach
        # What lies beyond the region counts as filled: an object that reaches there may hang over.
        border = ((0, 0), (reach, reach), (reach, reach))
        padded = jnp.pad(heights * LENGTH_SCALE, border, constant_values=1.0)
        # Shifted copies and one matrix product: on a CPU much faster than the gradient of a convolution.
        around = [
            padded[:, i : i + side, j : j + side] for i in range(2 * reach + 1) for j in range(2 * reach + 1)
        ]
        line = (jnp.arange(side) + 0.5) / side * 2 - 1
        place = jnp.broadcast_to(
            jnp.stack(jnp.meshgrid(line, line, indexing="ij"), axis=-1), (*heights.shape, 2)
        )
        cells = jnp.concatenate([jnp.stack(around, axis=-1), place], axis=-1)
        cells = nn.relu(nn.Dense(self.channels)(cells) + nn.Dense(self.channels)(context)[:, None, None])
        cells = nn.relu(nn.Dense(self.channels)(cells))
        score = nn.Dense(self.num_turns, kernel_init=nn.initializers.zeros)(cells)
        return score, jnp.concatenate([jnp.mean(cells, axis=(1, 2)), jnp.max(cells, axis=(1, 2))], axis=-1)
