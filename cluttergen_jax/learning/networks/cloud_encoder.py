"""The scene and the current object as point clouds: what a PointNet or a PointNet++ sees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
from jax.ad_checkpoint import checkpoint_name

from cluttergen_jax.learning.networks.config import NetworkConfig
from cluttergen_jax.placement.clouds import CloudLayout, scene_cloud
from cluttergen_jax.types import Array

_SEARCHED_AT_ONCE = 1 << 20
"""Distances held at one time per cloud: four megabytes, whatever the size of the cloud."""


def farthest_points(cloud: Array, mask: Array, number: int) -> tuple[Array, Array]:
    """Farthest-point sampling, as `assets.cloud.farthest_first` orders a cloud.

    Starts with the point farthest from the mean, so that the order of the points does not matter. One step
    per point chosen: for small numbers, or where no order was computed before.

    Args:
      cloud: f32[P, 3]; mask: bool[P], the points that count, at least one.

    Returns:
      i32[number], and bool[number]: False once every point that counts was chosen.
    """
    count = jnp.sum(mask)
    mean = jnp.sum(jnp.where(mask[:, None], cloud, 0.0), axis=0) / jnp.maximum(count, 1)
    from_mean = jnp.where(mask, jnp.sum((cloud - mean) ** 2, axis=1), -1.0)

    def choose(carry: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], Array]:
        distance, current = carry
        to_current = jnp.sum((cloud - cloud[current]) ** 2, axis=1)
        distance = jnp.minimum(distance, jnp.where(mask, to_current, -1.0))
        return (distance, jnp.argmax(distance).astype(jnp.int32)), current

    start = (jnp.full(cloud.shape[0], jnp.inf), jnp.argmax(from_mean).astype(jnp.int32))
    _, index = jax.lax.scan(choose, start, length=number)
    return index, jnp.arange(number) < count


def ball_query(
    centres: Array, cloud: Array, mask: Array, radius: float, number: int
) -> tuple[Array, Array]:
    """The nearest points within a radius of each centre.

    PointNet++ takes the first points that it finds; the nearest do not depend on the order of the points.

    Args:
      centres: f32[S, 3]; cloud: f32[P, 3]; mask: bool[P], the points that count.
      radius: in the unit of the cloud; number: G, at most P are given.

    Returns:
      i32[S, G] by distance, and bool[S, G]: whether there is such a point.
    """
    number = min(number, cloud.shape[0])
    along = cloud.T

    def around(centre: Array) -> tuple[Array, Array]:
        # Differences, not the expanded square: that one cancels, and runs at low precision on a GPU.
        distance = jnp.where(mask, sum((along[i] - centre[i]) ** 2 for i in range(3)), jnp.inf)
        nearest, index = jax.lax.top_k(-distance, number)
        return index, -nearest <= radius**2

    block = max(_SEARCHED_AT_ONCE // cloud.shape[0], 1)
    if block >= centres.shape[0]:
        return jax.vmap(around)(centres)
    return jax.lax.map(around, centres, batch_size=block)


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


def _concatenate_weighted(position: Array, features: Array) -> Array:
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
        found = checkpoint_name(found, NEIGHBOURS)
        is_found = checkpoint_name(is_found, NEIGHBOURS)
        x = (cloud[found] - centres[:, None]) / self.radius
        x = x if features is None else _concatenate_weighted(x, features[found])
        return SharedLayers(self.widths)(x, is_found & is_centroid[:, None])


class PointNet2(nn.Module):
    """The three levels of the classifier for clouds of 1,024 points: 512 groups, 128 groups, one.

    The centroids of the first level are given: clouds have an order whose prefixes are good samples, and
    farthest-point sampling of 20,480 points would cost more than all the rest. For one object a prefix is
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
        cloud = cloud[centroids]
        mask = mask[centroids]
        index, is_centroid = farthest_points(cloud, mask, max(len(centroids) // 4, 1))
        index = checkpoint_name(index, NEIGHBOURS)
        is_centroid = checkpoint_name(is_centroid, NEIGHBOURS)
        features = second(cloud, mask, features, index, is_centroid)
        x = _concatenate_weighted(2 * cloud[index], features)
        return SharedLayers((256, 512, self.num_features))(x, is_centroid)


CHUNK = 32
"""Scenes encoded at one time: at full size each takes tens of megabytes on its way."""


class CloudNet(nn.Module):
    """One padded cloud to one feature vector.

    Attributes:
      kind: "pointnet" or "pointnet2".
      num_features: F; group_size: of PointNet++.
    """

    kind: str
    num_features: int
    group_size: int

    @nn.compact
    def __call__(self, cloud: Array, mask: Array, centroids: Array) -> Array:
        """f32[F] from f32[P, 3] of radius about 1, bool[P] and the centroids i32[S] (PointNet++ alone)."""
        if self.kind == "pointnet2":
            return PointNet2(self.num_features, self.group_size)(cloud, mask, centroids)
        cloud = jnp.where(mask[:, None], cloud, 0.0)
        return SharedLayers((64, 128, self.num_features))(cloud, mask)


def first_centroids(num_points: int, config: NetworkConfig) -> int:
    """S of the first level for clouds of `num_points`."""
    return max(min(config.num_centroids, num_points // 2), 1)


class CloudEncoder(nn.Module):
    """Two networks of one kind, for objects and for scenes; clouds are divided by their radius first.

    Attributes:
      config: sizes and kinds.
      max_objects: the most objects that can stand at once; weights do not depend on it.
    """

    config: NetworkConfig
    max_objects: int

    def setup(self) -> None:
        config = self.config
        self.object_net = CloudNet(config.scene_encoder, config.object_features, config.group_size)
        self.scene_net = CloudNet(config.scene_encoder, config.scene_features, config.group_size)

    def of_object(self, cloud: Array, half_extents: Array) -> Array:
        """f32[F] of one object's cloud f32[P, 3] and half extents f32[3], metres."""
        cloud = cloud[: self.config.object_points]
        centroids = np.arange(first_centroids(len(cloud), self.config))
        return self.object_net(cloud / _radius(half_extents), jnp.ones(len(cloud), bool), centroids)

    def of_scene(self, clouds: Array, poses: Array, is_placed: Array, region: Array) -> Array:
        """f32[F] of one scene: clouds f32[K, P, 3], poses f32[K, 7], bool[K], region f32[3], metres."""
        number = self.config.scene_points
        cloud, mask = scene_cloud(clouds, poses, is_placed, region[:2], number, self.max_objects)
        layout = CloudLayout.of(number, self.max_objects, clouds.shape[1])
        centroids = layout.prefixes(first_centroids(number, self.config))
        return self.scene_net(cloud / _radius(region[:2]), mask, centroids)

    def __call__(
        self, clouds: Array, half_extents: Array, poses: Array, is_placed: Array, region: Array
    ) -> tuple[Array, Array]:
        """The features of object 0 and of one scene; makes all weights."""
        return self.of_object(clouds[0], half_extents[0]), self.of_scene(
            clouds, poses, is_placed, region
        )


def _radius(half_extents: Array) -> Array:
    return jnp.maximum(jnp.linalg.norm(half_extents), 1e-6)


def init_encoder(encoder: CloudEncoder, key: Array, clouds: Array, half_extents: Array) -> Any:
    """Fresh weights; `clouds` f32[K, P, 3] and `half_extents` f32[K, 3] are the world's."""
    nothing = jnp.zeros((len(clouds), 7)), jnp.zeros(len(clouds), bool)
    return jax.jit(encoder.init)(key, clouds, half_extents, *nothing, jnp.ones(3))["params"]


def encode_objects(
    encoder: CloudEncoder, weights: Any, clouds: Array, half_extents: Array
) -> Array:
    """f32[K, F] of every object."""
    apply = encoder.apply
    return jax.vmap(lambda *each: apply({"params": weights}, *each, method="of_object"))(
        clouds, half_extents
    )


def encode_scenes(
    encoder: CloudEncoder, weights: Any, clouds: Array, observation: Mapping[str, Any]
) -> Array:
    """f32[B, F] of observations with a leading axis B (see `placement.observation.observe`).

    At most CHUNK scenes are worked on at a time, and the backward pass makes each chunk's clouds and layers
    again; only what the searches found is kept.
    """
    apply = encoder.apply

    def encode(scene: tuple[Array, Array, Array]) -> Array:
        return apply({"params": weights}, clouds, *scene, method="of_scene")

    kept = jax.checkpoint_policies.save_only_these_names(NEIGHBOURS)
    scenes = observation["T_region_object"], observation["is_placed"], observation["region"]
    return jax.lax.map(
        jax.checkpoint(encode, policy=kept), scenes, batch_size=_chunk(len(scenes[1]))
    )


def _chunk(batch: int) -> int:
    """The largest divisor of the batch up to CHUNK, unless it is much smaller: what is left over is a
    program of its own."""
    divisor = max(each for each in range(1, CHUNK + 1) if batch % each == 0)
    return divisor if divisor >= min(CHUNK // 4, batch) else CHUNK
