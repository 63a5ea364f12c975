"""A network that says of grasps found in a volume which of them lift something, and how it is fitted.

Candidates are antipodal ones, drawn in the volume whether the hand is clear or not, as GPD draws its own in a
cloud (ten Pas et al., "Grasp Pose Detection in Point Clouds", IJRR 2017). The network sees the volume about
each of them in the tool's frame: roughly around the hand and on its way, finely between the fingers. So it
need not learn what a turned grasp looks like, every labelled grasp of `robot dataset` is one example, and
what blocks a hand and what it cannot hold are learnt from the same labels. It has 273,000 weights, VGN's
(Breyer et al., CoRL 2020) 313,000.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax
from scipy.spatial.transform import Rotation
from scipy.stats import rankdata

from cluttergen_jax.downstream.fitting import (
    FitConfig,
    FitRun,
    FitState,
    concatenate,
    in_parts,
    take,
)
from cluttergen_jax.downstream.robot.grasping.clutter import FINGER_DEPTH
from cluttergen_jax.downstream.robot.grasping.vgn import DEPTH
from cluttergen_jax.downstream.transforms import rigid, shift_along
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.progress import Progress
from cluttergen_jax.types import Array
from studies.benchmarks.grasp_geometry import (
    BAND,
    VOXEL,
    VolumeGrasps,
    distance_field,
    free_room,
    join_grasps,
    sample_field,
)

_CROPS = {
    "wide": (
        np.linspace(-0.036, 0.036, 7),
        np.linspace(-0.11, 0.11, 19),
        np.linspace(-0.11, 0.022, 12),
    ),
    "fine": (
        np.linspace(-0.018, 0.018, 7),
        np.linspace(-0.048, 0.048, 17),
        np.linspace(-0.024, 0.024, 9),
    ),
}
"""Metres along the tool's x, y (in which the fingers close) and z (the approach)."""
# Metres that are 1 for the network.
_WIDTH = 0.08
_HEIGHT = 0.1

_FOUND = 4.0
"""How much more than others a grasp counts that was found in a volume: the network chooses among those."""
_HELD_OUT = 10
"""One scene in so many is not learnt from."""


def network_inputs(grid: np.ndarray, grasps: VolumeGrasps) -> dict[str, np.ndarray]:
    """What the network sees of C grasps in a volume f[N, N, N].

    Returns:
      wide, fine: f16[C, X, Y, Z, 2], the distance along rays and the free room about the tool, in units of
      `BAND`. numbers: f32[C, 3], the width, the height over the table, and how far down the approach points.
    """
    pose = grasps.pose
    fields = (distance_field(grid), free_room(grid))
    seen = {}
    for name, steps in _CROPS.items():
        offsets = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1)
        points = (
            np.einsum("cij,xyzj->cxyzi", pose[:, :3, :3], offsets)
            + pose[:, None, None, None, :3, 3]
        )
        values = np.stack([sample_field(each, points) for each in fields], axis=-1)
        seen[name] = np.clip(values / BAND, -1, 1).astype(np.float16)
    numbers = (grasps.width / _WIDTH, (pose[:, 2, 3] - DEPTH) / _HEIGHT, -pose[:, 2, 2])
    return {**seen, "numbers": np.stack(numbers, axis=-1).astype(np.float32)}


@dataclass(frozen=True)
class ScorerSizes:
    """Of the network.

    Attributes:
      channels: of the convolutions of each crop. units: of the layers behind them.
    """

    channels: tuple[int, ...] = (16, 32)
    units: int = 96


def convolve_by_two(x: Array, dense: Callable[[Array], Array]) -> Array:
    """f[C, X/2, Y/2, Z/2, F]: a convolution of f[C, X, Y, Z, K] with stride 2 and kernel 4, zeros around.

    Eight voxels are folded into channels of one, so that eight shifts and a matrix product are all of it.
    """
    sizes = [-(-size // 2) + 1 for size in x.shape[1:4]]
    pads = [(1, 2 * half - size - 1) for half, size in zip(sizes, x.shape[1:4], strict=True)]
    x = jnp.pad(x, [(0, 0), *pads, (0, 0)])
    a, b, c = sizes
    x = (
        x.reshape(len(x), a, 2, b, 2, c, 2, -1)
        .transpose(0, 1, 3, 5, 2, 4, 6, 7)
        .reshape(len(x), a, b, c, -1)
    )
    shifted = [
        x[:, i : a - 1 + i, j : b - 1 + j, k : c - 1 + k]
        for i in (0, 1)
        for j in (0, 1)
        for k in (0, 1)
    ]
    return dense(jnp.concatenate(shifted, axis=-1))


class GraspScorer(nn.Module):
    """What is seen of C grasps (`network_inputs`) to f[C], the logit that each lifts something."""

    sizes: ScorerSizes

    @nn.compact
    def __call__(self, seen: Mapping[str, Array]) -> Array:
        """See class."""
        parts = [seen["numbers"]]
        for name in _CROPS:
            x = seen[name].astype(jnp.float32)
            for channels in self.sizes.channels:
                x = nn.relu(convolve_by_two(x, nn.Dense(channels)))
            parts.append(nn.relu(nn.Dense(self.sizes.units)(x.reshape(len(x), -1))))
        x = nn.relu(nn.Dense(self.sizes.units)(jnp.concatenate(parts, axis=-1)))
        return nn.Dense(1)(x)[:, 0]


@dataclass(frozen=True)
class GraspLearner:
    """The network and what it learns from labelled grasps (`Learner`).

    Attributes:
      config: sizes of the network.
    """

    config: ScorerSizes = ScorerSizes()

    def init(self, key: Array) -> Any:
        """Fresh weights."""
        blank = {name: jnp.zeros((1, *map(len, steps), 2)) for name, steps in _CROPS.items()}
        return GraspScorer(self.config).init(key, {**blank, "numbers": jnp.zeros((1, 3))})

    def logits(self, params: Any, seen: Mapping[str, Array]) -> Array:
        """f[C]: that grasps lift something."""
        found: Array = GraspScorer(self.config).apply(params, seen)
        return found

    def loss(
        self, params: Any, examples: Mapping[str, Array], key: Array
    ) -> tuple[Array, dict[str, Array]]:
        """Of grasps that are mirrored by chance: the hand is the same from both sides, both ways."""
        seen = dict(examples)
        mirrored = jax.random.bernoulli(key, shape=(2, len(examples["label"]), 1, 1, 1, 1))
        for name in _CROPS:
            for axis in (0, 1):
                seen[name] = jnp.where(mirrored[axis], jnp.flip(seen[name], axis + 1), seen[name])
        each = optax.sigmoid_binary_cross_entropy(self.logits(params, seen), examples["label"])
        return (examples["weight"] * each).sum() / examples["weight"].sum(), {}


def read_examples(folders: Sequence[Path], labels: Sequence[Path] = ()) -> dict[str, np.ndarray]:
    """The labelled grasps of datasets of `cluttergen robot dataset`, G of them.

    Args:
      labels: for each of the datasets a folder of `label_volumes`.

    Returns:
      What `network_inputs` makes of each; label: f32[G], 1 where something was lifted; weight: f32[G] in the
      loss; scene: i32[G].

    Raises:
      ConfigError: a folder holds no such dataset, or none of its grasps lifts something, or all do.
    """
    scenes = [
        each for row, folder in enumerate(folders) for each in _scenes_of(folder, labels[row:][:1])
    ]
    made = []
    with Progress("reading", len(scenes), "scene") as progress:
        for index, (path, grasps, num_drawn) in enumerate(scenes):
            with np.load(path, allow_pickle=False) as file:
                seen = network_inputs(file["grid"][0], grasps)
            label = grasps.score.astype(np.float32)
            scene = np.full(len(grasps.score), index, np.int32)
            weight = np.where(np.arange(len(label)) < num_drawn, 1, _FOUND).astype(np.float32)
            made.append({**seen, "label": label, "weight": weight, "scene": scene})
            progress.update(1)
    found = np.concatenate([each["label"] for each in made]) if made else np.zeros(0)
    if not 0 < found.sum() < len(found):
        raise ConfigError(
            f"{len(found)} labelled grasps, {int(found.sum())} of which lift something",
            "some that do and some that do not",
        )
    whole: dict[str, np.ndarray] = concatenate(made)
    return whole


def _scenes_of(folder: Path, labels: Sequence[Path]) -> Iterator[tuple[Path, VolumeGrasps, int]]:
    """The file of each scene's volume, its grasps, whose score is the label, and how many were not found."""
    place = folder / "voxels"
    if not (place / "grasps.csv").is_file():
        raise ConfigError(f"{folder}", "a finished dataset of `cluttergen robot dataset`")
    rows = np.loadtxt(place / "grasps.csv", delimiter=",", skiprows=1, ndmin=2)
    for number in np.unique(rows[:, 0]).astype(int):
        path = place / f"scenes/{number:06d}.npz"
        here = rows[rows[:, 0] == number]
        root = rigid(Rotation.from_quat(here[:, 1:5]).as_matrix(), here[:, 5:8] * VOXEL)
        pose = shift_along(root, (0.0, 0.0, FINGER_DEPTH))
        parts = [VolumeGrasps(pose, here[:, 8] * VOXEL, here[:, 9])]
        for file in (each / path.name for each in labels):
            if file.is_file():
                with np.load(file, allow_pickle=False) as more:
                    parts.append(VolumeGrasps(more["pose"], more["width"], more["label"]))
        yield path, join_grasps(parts), len(here)


def split_of(grasps: Mapping[str, np.ndarray], split: str) -> dict[str, np.ndarray]:
    """Those of the scenes of `train` or `val`, without `scene`."""
    scene = grasps["scene"]
    every = min(_HELD_OUT, int(scene.max()) + 1)
    is_chosen = (scene % every == every - 1) == (split == "val")
    found: dict[str, np.ndarray] = take(
        {k: v for k, v in grasps.items() if k != "scene"}, is_chosen
    )
    return found


def area_under_curve(score: np.ndarray, is_good: np.ndarray) -> float:
    """How often a good one of scores f[N] is above a bad one; NaN where there are none of either."""
    good = int(is_good.sum())
    bad = int((~is_good).sum())
    if not good or not bad:
        return float("nan")
    return float((rankdata(score)[is_good].sum() - good * (good + 1) / 2) / (good * bad))


class GraspTraining(FitRun):
    """A run that fits the network; see `FitRun`.

    Args:
      read: makes what `read_examples` does; one scene in ten is held out. data: what tells it from others.
      learner, config, folder: see `FitRun`.
    """

    kind: ClassVar[str] = "grasps"
    unit: ClassVar[str] = "grasp"

    def __init__(
        self,
        learner: GraspLearner,
        config: FitConfig,
        read: Callable[[], dict[str, np.ndarray]],
        data: Sequence[str],
        folder: Path,
    ) -> None:
        self._read = read
        super().__init__(learner, config, {"data": list(data)}, folder)

    @cached_property
    def _grasps(self) -> dict[str, np.ndarray]:
        return self._read()

    def examples(self, split: str) -> Any:
        """Of `train` or `val`."""
        return split_of(self._grasps, split)

    def save(self, state: FitState, held_out: Any) -> Path:
        """With how well grasps of the scenes held out are told apart."""
        return self.store(
            state, judge_labels(self.learner, state.best, held_out, self.config.batch_size)
        )


def judge_labels(learner: Any, params: Any, examples: Any, batch_size: int) -> dict[str, float]:
    """Of grasps found in volumes, and of others: `accuracy` at one half and `area` under the curve."""
    call = jax.jit(lambda part: learner.logits(params, part))
    told = np.concatenate(list(in_parts(call, examples, batch_size)))
    told_of = {}
    is_good = examples["label"] > 0
    is_found = examples["weight"] > 1
    for name, which in (("found", is_found), ("drawn", ~is_found)):
        if which.any():
            told_of[f"{name}_grasps"] = float(which.sum())
            told_of[f"{name}_good"] = float(is_good[which].mean())
            told_of[f"{name}_accuracy"] = float(((told > 0) == is_good)[which].mean())
            told_of[f"{name}_area"] = area_under_curve(told[which], is_good[which])
    return told_of
