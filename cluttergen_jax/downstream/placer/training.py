"""Training of a head: presets, examples prepared once, gradient steps, calibration, a checkpoint."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from cluttergen_jax.downstream.fitting import (
    FitConfig,
    FitRun,
    FitState,
    concatenate,
    in_parts,
    num_examples,
)
from cluttergen_jax.downstream.placer.examples import ExampleSource
from cluttergen_jax.downstream.placer.heads.checkpoint import HEADS, KIND, REMOVED_HEADS, Head
from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.learning import Calibration, calibration, draw_calibration
from cluttergen_jax.progress import Progress
from cluttergen_jax.types import Verdict


def head_of_name(head: str) -> Head:
    """The untrained head of that name, of the usual sizes.

    Raises:
      ConfigError: there is no such head.
    """
    if head in REMOVED_HEADS:
        given = f"head {head!r}, which was removed after version 0.1.0"
        raise ConfigError(given, ", ".join(HEADS), "head='scored'")
    if head not in HEADS:
        raise ConfigError(f"head {head!r}", ", ".join(HEADS), "head='scored'", closest(head, HEADS))
    return HEADS[head][0]()


_TEMPERATURES = np.exp(np.linspace(np.log(0.25), np.log(4.0), 129))


def best_temperature(logits: np.ndarray, label: np.ndarray) -> float:
    """By which logits f32[N] are divided so that their chances fit labels bool[N] best (least surprise)."""
    signed = np.where(label, 1.0, -1.0) * logits.astype(np.float64)
    surprise = [np.logaddexp(0.0, -signed / each).mean() for each in _TEMPERATURES]
    return float(_TEMPERATURES[int(np.argmin(surprise))])


_AT_ONCE = 32
"""Pairs that are prepared by one compiled call."""

# Heads are values: equal ones share what is compiled.
_prepare: Any = jax.jit(lambda head, examples: jax.vmap(head.prepare)(examples), static_argnums=0)


class PlacerTraining(FitRun):
    """A run that fits a placer's head; see `FitRun`. The checkpoint is in `placer/`.

    Args:
      head, config: what is fitted, and how.
      source: of the examples.
      folder, show: see `FitRun`.

    Raises:
      ConfigError: the folder holds a run with other settings.
    """

    kind = KIND
    unit = "pair"

    def __init__(
        self,
        head: Head,
        config: FitConfig,
        source: ExampleSource,
        folder: Path,
        show: Callable[[str], None] = print,
    ) -> None:
        self.head = head
        self.source = source
        recipe = {
            "head": head.kind,
            "data": source.record,
            # Runs of version 0.1.0, whose other heads had some, go on.
            "encoder_weights": "",
        }
        super().__init__(head, config, recipe, folder, show)

    def examples(self, split: Any) -> Any:
        examples = self.source.load(split)
        parts = []
        with Progress(f"preparing {split}", num_examples(examples), "pair") as progress:
            for part in in_parts(partial(_prepare, self.head), examples, _AT_ONCE):
                parts.append(part)
                progress.update(num_examples(part))
        return concatenate(parts)

    def save(self, state: FitState, held_out: Any) -> Path:
        temperature, found = self._calibrate(state.best, held_out)
        validation = {"calibration": None if found is None else asdict(found)}
        if found is not None:
            self._show(f"validation {found}")
            picture = self.folder / self.kind / "calibration.png"
            picture.parent.mkdir(parents=True, exist_ok=True)
            draw_calibration({"stands": found}, picture, "poses of the validation split")
        # Last: a folder with a record is a run that is done.
        return self.store(state, validation, temperature=temperature)

    def _calibrate(self, params: Any, held_out: Any) -> tuple[float, Calibration | None]:
        """The temperature of a head that tells chances, and how far they then hold."""
        scores = getattr(self.head, "scores", None)
        if scores is None:
            return 1.0, None
        score = jax.jit(scores)
        parts = [np.asarray(score(params, part)) for part in self.batches_of(held_out)]
        logits = np.concatenate(parts).ravel()
        stood = (held_out.verdict == int(Verdict.STABLE)).ravel()
        temperature = best_temperature(logits, stood)
        return temperature, calibration(logits / temperature, stood, held_out.is_on.ravel())
