"""Pretraining a point encoder: telling the modeller's families apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from cluttergen_jax.assets import join_meshes
from cluttergen_jax.assets.cloud import farthest_first, sample_surface
from cluttergen_jax.assets.modeller.catalog import FAMILIES, make_shape
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.networks.actor_critic import PointNet
from cluttergen_jax.learning.networks.cloud_encoder import CloudNet, first_centroids
from cluttergen_jax.learning.networks.config import NetworkConfig
from cluttergen_jax.learning.ppo.checkpoint import read_record, save_policy
from cluttergen_jax.learning.training.run_folder import (
    RunFolder,
    batch_of,
    hold_run,
)
from cluttergen_jax.numerics import new_key
from cluttergen_jax.progress import track
from cluttergen_jax.types import Array

_STRETCH = 0.15
"""Each axis of a cloud that is learned from is stretched by 1 - this to 1 + this."""
_JITTER = 0.01
"""Standard deviation of what is added to each coordinate, in units of the object's radius."""
_HOLE = 0.4
"""A ball of up to this radius, in units of the object's, is cut out around one of the points."""


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
            net = CloudNet(
                config.scene_encoder, config.object_features, config.group_size, name="encoder"
            )
            features = net(cloud / radius, mask, jnp.arange(first_centroids(len(cloud), config)))
        else:
            features = PointNet(num_features=config.object_features, name="encoder")(cloud, mask)
        return nn.Dense(self.num_classes)(nn.relu(nn.Dense(256)(features)))


class ClassifierState(struct.PyTreeNode):
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
    """

    model: Classifier
    num_steps: int
    learning_rate: float = 1e-3

    def _optimizer(self) -> optax.GradientTransformation:
        rate = optax.cosine_decay_schedule(self.learning_rate, self.num_steps)
        return optax.chain(optax.clip_by_global_norm(1.0), optax.adamw(rate, weight_decay=1e-4))

    def start(self, key: Array, num_points: int) -> ClassifierState:
        """Fresh weights for clouds of `num_points`."""
        params = self.model.init(key, jnp.zeros((num_points, 3)), jnp.ones(num_points, bool))[
            "params"
        ]
        return ClassifierState(params, self._optimizer().init(params), jnp.int32(0))

    def logits(self, params: Any, cloud: Array, mask: Array) -> Array:
        """f32[B, C] of clouds f32[B, P, 3] and masks bool[B, P]."""
        return jax.vmap(lambda *each: self.model.apply({"params": params}, *each))(cloud, mask)

    def step(
        self, state: ClassifierState, cloud: Array, label: Array, key: Array
    ) -> tuple[ClassifierState, Array, Array]:
        """One gradient step on clouds f32[B, P, 3] with labels i32[B]: the new state, loss and accuracy."""
        cloud, mask = jax.vmap(augment)(cloud, jax.random.split(key, len(cloud)))

        def loss_of(params: Any) -> tuple[Array, Array]:
            logits = self.logits(params, cloud, mask)
            loss = optax.softmax_cross_entropy_with_integer_labels(logits, label)
            return jnp.mean(loss), jnp.mean(jnp.argmax(logits, axis=-1) == label)

        (loss, accuracy), gradient = jax.value_and_grad(loss_of, has_aux=True)(state.params)
        change, optimizer = self._optimizer().update(gradient, state.optimizer, state.params)
        params = optax.apply_updates(state.params, change)
        return ClassifierState(params, optimizer, state.step + 1), loss, accuracy


def augment(cloud: Array, key: Array) -> tuple[Array, Array]:
    """A cloud f32[P, 3] varied and turned about z, and bool[P]: the points that are left of it."""
    key_scale, key_turn, key_jitter, key_where, key_hole = jax.random.split(key, 5)
    cloud = cloud * jax.random.uniform(key_scale, (3,), minval=1 - _STRETCH, maxval=1 + _STRETCH)
    cloud = rotate_about_z(cloud, jax.random.uniform(key_turn, maxval=2 * jnp.pi))
    radius = jnp.max(jnp.linalg.norm(cloud, axis=-1))
    centre = cloud[jax.random.randint(key_where, (), 0, len(cloud))]
    hole = radius * jax.random.uniform(key_hole, maxval=_HOLE)
    mask = jnp.linalg.norm(cloud - centre, axis=-1) >= hole
    cloud = cloud + radius * _JITTER * jax.random.normal(key_jitter, cloud.shape)
    # A small thing may lie in the ball whole.
    return cloud, mask | ~jnp.any(mask)


def rotate_about_z(cloud: Array, angle: Array) -> Array:
    """A cloud f32[P, 3] turned about z, radians."""
    cos = jnp.cos(angle)
    sin = jnp.sin(angle)
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


def make_clouds(
    families: Sequence[str], seeds: Sequence[int], num_points: int, title: str
) -> ShapeClouds:
    """One cloud of each family for each seed, with a progress bar."""
    wanted = [(label, seed) for label in range(len(families)) for seed in seeds]
    bar = track(wanted, title, len(wanted), "shape")
    cloud = np.stack([shape_cloud(families[label], seed, num_points) for label, seed in bar])
    return ShapeClouds(cloud, np.array([label for label, _ in wanted], np.int32))


_MOST = 1_000_000


@dataclass(frozen=True)
class PretrainConfig:
    """What is learned, and from how much.

    Attributes:
      network: its `scene_encoder`, `object_*` fields and those of PointNet++ count.
      families: of the modeller; each is a class.
      num_shapes, num_held_out: objects of each family to learn from and to test with; none is in both.
      num_epochs, batch_size, learning_rate: of the optimisation.
      seed: of shapes, weights and their order.
    """

    network: NetworkConfig
    families: tuple[str, ...] = tuple(FAMILIES)
    num_shapes: int = 16
    num_held_out: int = 4
    num_epochs: int = 20
    batch_size: int = 32
    learning_rate: float = 1e-3
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("num_shapes", "num_held_out", "num_epochs", "batch_size", "learning_rate"):
            if not 0 < getattr(self, name) <= _MOST:
                raise ConfigError(
                    f"{name} = {getattr(self, name)}", f"a positive number, {_MOST} at most"
                )
        if self.num_steps == 0:
            raise ConfigError(
                f"batches of {self.batch_size} from {self.num_shapes} x {len(self.families)} shapes",
                "at least one whole batch",
            )

    @property
    def batches(self) -> int:
        """Per epoch."""
        return self.num_shapes * len(self.families) // self.batch_size

    @property
    def num_steps(self) -> int:
        """Of the whole run."""
        return self.num_epochs * self.batches


@dataclass(frozen=True)
class PretrainReport:
    """What a pretraining left: the run's folder, and the accuracy on shapes that were not learned from."""

    folder: Path
    accuracy: float
    num_held_out: int
    num_families: int


class Pretraining:
    """A run in a folder: `weights.npz` and `record.json` (the encoder), `last/` (to go on from).

    Args:
      config: what is learned.
      folder: continued if it holds a run with the same config.

    Raises:
      ConfigError: the folder holds a run with another config.
    """

    def __init__(self, config: PretrainConfig, folder: Path) -> None:
        self.config = config
        self.folder = folder
        model = Classifier(config.network, len(config.families))
        self.fit = ClassifierTrainer(model, config.num_steps, config.learning_rate)
        self._run = RunFolder(folder, {"config": asdict(config)})
        folder.mkdir(parents=True, exist_ok=True)

    def run(self) -> float:
        """The held-out accuracy after the last step.

        Raises:
          KeyboardInterrupt: on Ctrl-C, once everything is saved.
        """
        config = self.config
        points = self.config.network.object_points
        state = self._start()
        if int(state.step) < config.num_steps:
            shapes = make_clouds(config.families, _seeds(config, False), points, "shapes")
            state = self._learn(state, shapes)
        if int(state.step) < config.num_steps:
            self._save(state, None)
            raise KeyboardInterrupt
        accuracy = self._accuracy(state)
        self._save(state, accuracy)
        return accuracy

    def _start(self) -> ClassifierState:
        points = self.config.network.object_points
        start = jax.jit(self.fit.start, static_argnums=1)
        state: ClassifierState = self._run.load(start(new_key(self.config.seed), points))
        return state

    def _learn(self, state: ClassifierState, shapes: ShapeClouds) -> ClassifierState:
        config = self.config
        compiled = jax.jit(self.fit.step, donate_argnums=0)

        def step(number: int, state: ClassifierState) -> tuple[ClassifierState, str]:
            index = batch_of(number, config.batch_size, len(shapes.label), config.seed)
            key = jax.random.fold_in(new_key(config.seed + 1), number)
            clouds = shapes.cloud[index]
            state, loss, accuracy = compiled(state, clouds, shapes.label[index], key)
            return state, f"loss {float(loss):.3f} accuracy {float(accuracy):.2f}"

        return self._run.learn(state, config.num_steps, step)

    def _accuracy(self, state: ClassifierState) -> float:
        """The share of shapes never learned from that are recognised, each turned about z at random."""
        config = self.config
        shapes = make_clouds(
            config.families, _seeds(config, True), config.network.object_points, "held-out shapes"
        )
        angle = jax.random.uniform(new_key(config.seed), shapes.label.shape, maxval=2 * jnp.pi)
        cloud = jax.vmap(rotate_about_z)(jnp.asarray(shapes.cloud), angle)
        logits = jax.jit(self.fit.logits)
        whole = np.ones((config.batch_size, cloud.shape[1]), bool)
        right = 0
        for start in range(0, len(cloud), config.batch_size):
            # The last batch is filled up with its own first shape, so that one program serves all.
            index = np.arange(start, start + config.batch_size)
            index = np.where(index < len(cloud), index, start)
            number = min(config.batch_size, len(cloud) - start)
            found = np.asarray(logits(state.params, cloud[index], whole)).argmax(-1)
            right += int((found == shapes.label[index])[:number].sum())
        return right / len(cloud)

    def _save(self, state: ClassifierState, accuracy: float | None) -> None:
        network = self.config.network
        record = {
            "encoder": network.scene_encoder,
            "features": network.object_features,
            "held_out_accuracy": accuracy,
            "num_held_out": self.config.num_held_out * len(self.config.families),
            "steps": int(state.step),
            "config": asdict(self.config),
        }
        save_policy(self.folder, jax.device_get(state.params["encoder"]), record)


def _seeds(config: PretrainConfig, is_held_out: bool) -> list[int]:
    """Of the shapes of each family: even ones to learn from, odd ones to test with."""
    count = config.num_held_out if is_held_out else config.num_shapes
    return [2 * (1000 * config.seed + k) + is_held_out for k in range(count)]


_LONGEST_RUN = 7200.0
"""Seconds for which the others wait for the process that pretrains."""


def pretrain_for(network: NetworkConfig, folder: Path, show: Callable[[str], None]) -> None:
    """Pretrains the encoder of a policy's network into a folder, unless that is done.

    Raises:
      ConfigError: the folder holds a pretraining that was begun with other settings.
      KeyboardInterrupt: on Ctrl-C, once everything is saved.
    """
    if is_pretrained(folder):
        return
    show(
        f"encoder    {folder}, pretrained first: the paper's method keeps it frozen; minutes on two cores"
    )
    sizes = ("object_points", "num_centroids", "group_size", "object_features", "scene_features")
    values = {name: getattr(network, name) for name in sizes}
    # Several processes that train one policy together come here at once: one of them pretrains.
    with hold_run(folder, _LONGEST_RUN if jax.process_count() > 1 else 0.0):
        if not is_pretrained(folder):
            Pretraining(
                PretrainConfig(replace(small(network.scene_encoder), **values)), folder
            ).run()


def is_pretrained(folder: Path) -> bool:
    """Whether a folder holds the weights of a whole pretraining."""
    record = folder / "record.json"
    return record.exists() and read_record(folder).get("held_out_accuracy") is not None


def small(encoder: str) -> NetworkConfig:
    """Sizes with which two cores pretrain an encoder in minutes; its weights fit any number of points."""
    sizes = NetworkConfig(scene_encoder=encoder, object_points=512)
    return sizes if encoder == "set" else replace(sizes, object_features=1024, scene_features=1024)
