"""Training of a placer's head: examples made once, gradient steps, calibration, a checkpoint."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.downstream.placer.heads.head import Example, Head
from cluttergen_jax.downstream.placer.heads.trained import KIND
from cluttergen_jax.downstream.placer.training.examples import ExampleSource, num_examples, taken
from cluttergen_jax.downstream.placer.training.fitting import Fit, FitConfig, FitState, best_temperature
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.ppo import checkpoint
from cluttergen_jax.learning.training.interrupt import Interrupt
from cluttergen_jax.learning.training.metrics_log import MetricsLog
from cluttergen_jax.learning.training.stability import Calibration, calibration, draw_calibration
from cluttergen_jax.progress import COMPILING, Progress, time_text
from cluttergen_jax.types import Array, Verdict

_AT_ONCE = 32
"""Pairs that are prepared by one compiled call."""
_SAVE_EVERY = 60.0

# Fits and heads are values: equal ones share what is compiled.
_start: Any = jax.jit(Fit.start, static_argnums=0)
_step: Any = jax.jit(Fit.step, static_argnums=0)
_loss: Any = jax.jit(Fit.loss, static_argnums=0)
_prepare: Any = jax.jit(lambda head, examples: jax.vmap(head.prepare)(examples), static_argnums=0)


class PlacerTraining:
    """A run in a folder: `metrics.csv`, `last/` (to go on from), `placer/` (the checkpoint).

    Args:
      head, config: what is fitted, and how.
      source: of the examples.
      folder: continued if it holds a run with the same settings.
      show: is given the lines that tell how far the run is.

    Raises:
      ConfigError: the folder holds a run with other settings.
    """

    def __init__(
        self,
        head: Head,
        config: FitConfig,
        source: ExampleSource,
        folder: Path,
        show: Callable[[str], None] = print,
    ) -> None:
        self.head, self.config, self.source, self.folder, self._show = head, config, source, folder, show
        self.recipe = {
            "head": head.kind,
            "network": asdict(head.config),
            "fit": asdict(config),
            "data": source.record,
            "encoder_weights": str(getattr(head, "encoder_weights", None) or ""),
        }
        checkpoint.check_folder(folder, self.recipe)
        folder.mkdir(parents=True, exist_ok=True)

    def run(self) -> Path:
        """The checkpoint's folder, after the last step; at once if it is there already.

        Raises:
          KeyboardInterrupt: on Ctrl-C, once everything is saved.
        """
        if self._is_done():
            return self.folder / "placer"
        started = time.monotonic()
        held_out = self._prepared(self.source.load("val"), "val")
        examples = self._prepared(self.source.load("train"), "train")
        batches = num_examples(examples) // self.config.batch_size
        if not batches:
            raise ConfigError(
                f"{num_examples(examples)} pairs in batches of {self.config.batch_size}", "one batch or more"
            )
        fit = Fit(self.head, self.config, batches * self.config.num_epochs)
        with Interrupt() as interrupt:
            state = self._started(fit)
            state = self._learn(fit, state, examples, held_out, interrupt)
            self._keep(state)
        if int(state.step) < fit.num_steps:
            raise KeyboardInterrupt
        folder = self._save(state, held_out)
        self._show(f"time       {time_text(time.monotonic() - started)}; placer in {folder}")
        return folder

    def _is_done(self) -> bool:
        """Whether the folder holds this run's placer, which is written last."""
        place = self.folder / "placer"
        if not (place / "record.json").is_file():
            return False
        record = checkpoint.read_record(place)
        return all(record.get(name) == value for name, value in json.loads(json.dumps(self.recipe)).items())

    def _prepared(self, examples: Example, split: str) -> Any:
        """All examples of a split as the head reads them, NumPy arrays."""
        number = num_examples(examples)
        parts = []
        with Progress(f"preparing {split}", number, "pair") as progress:
            for first in range(0, number, _AT_ONCE):
                # The last call is filled up with its last pair, so that one program serves all.
                index = np.minimum(np.arange(first, first + _AT_ONCE), number - 1)
                made = jax.device_get(_prepare(self.head, taken(examples, index)))
                count = min(_AT_ONCE, number - first)
                parts.append(jax.tree.map(lambda leaf, n=count: leaf[:n], made))
                progress.update(count)
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)

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
                state, parts = _step(fit, state, taken(examples, index))
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
        parts = list(_batches_of(held_out, self.config.batch_size))
        weights = [num_examples(part) for part in parts]
        found = float(np.average([float(_loss(fit, state.params, part)) for part in parts], weights=weights))
        log.add({"update": epoch, **row, "val_loss": found})
        if found < float(state.best_loss):
            best = jax.tree.map(jnp.array, state.params)
            state = state.replace(best=best, best_loss=jnp.float32(found))
        return state, f"loss {row['loss']:.3f}, validation {found:.3f}"

    def _batch(self, number: int, num_pairs: int, batches: int) -> np.ndarray:
        """The pairs of step `number`: each epoch has an order of its own."""
        epoch, place = divmod(number, batches)
        order = np.random.default_rng([self.config.seed, epoch]).permutation(num_pairs)
        return np.sort(order[place * self.config.batch_size : (place + 1) * self.config.batch_size])

    def _save(self, state: FitState, held_out: Any) -> Path:
        folder = self.folder / "placer"
        temperature, found = self._calibrated(state.best, held_out)
        record = {
            "kind": KIND,
            **self.recipe,
            "temperature": temperature,
            "validation": {
                "loss": float(state.best_loss),
                "calibration": None if found is None else asdict(found),
            },
            "versions": {name: version(name) for name in ("cluttergen_jax", "mujoco", "jax", "flax")},
        }
        checkpoint.save_policy(folder, jax.device_get(state.best), record)
        if found is not None:
            self._show(f"validation {found}")
            draw_calibration({"stands": found}, folder / "calibration.png", "poses of the validation split")
        return folder

    def _calibrated(self, params: Any, held_out: Any) -> tuple[float, Calibration | None]:
        """The temperature of a head that tells chances, and how far they then hold."""
        scores = getattr(self.head, "scores", None)
        if scores is None:
            return 1.0, None
        score = jax.jit(scores)
        parts = [np.asarray(score(params, part)) for part in _batches_of(held_out, self.config.batch_size)]
        logits = np.concatenate(parts).ravel()
        stood = (held_out.verdict == int(Verdict.STABLE)).ravel()
        temperature = best_temperature(logits, stood)
        return temperature, calibration(logits / temperature, stood, held_out.is_on.ravel())


def _batches_of(examples: Any, size: int) -> Iterator[Any]:
    """The examples in parts of at most `size`."""
    number = num_examples(examples)
    for first in range(0, number, size):
        yield taken(examples, np.arange(first, min(first + size, number)))
