"""Pretraining a point encoder: telling the modeller's families apart."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.assets.modeller.catalog import FAMILIES
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.networks.config import NetworkConfig
from cluttergen_jax.learning.ppo import checkpoint
from cluttergen_jax.learning.training.classifier import (
    Classifier,
    ClassifierTrainer,
    FitState,
    ShapeClouds,
    make_clouds,
    turned,
)
from cluttergen_jax.learning.training.interrupt import Interrupt
from cluttergen_jax.numerics import new_key
from cluttergen_jax.progress import Progress

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
      save_every: seconds between checkpoints.
    """

    network: NetworkConfig
    families: tuple[str, ...] = tuple(FAMILIES)
    num_shapes: int = 16
    num_held_out: int = 4
    num_epochs: int = 20
    batch_size: int = 32
    learning_rate: float = 1e-3
    seed: int = 0
    save_every: float = 60.0

    def __post_init__(self) -> None:
        for name in ("num_shapes", "num_held_out", "num_epochs", "batch_size", "learning_rate"):
            if not 0 < getattr(self, name) <= _MOST:
                raise ConfigError(f"{name} = {getattr(self, name)}", f"a positive number, {_MOST} at most")
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
        self.config, self.folder = config, folder
        model = Classifier(config.network, len(config.families))
        self.fit = ClassifierTrainer(model, config.num_steps, config.learning_rate)
        checkpoint.check_folder(folder, {"config": asdict(config)})
        folder.mkdir(parents=True, exist_ok=True)

    def run(self) -> float:
        """The held-out accuracy after the last step.

        Raises:
          KeyboardInterrupt: on Ctrl-C, once everything is saved.
        """
        config, points = self.config, self.config.network.object_points
        with Interrupt() as interrupt:
            state = self._start()
            if int(state.step) < config.num_steps:
                shapes = make_clouds(config.families, _seeds(config, False), points, "shapes")
                state = self._learn(state, shapes, interrupt)
                checkpoint.save_state(self.folder / "last", state, {"config": asdict(config)})
        if int(state.step) < config.num_steps:
            self._save(state, None)
            raise KeyboardInterrupt
        accuracy = self._accuracy(state)
        self._save(state, accuracy)
        return accuracy

    def _start(self) -> FitState:
        points = self.config.network.object_points
        start = jax.jit(self.fit.start, static_argnums=1)
        state = start(new_key(self.config.seed), points)
        last = self.folder / "last"
        return checkpoint.read_state(last, state) if checkpoint.has_state(last) else state

    def _learn(self, state: FitState, shapes: ShapeClouds, interrupt: Interrupt) -> FitState:
        config, step = self.config, jax.jit(self.fit.step, donate_argnums=0)
        first, saved = int(state.step), time.monotonic()
        with Progress("learning", config.num_steps, "step", kept=first) as progress:
            for number in range(first, config.num_steps):
                if interrupt.is_asked:
                    break
                index = self._batch(number)
                key = jax.random.fold_in(new_key(config.seed + 1), number)
                call = partial(interrupt.compiled, step) if number == first else step
                state, loss, accuracy = call(state, shapes.cloud[index], shapes.label[index], key)
                progress.update(note=f"loss {float(loss):.3f} accuracy {float(accuracy):.2f}")
                if time.monotonic() - saved > config.save_every:
                    checkpoint.save_state(self.folder / "last", state, {"config": asdict(config)})
                    saved = time.monotonic()
        return state

    def _batch(self, number: int) -> np.ndarray:
        """The shapes of step `number`: each epoch has an order of its own."""
        config = self.config
        epoch, position = divmod(number, config.batches)
        order = np.random.default_rng([config.seed, epoch]).permutation(
            config.num_shapes * len(config.families)
        )
        return order[position * config.batch_size : (position + 1) * config.batch_size]

    def _accuracy(self, state: FitState) -> float:
        """The share of shapes never learned from that are recognised, each turned about z at random."""
        config = self.config
        shapes = make_clouds(
            config.families, _seeds(config, True), config.network.object_points, "held-out shapes"
        )
        angle = jax.random.uniform(new_key(config.seed), shapes.label.shape, maxval=2 * jnp.pi)
        cloud = jax.vmap(turned)(jnp.asarray(shapes.cloud), angle)
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

    def _save(self, state: FitState, accuracy: float | None) -> None:
        network = self.config.network
        record = {
            "encoder": network.scene_encoder,
            "features": network.object_features,
            "held_out_accuracy": accuracy,
            "num_held_out": self.config.num_held_out * len(self.config.families),
            "steps": int(state.step),
            "config": asdict(self.config),
        }
        checkpoint.save_policy(self.folder, jax.device_get(state.params["encoder"]), record)


def _seeds(config: PretrainConfig, is_held_out: bool) -> list[int]:
    """Of the shapes of each family: even ones to learn from, odd ones to test with."""
    count = config.num_held_out if is_held_out else config.num_shapes
    return [2 * (1000 * config.seed + k) + is_held_out for k in range(count)]


def pretrain_for(network: NetworkConfig, folder: Path, show: Callable[[str], None]) -> None:
    """Pretrains the encoder of a policy's network into a folder, unless that is done.

    Raises:
      ConfigError: the folder holds a pretraining that was begun with other settings.
      KeyboardInterrupt: on Ctrl-C, once everything is saved.
    """
    if is_pretrained(folder):
        return
    show(f"encoder    {folder}, pretrained first: the paper's method keeps it frozen; minutes on two cores")
    sizes = ("object_points", "num_centroids", "group_size", "object_features", "scene_features")
    values = {name: getattr(network, name) for name in sizes}
    Pretraining(PretrainConfig(replace(small(network.scene_encoder), **values)), folder).run()


def is_pretrained(folder: Path) -> bool:
    """Whether a folder holds the weights of a whole pretraining."""
    record = folder / "record.json"
    return record.exists() and checkpoint.read_record(folder).get("held_out_accuracy") is not None


def small(encoder: str) -> NetworkConfig:
    """Sizes with which two cores pretrain an encoder in minutes; its weights fit any number of points."""
    sizes = NetworkConfig(scene_encoder=encoder, object_points=512)
    return sizes if encoder == "set" else replace(sizes, object_features=1024, scene_features=1024)
