"""Training of a segmenter: examples out of a folder of views, and a run that can be resumed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from cluttergen_jax.assets import SupportAsset
from cluttergen_jax.downstream.fitting import FitConfig, FitRun, FitState
from cluttergen_jax.downstream.noise import REALSENSE
from cluttergen_jax.downstream.perception.segmenter import (
    HEIGHT,
    KIND,
    VOTE_SCALE,
    WIDTH,
    SegmentConfig,
    SegmentModel,
    network_answers,
    network_images,
    pixel_places,
    sample_pixels,
    shrink,
)
from cluttergen_jax.downstream.perception.types import BACKGROUND, FIRST_OBJECT
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.progress import Progress
from cluttergen_jax.sensing import View
from cluttergen_jax.types import Array
from studies.perception.scoring import intersection_over_union
from studies.perception.view_maker import VIEWS_A_SCENE
from studies.perception.view_store import StoredView, ViewSet, read_views, simulate_camera

_OBJECT_WEIGHT = 3.0
_VOTE_WEIGHT = 0.3


class SegmentExample(struct.PyTreeNode):
    """One view to learn from, at the network's size.

    Attributes:
      rgb: u8[H, W, 3]. depth, height: f16[H, W], metres, the latter over the table; `NO_DEPTH` where none.
      label: u8[H, W], see `types`.
      center: f32[K, 2], pixels right and down, where the objects' middles are seen.
    """

    rgb: Array
    depth: Array
    height: Array
    label: Array
    center: Array


@dataclass(frozen=True)
class SegmentLearner(SegmentModel):
    """Learns classes by cross-entropy, pixels of objects weighing more, and votes by their distance."""

    def loss(
        self, params: Any, examples: SegmentExample, key: Array
    ) -> tuple[Array, dict[str, Array]]:
        """See `fitting.Learner`; as coins fall views are mirrored, and their backgrounds recoloured."""
        number = len(examples.label)
        flip_key, colour_key = jax.random.split(key)
        examples = jax.vmap(_mirror)(examples, jax.random.bernoulli(flip_key, shape=(number, 2)))
        examples = jax.vmap(_recolour)(examples, jax.random.split(colour_key, number))
        images = network_images(examples.rgb, examples.depth, examples.height)
        logits, votes = self.apply(params, images)
        label = examples.label.astype(jnp.int32)
        is_object = label >= FIRST_OBJECT
        weight = jnp.where(is_object, _OBJECT_WEIGHT, 1.0)
        each = optax.softmax_cross_entropy_with_integer_labels(logits, label)
        classes = (each * weight).sum() / weight.sum()
        target = jax.vmap(lambda center, label: center[jnp.maximum(label - FIRST_OBJECT, 0)])(
            examples.center, label
        )
        error = optax.huber_loss(votes, (target - pixel_places()) / VOTE_SCALE).sum(-1)
        vote = (error * is_object).sum() / jnp.maximum(is_object.sum(), 1)
        return classes + _VOTE_WEIGHT * vote, {"classes": classes, "votes": vote}


def _mirror(example: SegmentExample, flips: Array) -> SegmentExample:
    """One example mirrored along its rows and its columns where bool[2] says so."""

    def flip(image: Array) -> Array:
        for axis in (0, 1):
            image = jnp.where(flips[axis], jnp.flip(image, axis), image)
        return image

    size = jnp.array([WIDTH, HEIGHT], jnp.float32)
    center = jnp.where(flips[::-1], size - example.center, example.center)
    images = {name: flip(getattr(example, name)) for name in ("rgb", "depth", "height", "label")}
    return example.replace(center=center, **images)


def _recolour(example: SegmentExample, key: Array) -> SegmentExample:
    """One example; by half of the keys its background has another colour and contrast, its pattern stays."""
    coin_key, colour_key, contrast_key = jax.random.split(key, 3)
    light = example.rgb / 255.0
    is_back = (example.label == BACKGROUND)[..., None]
    mean = (light * is_back).sum((0, 1)) / jnp.maximum(is_back.sum(), 1)
    colour = jax.random.uniform(colour_key, (3,), minval=0.1, maxval=0.9)
    contrast = jax.random.uniform(contrast_key, (3,), minval=0.5, maxval=1.5)
    other = jnp.clip(colour + contrast * (light - mean), 0, 1)
    is_other = is_back & jax.random.bernoulli(coin_key)
    return example.replace(rgb=255 * jnp.where(is_other, other, light))


def shrink_label(label: np.ndarray) -> np.ndarray:
    """u8[120, 160]: labels of any size, each pixel that whose depth the network reads."""
    return label[np.ix_(*sample_pixels(label.shape))]


_TENTH = 10


@dataclass(frozen=True)
class ViewSource:
    """Where examples come from.

    Attributes:
      data: a folder that `data` made.
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
                "python -m studies.perception data --split train",
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
            np.asarray(
                network_answers(self.learner, params, batch.rgb, batch.depth, batch.height)[0]
            ).argmax(-1)
            for batch in self.batches_of(held_out)
        ]
        iou = intersection_over_union(np.concatenate(labels), held_out.label, len(names))
        by_name = {name: float(value) for name, value in zip(names, iou[2:], strict=True)}
        folder = self.store(state, {"mean_iou": float(np.nanmean(iou)), "iou": by_name})
        self._show(f"validation mean IoU {np.nanmean(iou):.3f} of {len(held_out.label)} views")
        return folder
