"""Training of a segmenter: a run that can be resumed, and a checkpoint of half precision with its record."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import jax
import numpy as np

from cluttergen_jax.downstream.fitting.fit import FitConfig, FitState
from cluttergen_jax.downstream.fitting.run import FitRun
from cluttergen_jax.downstream.perception.segment.examples import ViewSource
from cluttergen_jax.downstream.perception.segment.network import SegmentConfig, SegmentExample, SegmentLearner
from cluttergen_jax.downstream.perception.segment.scores import intersection_over_union
from cluttergen_jax.downstream.perception.segment.trained import KIND, answers_of
from cluttergen_jax.learning.ppo import checkpoint

FIT = FitConfig(num_epochs=9, batch_size=8, learning_rate=3e-3)
"""Of the full setting, 6,000 views."""


class SegmenterTraining(FitRun):
    """A run that fits a segmentation network; see `FitRun`. The checkpoint is in `segmenter/`.

    Args:
      network: sizes. config: how it is fitted. source: of the examples.
      folder, show: see `FitRun`.

    Raises:
      ConfigError: the folder holds a run with other settings.
    """

    kind, unit = KIND, "view"

    def __init__(
        self,
        network: SegmentConfig,
        config: FitConfig,
        source: ViewSource,
        folder: Path,
        show: Callable[[str], None] = print,
    ) -> None:
        self.source = source
        views = source.views
        recipe = {"data": source.record, "names": list(views.names), "top": views.support.top}
        super().__init__(SegmentLearner(network), config, recipe, folder, show)

    def examples(self, split: str) -> SegmentExample:
        """See `FitRun`."""
        return self.source.load(split)

    def save(self, state: FitState, held_out: SegmentExample) -> Path:
        """See `FitRun`."""
        folder = self.folder / self.kind
        params = jax.device_get(state.best)
        labels = [
            answers_of(self.learner, params, batch)[0].argmax(-1) for batch in self.batches_of(held_out)
        ]
        names = self.recipe["names"]
        iou = intersection_over_union(np.concatenate(labels), held_out.label, len(names))
        record = {
            "kind": KIND,
            **self.recipe,
            "validation": {
                "loss": float(state.best_loss),
                "mean_iou": float(np.nanmean(iou)),
                "iou": {name: float(value) for name, value in zip(names, iou[2:], strict=True)},
            },
            "versions": {name: version(name) for name in ("cluttergen_jax", "mujoco", "jax", "flax")},
        }
        checkpoint.save_policy(folder, params, record)
        self._show(f"validation mean IoU {np.nanmean(iou):.3f} of {len(held_out.label)} views")
        return folder
