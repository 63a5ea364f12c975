"""The scene and the current object as point clouds: what a PointNet or a PointNet++ sees."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.learning.networks.config import NetworkConfig
from cluttergen_jax.learning.networks.pointnet2 import NEIGHBOURS, PointNet2, SharedLayers
from cluttergen_jax.placement.clouds import CloudLayout, scene_cloud
from cluttergen_jax.types import Array

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
        return self.of_object(clouds[0], half_extents[0]), self.of_scene(clouds, poses, is_placed, region)


def _radius(half_extents: Array) -> Array:
    return jnp.maximum(jnp.linalg.norm(half_extents), 1e-6)


def init_encoder(encoder: CloudEncoder, key: Array, clouds: Array, half_extents: Array) -> Any:
    """Fresh weights; `clouds` f32[K, P, 3] and `half_extents` f32[K, 3] are the world's."""
    nothing = jnp.zeros((len(clouds), 7)), jnp.zeros(len(clouds), bool)
    return jax.jit(encoder.init)(key, clouds, half_extents, *nothing, jnp.ones(3))["params"]


def encode_objects(encoder: CloudEncoder, weights: Any, clouds: Array, half_extents: Array) -> Array:
    """f32[K, F] of every object."""
    apply = encoder.apply
    return jax.vmap(lambda *each: apply({"params": weights}, *each, method="of_object"))(clouds, half_extents)


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
    return jax.lax.map(jax.checkpoint(encode, policy=kept), scenes, batch_size=_chunk(len(scenes[1])))


def _chunk(batch: int) -> int:
    """The largest divisor of the batch up to CHUNK, unless it is much smaller: what is left over is a
    program of its own."""
    divisor = max(each for each in range(1, CHUNK + 1) if batch % each == 0)
    return divisor if divisor >= min(CHUNK // 4, batch) else CHUNK
