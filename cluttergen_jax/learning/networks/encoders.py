"""Encoders: layers, point clouds as feature vectors, and a scene as the set of objects that stand there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import flax.linen as nn
import jax.numpy as jnp

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
    def __call__(self, features: Array, half_extents: Array, observation: Mapping[str, Any]) -> Array:
        """Scene features seen from the current object, f32[B, 3 W].

        Args:
          features: f32[K, F], of every object's cloud; half_extents: f32[K, 3], metres.
          observation: of `placement.observation.observe`, with a leading axis B on every leaf.
        """
        is_placed, poses = observation["is_placed"], observation["T_region_object"]
        focus, region = observation["focus"], observation["region"]
        size = jnp.concatenate([features, half_extents * LENGTH_SCALE], axis=-1)
        order = jnp.argsort(~is_placed, axis=1, stable=True)[:, : self.max_tokens]
        mask = jnp.take_along_axis(is_placed, order, axis=1)
        poses = jnp.take_along_axis(poses, order[..., None], axis=1)
        place = jnp.concatenate([poses[..., :3] * LENGTH_SCALE, rotation_features(poses[..., 3:])], axis=-1)
        # A sum of three layers is one layer over the three side by side; the first needs no batch.
        asked = nn.Dense(self.width, name="in_hand")(
            jnp.concatenate([size[focus], region * LENGTH_SCALE], axis=-1)
        )
        tokens = nn.Dense(self.width, name="object")(size)[order] + nn.Dense(self.width, name="place")(place)
        tokens = nn.relu(tokens + asked[:, None])
        tokens = jnp.where(mask[..., None], nn.relu(nn.Dense(self.width)(tokens)), 0.0)
        score = jnp.where(mask[..., None], nn.Dense(self.num_heads)(tokens), -1e9)
        shares = tokens.reshape(*tokens.shape[:2], self.num_heads, -1)
        pooled = jnp.einsum("bmh,bmhw->bhw", nn.softmax(score, axis=1), shares)
        pooled = pooled.reshape(pooled.shape[0], self.width)
        return jnp.concatenate([asked, pooled, jnp.max(tokens, axis=1)], axis=-1)
