"""Training of a segmenter: examples out of a folder of views, and a run that can be resumed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import numpy as np

from cluttergen_jax.assets import SupportAsset
from cluttergen_jax.downstream.fitting import FitConfig, FitRun, FitState
from cluttergen_jax.downstream.perception.segment.network import (
    HEIGHT,
    WIDTH,
    SegmentConfig,
    SegmentExample,
    SegmentLearner,
    shrink,
    shrink_label,
)
from cluttergen_jax.downstream.perception.segment.network_segmenter import KIND, answers_of
from cluttergen_jax.downstream.perception.types import intersection_over_union
from cluttergen_jax.downstream.perception.views.maker import VIEWS_A_SCENE, expose
from cluttergen_jax.downstream.perception.views.store import StoredView, ViewSet, read_views
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.progress import Progress
from cluttergen_jax.sensing import NOISE_OFF, REALSENSE, NoiseConfig, noisy
from cluttergen_jax.views import View

_TENTH = 10


@dataclass(frozen=True)
class ViewSource:
    """Where examples come from.

    Attributes:
      data: a folder that `perception data` made.
      seed: of exposure and noise.
      num_views: of the training split, the first so many; all if None.
    """

    data: Path
    seed: int = 0
    num_views: int | None = None

    @property
    def views(self) -> ViewSet:
        """The folder, opened."""
        return read_views(self.data)

    @property
    def record(self) -> dict[str, object]:
        """What decides the examples: JSON values."""
        views = self.views
        splits = [name for name in ("train", "val") if name in views.splits]
        digests = {name: views.digest(name) for name in splits}
        return {"views": digests, "seed": self.seed, "num_views": self.num_views}

    def load(self, split: str) -> SegmentExample:
        """All examples of `train` or `val`, NumPy arrays with a leading axis.

        Without a split `val`, every tenth view of the training split validates.

        Raises:
          ConfigError: there are none; BankError: the folder holds no views, or damaged ones.
        """
        views = self.views
        source = split if split in views.splits else "train"
        number = self.num_views if source == "train" else None
        has_val = "val" in views.splits
        total = number or int(views.split(source)["num_views"])
        found = []
        with Progress(f"reading {split}", total, "view") as progress:
            for stored in views.views(source, number):
                # All views of a scene are on one side.
                scene = stored.number // VIEWS_A_SCENE
                if has_val or (scene % _TENTH == _TENTH - 1) == (split == "val"):
                    found.append(example_of(stored, views, self.seed))
                progress.update()
        if not found:
            raise ConfigError(
                f"no views to {'learn from' if split == 'train' else 'validate with'} in {self.data}",
                "views of ten scenes or more",
                "cluttergen perception data --split train",
            )
        return jax.tree.map(lambda *leaves: np.stack(leaves), *found)


def example_of(stored: StoredView, views: ViewSet, seed: int) -> SegmentExample:
    """A view as a noisy camera sees it, to learn from."""
    seen = simulate_camera(stored, REALSENSE, seed)
    rgb, depth, height = shrink(seen.colours, seen.depth, heights(seen, views.support))
    center = np.zeros((len(views.names), 2), np.float32)
    camera = stored.view.camera
    if len(stored.objects):
        pixels = camera.project(stored.poses[:, :3])[0] * [
            WIDTH / camera.width,
            HEIGHT / camera.height,
        ]
        center[stored.objects] = np.clip(pixels, -WIDTH, 2 * WIDTH)
    return SegmentExample(rgb, depth, height, shrink_label(stored.view.label), center)


def simulate_camera(stored: StoredView, noise: NoiseConfig, seed: int) -> View:
    """What a camera of some exposure and noise makes of a stored view; with no noise the exposure stays, too.

    Depth is nan where nothing was measured; labels stay exact.
    """
    view = stored.view
    rng = np.random.default_rng((seed, stored.number, 7))
    if noise == NOISE_OFF:
        return view
    rgb = expose(view.colours, rng)
    depth, camera = noisy(view.depth, view.camera, noise, rng)
    return replace(view, rgb=rgb, depth=depth, camera=camera)


def heights(view: View, support: SupportAsset) -> np.ndarray:
    """f32[H, W]: metres over the table's top of what each pixel shows, nan where nothing was measured."""
    return (view.camera.points(view.depth)[..., 2] - support.top).astype(np.float32)


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

    kind = KIND
    unit = "view"

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
        return self.source.load(split)

    def save(self, state: FitState, held_out: SegmentExample) -> Path:
        params = jax.device_get(state.best)
        names = self.source.views.names
        labels = [
            answers_of(self.learner, params, batch)[0].argmax(-1)
            for batch in self.batches_of(held_out)
        ]
        iou = intersection_over_union(np.concatenate(labels), held_out.label, len(names))
        by_name = {name: float(value) for name, value in zip(names, iou[2:], strict=True)}
        folder = self.store(state, {"mean_iou": float(np.nanmean(iou)), "iou": by_name})
        self._show(f"validation mean IoU {np.nanmean(iou):.3f} of {len(held_out.label)} views")
        return folder
