"""Fitting of networks to examples: gradient steps, and runs in folders that can be resumed."""

from __future__ import annotations

import json
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from numbers import Integral
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from cluttergen_jax.assets import embedded_root
from cluttergen_jax.config import check_positive
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.geometry import Array
from cluttergen_jax.learning import (
    MetricsLog,
    RunFolder,
    batch_of,
    checkpoints_in,
    hold_run,
    save_policy,
    versions,
)
from cluttergen_jax.numerics import new_key
from cluttergen_jax.progress import time_text

_WARM_UP = 0.02
_MOST = 1_000_000
"""Of epochs, and of examples in a batch."""


class Network(Protocol):
    """A network whose weights are given; a frozen value."""

    @property
    def config(self) -> Any:
        """Sizes of the network, a frozen dataclass of JSON values."""

    def init(self, key: Array) -> Any:
        """Fresh weights."""


class Learner(Network, Protocol):
    """A network and what it learns from an example; a frozen value."""

    def loss(self, params: Any, examples: Any, key: Array) -> tuple[Array, dict[str, Array]]:
        """What to keep low over a batch of examples, f32, and its parts by name."""


def blank_params(network: Network) -> Any:
    """Weights of a network's shapes, all zero."""
    shapes = jax.eval_shape(network.init, new_key(0))
    return jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes)


def embedded_checkpoints(name: str) -> dict[str, Path]:
    """The checkpoints that come with the package in a folder of this name, by their own names."""
    return checkpoints_in(embedded_root() / name)


def config_of(kind: Any, record: Mapping[str, Any], path: Path, hint: str) -> Any:
    """The sizes of a network as the record of its checkpoint in `path` has them.

    Raises:
      PoolError: the record does not say them.
    """
    try:
        sizes = {each.name: record["network"][each.name] for each in fields(kind)}
        return kind(
            **{
                key: tuple(value) if isinstance(value, list) else value
                for key, value in sizes.items()
            }
        )
    except (TypeError, KeyError) as error:
        place = path / "record.json"
        raise PoolError(
            f"{place} does not say what network it holds ({error})", hint=hint
        ) from error


@dataclass(frozen=True)
class FitConfig:
    """How a network is fitted.

    Attributes:
      num_epochs: times that all examples are seen; batch_size: examples a step.
      learning_rate: of AdamW, at its highest.
      schedule: "cosine" (after a short warm-up) or "linear", either down to zero.
      weight_decay: of AdamW.
      seed: of weights and order.
    """

    num_epochs: int = 12
    batch_size: int = 32
    learning_rate: float = 2e-3
    schedule: Literal["cosine", "linear"] = "cosine"
    weight_decay: float = 1e-3
    seed: int = 0

    def __post_init__(self) -> None:
        check_positive(self, "num_epochs", "batch_size", "learning_rate")
        for name in ("num_epochs", "batch_size"):
            if not isinstance(value := getattr(self, name), Integral) or int(value) > _MOST:
                raise ConfigError(f"FitConfig.{name} = {value!r}", f"1 to {_MOST}, a whole number")

    def replace_given(
        self,
        num_epochs: int | None = None,
        batch_size: int | None = None,
        learning_rate: float | None = None,
        seed: int | None = None,
    ) -> FitConfig:
        """The same with those of these that are not None."""
        given: dict[str, Any] = {
            "num_epochs": num_epochs,
            "batch_size": batch_size,
            "learning_rate": learning_rate,
            "seed": seed,
        }
        return replace(self, **{name: each for name, each in given.items() if each is not None})

    def optimizer(self, num_steps: int) -> optax.GradientTransformation:
        """For a run of so many steps."""
        rate = optax.linear_schedule(self.learning_rate, 0.0, num_steps)
        if self.schedule == "cosine":
            warm_up = max(int(_WARM_UP * num_steps), 1)
            rate = optax.join_schedules(
                [
                    optax.linear_schedule(0.0, self.learning_rate, warm_up),
                    optax.cosine_decay_schedule(self.learning_rate, max(num_steps - warm_up, 1)),
                ],
                [warm_up],
            )
        decay = optax.adamw(rate, weight_decay=self.weight_decay)
        return optax.chain(optax.clip_by_global_norm(1.0), decay)


class FitState(struct.PyTreeNode):
    """What a run changes.

    Attributes:
      params: weights; optimizer: Adam's moments; step: i32, steps done.
      best: the weights of the least loss on the validation split so far; best_loss: f32, that loss.
    """

    params: Any
    optimizer: optax.OptState
    step: Array
    best: Any
    best_loss: Array


@dataclass(frozen=True)
class Fit:
    """Gradient steps of one network; pure, whoever drives them compiles.

    Attributes:
      learner: what is fitted; config: how; num_steps: of the whole run.
    """

    learner: Learner
    config: FitConfig
    num_steps: int

    def start(self) -> FitState:
        """Fresh weights."""
        params = self.learner.init(new_key(self.config.seed))
        moments = self.config.optimizer(self.num_steps).init(params)
        return FitState(params, moments, jnp.int32(0), params, jnp.float32(jnp.inf))

    def step(self, state: FitState, examples: Any) -> tuple[FitState, dict[str, Array]]:
        """One step on a batch of prepared examples: the new state, and the loss with its parts."""
        key = jax.random.fold_in(new_key(self.config.seed + 1), state.step)
        gradient = jax.value_and_grad(self.learner.loss, has_aux=True)
        (loss, parts), slope = gradient(state.params, examples, key)
        optimizer = self.config.optimizer(self.num_steps)
        change, moments = optimizer.update(slope, state.optimizer, state.params)
        params = optax.apply_updates(state.params, change)
        return state.replace(params=params, optimizer=moments, step=state.step + 1), {
            "loss": loss,
            **parts,
        }

    def loss(self, params: Any, examples: Any) -> Array:
        """f32: the loss on examples that nothing is learned from."""
        return self.learner.loss(params, examples, new_key(0))[0]


def in_parts(call: Callable[[Any], Any], examples: Any, size: int) -> Iterator[Any]:
    """What `call` makes of all the examples, NumPy arrays, so many at a time.

    The last part is filled up with the last example, so that one program serves all.
    """
    number = num_examples(examples)
    for first in range(0, number, size):
        made = jax.device_get(
            call(take(examples, np.minimum(np.arange(first, first + size), number - 1)))
        )
        yield take(made, np.arange(min(size, number - first)))


def concatenate(parts: Sequence[Any]) -> Any:
    """Examples in parts as one."""
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)


def num_examples(examples: Any) -> int:
    """How many there are: the leading axis of all arrays."""
    return len(jax.tree.leaves(examples)[0])


def take(examples: Any, which: np.ndarray) -> Any:
    """Some of the examples: i[M] or bool[N]; None if there are none."""
    index = np.flatnonzero(which) if which.dtype == bool else which
    return jax.tree.map(lambda leaf: leaf[index], examples) if len(index) else None


# Fits and learners are values: equal ones share what is compiled.
_start: Any = jax.jit(Fit.start, static_argnums=0)
_step: Any = jax.jit(Fit.step, static_argnums=0)
_loss: Any = jax.jit(Fit.loss, static_argnums=0)


class FitRun(ABC):
    """A run in a folder: `metrics.csv`, `last/` (to go on from), and the checkpoint, in a folder of its kind.

    Args:
      learner, config: what is fitted, and how.
      recipe: what decides the run besides: JSON values.
      folder: continued if it holds a run with the same settings.
      show: is given the lines that tell how far the run is.

    Raises:
      ConfigError: the folder holds a run with other settings.
    """

    kind: ClassVar[str]
    """Of what is fitted: its folder's name."""
    unit: ClassVar[str]
    """What an example is called."""

    def __init__(
        self,
        learner: Learner,
        config: FitConfig,
        recipe: Mapping[str, object],
        folder: Path,
        show: Callable[[str], None] = print,
    ) -> None:
        self.learner = learner
        self.config = config
        self.folder = folder
        self._show = show
        self.recipe = {"network": asdict(learner.config), "fit": asdict(config), **recipe}
        self._kept = RunFolder(folder, self.recipe)

    @abstractmethod
    def examples(self, split: str) -> Any:
        """The examples of `train` or `val` as the learner reads them: NumPy arrays with a leading axis."""

    @abstractmethod
    def save(self, state: FitState, held_out: Any) -> Path:
        """Stores the best weights with their record; their folder."""

    def store(self, state: FitState, validation: Mapping[str, object], **more: object) -> Path:
        """Stores the best weights; validation: what they were worth besides the loss; more: of the record."""
        folder = self.folder / self.kind
        record = {
            "kind": self.kind,
            **self.recipe,
            **more,
            "validation": {"loss": float(state.best_loss), **validation},
            "versions": versions(),
        }
        save_policy(folder, jax.device_get(state.best), record)
        return folder

    def run(self) -> Path:
        """The checkpoint's folder, after the last step; at once if it is there already.

        Raises:
          ConfigError: there are too few examples, some are not finite, or the loss is not.
          BankError: another process writes the run.
          KeyboardInterrupt: on Ctrl-C, once everything is saved.
        """
        with hold_run(self.folder):
            # Another process may have made a run here since.
            self._kept.check()
            return self.folder / self.kind if self._is_done() else self._run()

    def _run(self) -> Path:
        started = time.monotonic()
        held_out = self._sound("val")
        examples = self._sound("train")
        batches = num_examples(examples) // self.config.batch_size
        if not batches:
            raise ConfigError(
                f"{num_examples(examples)} {self.unit}s in batches of {self.config.batch_size}",
                "one batch or more",
            )
        fit = Fit(self.learner, self.config, batches * self.config.num_epochs)
        state = self._learn(fit, self._kept.load(_start(fit)), examples, held_out)
        if int(state.step) < fit.num_steps:
            raise KeyboardInterrupt
        folder = self.save(state, held_out)
        self._show(f"time       {time_text(time.monotonic() - started)}; {self.kind} in {folder}")
        return folder

    def _sound(self, split: str) -> Any:
        """`examples`, all of whose numbers are finite: what learns from others learns nothing.

        Raises:
          ConfigError: some are not.
        """
        examples = self.examples(split)
        for place, leaf in jax.tree_util.tree_leaves_with_path(examples):
            values = np.asarray(leaf)
            # Infinite is what a picture has where nothing is, and what a map has where nothing was seen.
            if values.dtype.kind == "f" and np.isnan(values).any():
                name = jax.tree_util.keystr(place)
                raise ConfigError(
                    f"{self.unit}s of {split!r} with numbers that are none (NaN in {name})",
                    f"{self.unit}s of finite numbers",
                    f"making the {self.unit}s again",
                )
        return examples

    def _is_done(self) -> bool:
        """Whether the folder holds this run's checkpoint, which is written last."""
        record = self._kept.record(self.kind)
        recipe = json.loads(json.dumps(self.recipe))
        return bool(record) and {name: record.get(name) for name in recipe} == recipe

    def _learn(self, fit: Fit, state: FitState, examples: Any, held_out: Any) -> FitState:
        batches = fit.num_steps // self.config.num_epochs
        log = MetricsLog(self.folder / "metrics.csv", int(state.step) // batches)
        seen: list[dict[str, Array]] = []
        note = ""

        def step(number: int, state: FitState) -> tuple[FitState, str]:
            nonlocal note
            size = self.config.batch_size
            index = batch_of(number, size, num_examples(examples), self.config.seed)
            state, parts = _step(fit, state, take(examples, np.sort(index)))
            seen.append(parts)
            if (number + 1) % batches == 0:
                state, note = self._end_epoch(fit, state, held_out, seen, log, number // batches)
                seen.clear()
            return state, note

        return self._kept.learn(state, fit.num_steps, step)

    def _end_epoch(
        self,
        fit: Fit,
        state: FitState,
        held_out: Any,
        seen: list[dict[str, Array]],
        log: MetricsLog,
        epoch: int,
    ) -> tuple[FitState, str]:
        """The state with the best weights so far, and what to say."""
        row = {name: float(np.mean([float(each[name]) for each in seen])) for name in seen[0]}
        parts = list(self.batches_of(held_out))
        weights = [num_examples(part) for part in parts]
        found = float(
            np.average([float(_loss(fit, state.params, part)) for part in parts], weights=weights)
        )
        log.add({"update": epoch, **row, "val_loss": found})
        if not np.isfinite([found, row["loss"]]).all():
            told = f"loss {row['loss']:g}, validation {found:g}"
            raise ConfigError(
                f"learning came to nothing in epoch {epoch}: {told}",
                "finite numbers",
                "a lower `learning_rate`, in a new folder",
            )
        if found < float(state.best_loss):
            best = jax.tree.map(jnp.array, state.params)
            state = state.replace(best=best, best_loss=jnp.float32(found))
        return state, f"loss {row['loss']:.3f}, validation {found:.3f}"

    def batches_of(self, examples: Any) -> Iterator[Any]:
        """The examples in parts of at most a batch."""
        number = num_examples(examples)
        size = self.config.batch_size
        for first in range(0, number, size):
            yield take(examples, np.arange(first, min(first + size, number)))
