"""A run that fits a network: examples made once, gradient steps, the best weights kept; it can be resumed."""

from __future__ import annotations

import json
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.downstream.fitting.fit import Fit, FitConfig, FitState, Learner, num_examples, taken
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.ppo import checkpoint
from cluttergen_jax.learning.training.interrupt import Interrupt
from cluttergen_jax.learning.training.metrics_log import MetricsLog
from cluttergen_jax.progress import COMPILING, Progress, time_text
from cluttergen_jax.types import Array

_SAVE_EVERY = 60.0

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
        recipe: dict[str, Any],
        folder: Path,
        show: Callable[[str], None] = print,
    ) -> None:
        self.learner, self.config, self.folder, self._show = learner, config, folder, show
        self.recipe = {"network": asdict(learner.config), "fit": asdict(config), **recipe}
        checkpoint.check_folder(folder, self.recipe)

    @abstractmethod
    def examples(self, split: str) -> Any:
        """The examples of `train` or `val` as the learner reads them: NumPy arrays with a leading axis."""

    @abstractmethod
    def save(self, state: FitState, held_out: Any) -> Path:
        """Stores the best weights with their record; their folder."""

    def run(self) -> Path:
        """The checkpoint's folder, after the last step; at once if it is there already.

        Raises:
          ConfigError: there are too few examples, some are not finite, or the loss is not.
          KeyboardInterrupt: on Ctrl-C, once everything is saved.
        """
        if self._is_done():
            return self.folder / self.kind
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
        self.folder.mkdir(parents=True, exist_ok=True)
        with Interrupt() as interrupt:
            state = self._started(fit)
            state = self._learn(fit, state, examples, held_out, interrupt)
            self._keep(state)
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
        place = self.folder / self.kind
        if not (place / "record.json").is_file():
            return False
        record = checkpoint.read_record(place)
        return all(record.get(name) == value for name, value in json.loads(json.dumps(self.recipe)).items())

    def _started(self, fit: Fit) -> FitState:
        state: FitState = _start(fit)
        last = self.folder / "last"
        return checkpoint.read_state(last, state) if checkpoint.has_state(last) else state

    def _keep(self, state: FitState) -> None:
        checkpoint.save_state(self.folder / "last", state, self.recipe)

    def _learn(
        self, fit: Fit, state: FitState, examples: Any, held_out: Any, interrupt: Interrupt
    ) -> FitState:
        batches, first = fit.num_steps // self.config.num_epochs, int(state.step)
        log = MetricsLog(self.folder / "metrics.csv", first // batches)
        seen: list[dict[str, Array]] = []
        saved, note = time.monotonic(), ""
        with Progress("learning", fit.num_steps, "step", kept=first) as progress:
            progress.say(COMPILING)
            for number in range(first, fit.num_steps):
                if interrupt.is_asked:
                    break
                index = self._batch(number, num_examples(examples), batches)
                call = partial(interrupt.run_compiling, _step) if number == first else _step
                state, parts = call(fit, state, taken(examples, index))
                seen.append(parts)
                if (number + 1) % batches == 0:
                    state, note = self._end_epoch(fit, state, held_out, seen, log, number // batches)
                    seen = []
                progress.update(note=note)
                if time.monotonic() - saved > _SAVE_EVERY:
                    self._keep(state)
                    saved = time.monotonic()
        return state

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
        found = float(np.average([float(_loss(fit, state.params, part)) for part in parts], weights=weights))
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

    def _batch(self, number: int, num_examples: int, batches: int) -> np.ndarray:
        """The examples of step `number`: each epoch has an order of its own."""
        epoch, place = divmod(number, batches)
        order = np.random.default_rng([self.config.seed, epoch]).permutation(num_examples)
        return np.sort(order[place * self.config.batch_size : (place + 1) * self.config.batch_size])

    def batches_of(self, examples: Any) -> Iterator[Any]:
        """The examples in parts of at most a batch."""
        number, size = num_examples(examples), self.config.batch_size
        for first in range(0, number, size):
            yield taken(examples, np.arange(first, min(first + size, number)))
