"""A shape classifier around a point encoder: clouds of shapes, augmentation, loss and optimiser."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from cluttergen_jax.assets.cloud import farthest_first, sample_surface
from cluttergen_jax.assets.mesh import join_meshes
from cluttergen_jax.assets.modeller.catalog import make_shape
from cluttergen_jax.learning.networks.cloud_encoder import CloudNet, first_centroids
from cluttergen_jax.learning.networks.config import NetworkConfig
from cluttergen_jax.learning.networks.encoders import PointNet
from cluttergen_jax.progress import tracked
from cluttergen_jax.types import Array


@dataclass(frozen=True)
class AugmentConfig:
    """How clouds are varied while learning. Every one is turned about z by any angle.

    Attributes:
      scale: each axis is stretched by 1 - scale to 1 + scale.
      jitter: standard deviation of what is added to each coordinate, in units of the object's radius.
      hole: a ball of up to this radius, in units of the object's, is cut out around one of the points.
    """

    scale: float = 0.15
    jitter: float = 0.01
    hole: float = 0.4


class Classifier(nn.Module):
    """The encoder of objects that `config` asks for, and two layers above it.

    Attributes:
      config: its `object_*` fields and those of PointNet++ count.
      num_classes: C.
    """

    config: NetworkConfig
    num_classes: int

    @nn.compact
    def __call__(self, cloud: Array, mask: Array) -> Array:
        """Logits f32[C] of a cloud f32[P, 3], metres, and its mask bool[P]."""
        config = self.config
        if config.reads_clouds:
            half = jnp.max(jnp.where(mask[:, None], jnp.abs(cloud), 0.0), axis=0)
            radius = jnp.maximum(jnp.linalg.norm(half), 1e-6)
            net = CloudNet(config.scene_encoder, config.object_features, config.group_size, name="encoder")
            features = net(cloud / radius, mask, jnp.arange(first_centroids(len(cloud), config)))
        else:
            features = PointNet(num_features=config.object_features, name="encoder")(cloud, mask)
        return nn.Dense(self.num_classes)(nn.relu(nn.Dense(256)(features)))


class FitState(struct.PyTreeNode):
    """What a step changes: weights, Adam's moments, steps done."""

    params: Any
    optimizer: optax.OptState
    step: Array


@dataclass(frozen=True, eq=False)
class ClassifierTrainer:
    """Learning to tell shapes apart; `start` and `step` are pure, their caller compiles them.

    Attributes:
      model: the classifier.
      num_steps: of the whole run; the rate falls to zero over them.
      learning_rate: of Adam, at first.
      augment: how clouds are varied.
    """

    model: Classifier
    num_steps: int
    learning_rate: float = 1e-3
    augment: AugmentConfig = field(default_factory=AugmentConfig)

    def _optimizer(self) -> optax.GradientTransformation:
        rate = optax.cosine_decay_schedule(self.learning_rate, self.num_steps)
        return optax.chain(optax.clip_by_global_norm(1.0), optax.adamw(rate, weight_decay=1e-4))

    def start(self, key: Array, num_points: int) -> FitState:
        """Fresh weights for clouds of `num_points`."""
        params = self.model.init(key, jnp.zeros((num_points, 3)), jnp.ones(num_points, bool))["params"]
        return FitState(params, self._optimizer().init(params), jnp.int32(0))

    def logits(self, params: Any, cloud: Array, mask: Array) -> Array:
        """f32[B, C] of clouds f32[B, P, 3] and masks bool[B, P]."""
        return jax.vmap(lambda *each: self.model.apply({"params": params}, *each))(cloud, mask)

    def step(self, state: FitState, cloud: Array, label: Array, key: Array) -> tuple[FitState, Array, Array]:
        """One gradient step on clouds f32[B, P, 3] with labels i32[B]: the new state, loss and accuracy."""
        vary = jax.vmap(lambda cloud, key: augmented(cloud, key, self.augment))
        cloud, mask = vary(cloud, jax.random.split(key, len(cloud)))

        def loss_of(params: Any) -> tuple[Array, Array]:
            logits = self.logits(params, cloud, mask)
            loss = optax.softmax_cross_entropy_with_integer_labels(logits, label)
            return jnp.mean(loss), jnp.mean(jnp.argmax(logits, axis=-1) == label)

        (loss, accuracy), gradient = jax.value_and_grad(loss_of, has_aux=True)(state.params)
        change, optimizer = self._optimizer().update(gradient, state.optimizer, state.params)
        params = optax.apply_updates(state.params, change)
        return FitState(params, optimizer, state.step + 1), loss, accuracy


def augmented(cloud: Array, key: Array, config: AugmentConfig) -> tuple[Array, Array]:
    """A cloud f32[P, 3] varied, and bool[P]: the points that are left of it."""
    key_scale, key_turn, key_jitter, key_where, key_hole = jax.random.split(key, 5)
    cloud = cloud * jax.random.uniform(key_scale, (3,), minval=1 - config.scale, maxval=1 + config.scale)
    cloud = turned(cloud, jax.random.uniform(key_turn, maxval=2 * jnp.pi))
    radius = jnp.max(jnp.linalg.norm(cloud, axis=-1))
    centre = cloud[jax.random.randint(key_where, (), 0, len(cloud))]
    hole = radius * jax.random.uniform(key_hole, maxval=config.hole)
    mask = jnp.linalg.norm(cloud - centre, axis=-1) >= hole
    cloud = cloud + radius * config.jitter * jax.random.normal(key_jitter, cloud.shape)
    # A small thing may lie in the ball whole.
    return cloud, mask | ~jnp.any(mask)


def turned(cloud: Array, angle: Array) -> Array:
    """A cloud f32[P, 3] turned about z, radians."""
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    x, y, z = cloud.T
    return jnp.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)


@dataclass(frozen=True, eq=False)
class ShapeClouds:
    """Labelled clouds.

    Attributes:
      cloud: f32[N, P, 3], metres, the bounding box's centre at the origin, farthest-point ordered.
      label: i32[N], of the family.
    """

    cloud: np.ndarray
    label: np.ndarray


def shape_cloud(family: str, seed: int, num_points: int) -> np.ndarray:
    """f32[P, 3]: one object of a family with drawn proportions; equal arguments give equal points.

    The points lie on the surfaces of its pieces, also where one piece hides another.
    """
    mesh = join_meshes([piece.mesh for piece in make_shape(family, seed).pieces])
    points = sample_surface(mesh, num_points, seed)
    lower, upper = mesh.bounds
    return (points[farthest_first(points)] - (lower + upper) / 2).astype(np.float32)


def make_clouds(families: Sequence[str], seeds: Sequence[int], num_points: int, title: str) -> ShapeClouds:
    """One cloud of each family for each seed, with a progress bar."""
    wanted = [(label, seed) for label in range(len(families)) for seed in seeds]
    bar = tracked(wanted, title, len(wanted), "shape")
    cloud = np.stack([shape_cloud(families[label], seed, num_points) for label, seed in bar])
    return ShapeClouds(cloud, np.array([label for label, _ in wanted], np.int32))
