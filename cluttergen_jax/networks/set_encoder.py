"""A scene as a set of objects: the object in hand attends to what stands there."""

from __future__ import annotations

import flax.linen as nn
import jax.numpy as jnp

from cluttergen_jax.networks.points import LENGTH_SCALE, rotation_features
from cluttergen_jax.types import Array


class AttentionBlock(nn.Module):
    """Pre-norm self-attention and a two-layer network, both residual."""

    num_heads: int
    width: int

    @nn.compact
    def __call__(self, tokens: Array, mask: Array) -> Array:
        """f32[B, M, W] from tokens f32[B, M, W] and the mask bool[B, M] of those that count."""
        normed = nn.LayerNorm()(tokens)
        attend = nn.MultiHeadDotProductAttention(num_heads=self.num_heads, qkv_features=self.width)
        tokens = tokens + attend(normed, normed, mask=mask[:, None, None, :])
        hidden = nn.Dense(2 * self.width)(nn.LayerNorm()(tokens))
        return tokens + nn.Dense(self.width)(nn.gelu(hidden))


class SetEncoder(nn.Module):
    """Objects as tokens (their cloud's features, their size, their pose) plus one for the object in hand.

    The result does not change when the objects are renumbered.

    Attributes:
      width: W, of a token; num_heads, num_blocks: of the attention.
      max_tokens: placed objects that can be seen at once.
    """

    width: int = 96
    num_heads: int = 4
    num_blocks: int = 2
    max_tokens: int = 10

    @nn.compact
    def __call__(
        self,
        features: Array,
        half_extents: Array,
        poses: Array,
        is_placed: Array,
        focus: Array,
        region: Array,
    ) -> Array:
        """Scene features seen from the object in hand, f32[B, W].

        Args:
          features: f32[K, F], of every object's cloud; half_extents: f32[K, 3], metres.
          poses: f32[B, K, 7], region frame; is_placed: bool[B, K]; focus: i32[B].
          region: f32[B, 3], half extents and height range, metres.
        """
        size = jnp.concatenate([features, half_extents * LENGTH_SCALE], axis=-1)
        order = jnp.argsort(~is_placed, axis=1, stable=True)[:, : self.max_tokens]
        mask = jnp.take_along_axis(is_placed, order, axis=1)
        poses = jnp.take_along_axis(poses, order[..., None], axis=1)
        place = jnp.concatenate([poses[..., :3] * LENGTH_SCALE, rotation_features(poses[..., 3:])], axis=-1)
        placed = nn.Dense(self.width, name="placed")(jnp.concatenate([size[order], place], axis=-1))
        asked = jnp.concatenate([size[focus], region * LENGTH_SCALE], axis=-1)
        query = nn.Dense(self.width, name="in_hand")(asked)
        tokens = jnp.concatenate([query[:, None], placed], axis=1)
        mask = jnp.concatenate([jnp.ones_like(mask[:, :1]), mask], axis=1)
        for _ in range(self.num_blocks):
            tokens = AttentionBlock(self.num_heads, self.width)(tokens, mask)
        return nn.LayerNorm()(tokens[:, 0])
