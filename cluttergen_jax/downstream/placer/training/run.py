"""Training of a placer's head: examples made once, gradient steps, calibration, a checkpoint."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np

from cluttergen_jax.downstream.fitting.fit import FitConfig, FitState, num_examples, taken
from cluttergen_jax.downstream.fitting.run import FitRun
from cluttergen_jax.downstream.placer.heads.head import Head
from cluttergen_jax.downstream.placer.heads.trained import KIND
from cluttergen_jax.downstream.placer.training.examples import ExampleSource
from cluttergen_jax.downstream.placer.training.temperature import best_temperature
from cluttergen_jax.learning.ppo import checkpoint
from cluttergen_jax.learning.training.stability import Calibration, calibration, draw_calibration
from cluttergen_jax.progress import Progress
from cluttergen_jax.types import Verdict

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

    kind, unit = KIND, "pair"

    def __init__(
        self,
        head: Head,
        config: FitConfig,
        source: ExampleSource,
        folder: Path,
        show: Callable[[str], None] = print,
    ) -> None:
        self.head, self.source = head, source
        recipe = {
            "head": head.kind,
            "data": source.record,
            "encoder_weights": str(getattr(head, "encoder_weights", None) or ""),
        }
        super().__init__(head, config, recipe, folder, show)

    def examples(self, split: Any) -> Any:
        """See `FitRun`."""
        examples = self.source.load(split)
        number, parts = num_examples(examples), []
        with Progress(f"preparing {split}", number, "pair") as progress:
            for first in range(0, number, _AT_ONCE):
                # The last call is filled up with its last pair, so that one program serves all.
                index = np.minimum(np.arange(first, first + _AT_ONCE), number - 1)
                made = jax.device_get(_prepare(self.head, taken(examples, index)))
                count = min(_AT_ONCE, number - first)
                parts.append(jax.tree.map(lambda leaf, n=count: leaf[:n], made))
                progress.update(count)
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)

    def save(self, state: FitState, held_out: Any) -> Path:
        """See `FitRun`."""
        folder = self.folder / self.kind
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
        parts = [np.asarray(score(params, part)) for part in self.batches_of(held_out)]
        logits = np.concatenate(parts).ravel()
        stood = (held_out.verdict == int(Verdict.STABLE)).ravel()
        temperature = best_temperature(logits, stood)
        return temperature, calibration(logits / temperature, stood, held_out.is_on.ravel())
