"""Point-cloud encoders: from a padded cloud to one feature vector, whatever the order of its points."""

from __future__ import annotations

from collections.abc import Sequence

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
