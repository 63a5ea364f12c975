"""PointNet++ with single-scale grouping (Qi et al., NeurIPS 2017): three levels of set abstraction."""

from __future__ import annotations

from collections.abc import Sequence

import flax.linen as nn
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name

from cluttergen_jax.learning.networks.sampling import ball_query, farthest_points
from cluttergen_jax.types import Array

NEIGHBOURS = "neighbours"
"""The name of the searches' results: a backward pass that computes all else again may keep them."""

RADII = (0.2, 0.4)
"""Of the first two levels, in units of the cloud (its radius is about 1)."""


class SharedLayers(nn.Module):
    """Layers over points, then the maximum over those that count: f32[F] from f32[G, C] and bool[G]."""

    widths: Sequence[int]

    @nn.compact
    def __call__(self, x: Array, mask: Array) -> Array:
        """f32[..., F] from x f32[..., G, C] and mask bool[..., G]; zero where nothing counts."""
        for width in self.widths:
            x = nn.relu(nn.Dense(width, kernel_init=nn.initializers.he_normal())(x))
        # What the last nonlinearity leaves is not negative, so zero is as good as absent.
        pooled = jnp.max(jnp.where(mask[..., None], x, 0.0), axis=-2)
        # A group of one point is all zeros: the usual epsilon would make features of rounding errors.
        normed = nn.LayerNorm(epsilon=0.01)(pooled)
        return jnp.where(jnp.any(mask, axis=-1, keepdims=True), normed, 0.0)


def _joined(position: Array, features: Array) -> Array:
    """f32[..., 3 + C] of positions f32[..., 3] and features f32[..., C], both about 1: half the weight each.

    As three numbers among hundreds, positions are drowned at first by what all features have in common (there
    is no batch normalisation to take that away): 50 families of shapes were then not learned at all.
    """
    weight = (features.shape[-1] / 3) ** 0.5
    return jnp.concatenate([weight * position, features], axis=-1)


class SetAbstraction(nn.Module):
    """One level: around each centroid, the points within a radius become one feature vector.

    Positions enter relative to the centroid and in units of the radius, so a level by itself does not change
    when the cloud is moved.

    Attributes:
      radius: in the unit of the cloud.
      group_size: points around a centroid at most, the nearest.
      widths: of the shared layers.
    """

    radius: float
    group_size: int
    widths: Sequence[int]

    @nn.compact
    def __call__(
        self, cloud: Array, mask: Array, features: Array | None, index: Array, is_centroid: Array
    ) -> Array:
        """f32[S, F], zero where there is no centroid.

        Args:
          cloud: f32[P, 3]; mask: bool[P], the points that count; features: f32[P, C], or None.
          index: i32[S], the centroids among the points; is_centroid: bool[S], those that count.
        """
        centres = cloud[index]
        found, is_found = ball_query(centres, cloud, mask, self.radius, self.group_size)
        found, is_found = checkpoint_name(found, NEIGHBOURS), checkpoint_name(is_found, NEIGHBOURS)
        x = (cloud[found] - centres[:, None]) / self.radius
        x = x if features is None else _joined(x, features[found])
        return SharedLayers(self.widths)(x, is_found & is_centroid[:, None])


class PointNet2(nn.Module):
    """The three levels of the classifier for clouds of 1,024 points: 512 groups, 128 groups, one.

    The centroids of the first level are given: clouds have an order whose prefixes are good samples, and
    farthest-point sampling of 20,480 points would cost more than all the rest. For one object a prefix *is*
    the farthest-point sample. For a scene it is one sample for each object and one for the top, of equal
    size; over the whole scene they are denser on small objects than farthest-point sampling would be.
    The second level samples farthest points of the first level's centroids, wherever they lie.

    Attributes:
      num_features: F.
      group_size: of the first level; the second takes twice as many.
    """

    num_features: int = 1024
    group_size: int = 32

    @nn.compact
    def __call__(self, cloud: Array, mask: Array, centroids: Array) -> Array:
        """f32[F] of a cloud f32[P, 3] of radius about 1.

        Args:
          mask: bool[P], the points that count.
          centroids: i32[S], of the first level; those that do not count are passed over.
        """
        cloud = jnp.where(mask[:, None], cloud, 0.0)
        first = SetAbstraction(RADII[0], self.group_size, (64, 64, 128))
        second = SetAbstraction(RADII[1], 2 * self.group_size, (128, 128, 256))
        features = first(cloud, mask, None, centroids, mask[centroids])
        cloud, mask = cloud[centroids], mask[centroids]
        index, is_centroid = farthest_points(cloud, mask, max(len(centroids) // 4, 1))
        index, is_centroid = checkpoint_name(index, NEIGHBOURS), checkpoint_name(is_centroid, NEIGHBOURS)
        features = second(cloud, mask, features, index, is_centroid)
        x = _joined(2 * cloud[index], features)
        return SharedLayers((256, 512, self.num_features))(x, is_centroid)
