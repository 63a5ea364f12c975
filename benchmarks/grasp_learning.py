"""A network of VGN's size on JAX: what it predicts of a volume, its loss, its examples, and how it is fitted.

Breyer et al., "Volumetric Grasping Network: Real-time 6 DOF Grasp Detection in Clutter" (CoRL 2020): three
convolutions down, three up, three heads, which tell of each of 40^3 voxels how good a grasp is there, how the
hand is turned, and how wide the object is. It is arranged for a CPU, and every rearrangement is exact:

- one pass of a volume serves all labelled grasps of its scene, and heads are computed at their voxels alone;
- a convolution is a matrix product over patches;
- a convolution of something enlarged (nearest neighbour) by 2 is one of 3^3 taps of the small volume, with
  eight times as many outputs; one with stride 2 is one of 3^3 taps of eight voxels folded into channels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax
from scipy.ndimage import distance_transform_edt
from scipy.stats import rankdata

from benchmarks.grasp_geometry import is_before_surface
from cluttergen_jax.downstream.fitting import FitConfig, FitRun, FitState, in_parts
from cluttergen_jax.downstream.robot.grasping.vgn import RESOLUTION
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.types import Array

_WIDTH_WEIGHT = 0.01
"""Of a squared error of the width, voxels, beside a turn's distance from 0 to 1."""
_HALF_TURN = np.array([0.0, 0.0, 0.0, 1.0])
"""About the approach, which is the tool's z: parallel jaws are the same afterwards."""
_HEADS = {"quality": 1, "turn": 4, "width": 1}
_IDLE, _IDLE_APART = 64, 2
"""Voxels of a scene in which nothing can be grasped, and how far they are from all labelled grasps."""
_HELD_OUT = 10
"""One scene in so many is not learnt from."""


@dataclass(frozen=True)
class NetworkSizes:
    """Channels and kernels of the convolutions.

    Attributes:
      encoder, decoder: channels. down, up: their kernels, odd and 5 at most. head: that of the heads.
    """

    encoder: tuple[int, ...] = (16, 32, 64)
    down: tuple[int, ...] = (5, 3, 3)
    decoder: tuple[int, ...] = (64, 32, 16)
    up: tuple[int, ...] = (3, 3, 5)
    head: int = 5


def _convolve(x: Array, kernel: Array) -> Array:
    """f[B, N, N, N, F] of f[B, N, N, N, C] and a kernel f[3, 3, 3, C, F], zeros around."""
    size = x.shape[1]
    padded = jnp.pad(x, [(0, 0), (1, 1), (1, 1), (1, 1), (0, 0)])
    shifted = [
        padded[:, i : i + size, j : j + size, k : k + size]
        for i in range(3)
        for j in range(3)
        for k in range(3)
    ]
    return jnp.concatenate(shifted, axis=-1) @ kernel.reshape(-1, kernel.shape[-1])


def _taps(kernel: int) -> np.ndarray:
    """f[2, 3, K]: 1 where tap k of a kernel about voxel 2 i + p lies in the pair of voxels i + c - 1."""
    parity, tap = np.meshgrid(np.arange(2), np.arange(kernel), indexing="ij")
    pair = (parity + tap - kernel // 2) // 2 + 1
    return (pair[:, None] == np.arange(3)[None, :, None]).astype(np.float32)


def _enlarged_kernel(kernel: Array) -> Array:
    """f[3, 3, 3, C, 8 F]: of the small volume what f[K, K, K, C, F] is of the one enlarged by 2."""
    taps = _taps(kernel.shape[0])
    made = jnp.einsum("pat,qbu,rcv,tuvxf->abcxpqrf", taps, taps, taps, kernel)
    return made.reshape(*made.shape[:4], -1)


def _strided_kernel(kernel: Array) -> Array:
    """f[3, 3, 3, 8 C, F]: of the folded volume what f[K, K, K, C, F] is with stride 2."""
    size = kernel.shape[0]
    # Pairs about the middle one hold voxels -2 to 3 from its first.
    wide = jnp.pad(kernel, [(2 - size // 2, 3 - size // 2)] * 3 + [(0, 0)] * 2)
    parts = wide.reshape(3, 2, 3, 2, 3, 2, *kernel.shape[3:])
    return parts.transpose(0, 2, 4, 1, 3, 5, 6, 7).reshape(3, 3, 3, -1, kernel.shape[-1])


def _fold(x: Array) -> Array:
    """f[B, N/2, N/2, N/2, 8 C]: each eight voxels as channels of one."""
    batch, size, channels = x.shape[0], x.shape[1] // 2, x.shape[-1]
    parts = x.reshape(batch, size, 2, size, 2, size, 2, channels)
    return parts.transpose(0, 1, 3, 5, 2, 4, 6, 7).reshape(batch, size, size, size, -1)


def _unfold(x: Array) -> Array:
    """f[B, 2 N, 2 N, 2 N, C] of f[B, N, N, N, 8 C]: the inverse of `_fold`."""
    batch, size, channels = x.shape[0], x.shape[1], x.shape[-1] // 8
    parts = x.reshape(batch, size, size, size, 2, 2, 2, channels)
    return parts.transpose(0, 1, 4, 2, 5, 3, 6, 7).reshape(batch, 2 * size, 2 * size, 2 * size, channels)


class GraspNetwork(nn.Module):
    """Volumes f[B, 40, 40, 40] to a grasp at each voxel, or at some: see `__call__`."""

    sizes: NetworkSizes

    @nn.compact
    def __call__(self, grid: Array, voxel: Array | None = None) -> dict[str, Array]:
        """What is predicted of grasps whose fingers' root is in a voxel.

        Args:
          grid: f[B, 40, 40, 40], of `vgn.tsdf_grid`, x first.
          voxel: i[B, L, 3], where; all if None.

        Returns:
          f[B, L] or f[B, 40, 40, 40], `quality`, the logit that it lifts something, and `width`, of what is
          held, in voxels; `turn`, the same with 4 at the end: T_task_tool's unit quaternion, wxyz.
        """
        sizes, x = self.sizes, grid[..., None].astype(jnp.float32)
        for index, (channels, size) in enumerate(zip(sizes.encoder, sizes.down, strict=True)):
            kernel, bias = self._weights(f"down{index}", size, x.shape[-1], channels)
            x = nn.relu(_convolve(_fold(x), _strided_kernel(kernel)) + bias)
        for index, (channels, size) in enumerate(zip(sizes.decoder, sizes.up, strict=True)):
            kernel, bias = self._weights(f"up{index}", size, x.shape[-1], channels)
            if index:
                x = nn.relu(_unfold(_convolve(x, _enlarged_kernel(kernel))) + bias)
            else:
                x = nn.relu(_convolve(x, kernel) + bias)
        heads = {name: self._weights(name, sizes.head, x.shape[-1], num) for name, num in _HEADS.items()}
        kernel = _enlarged_kernel(jnp.concatenate([each for each, _ in heads.values()], axis=-1))
        bias = jnp.concatenate([each for _, each in heads.values()])
        out = _unfold(_convolve(x, kernel)) if voxel is None else _at(x, kernel, voxel)
        quality, turn, width = jnp.split(out + bias, [1, 5], axis=-1)
        length = jnp.sqrt((turn**2).sum(-1, keepdims=True) + 1e-12)
        return {"quality": quality[..., 0], "turn": turn / length, "width": width[..., 0]}

    def _weights(self, name: str, size: int, channels: int, outputs: int) -> tuple[Array, Array]:
        shape = (size, size, size, channels, outputs)
        kernel = self.param(f"{name}_kernel", nn.initializers.he_normal(), shape)
        return kernel, self.param(f"{name}_bias", nn.initializers.zeros, (outputs,))


def _at(x: Array, kernel: Array, voxel: Array) -> Array:
    """f[B, L, F]: the convolution of x f[B, N, N, N, C] enlarged by 2, at voxels i[B, L, 3] alone."""
    padded = jnp.pad(x, [(0, 0), (1, 1), (1, 1), (1, 1), (0, 0)])
    around = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), -1).reshape(27, 3)
    cells = (voxel // 2)[:, :, None] + around
    row = jnp.arange(x.shape[0])[:, None, None]
    patches = padded[row, cells[..., 0], cells[..., 1], cells[..., 2]]
    made = patches.reshape(*voxel.shape[:2], -1) @ kernel.reshape(-1, kernel.shape[-1])
    which = ((voxel % 2) * jnp.array([4, 2, 1])).sum(-1)
    parts = made.reshape(*voxel.shape[:2], 8, -1)
    return jnp.take_along_axis(parts, which[..., None, None], axis=2)[:, :, 0]


def multiply(a: Array, b: Array) -> Array:
    """f[..., 4]: the product of quaternions, wxyz."""
    w, x, y, z = (a[..., index] for index in range(4))
    s, i, j, k = (b[..., index] for index in range(4))
    rows = (
        w * s - x * i - y * j - z * k,
        w * i + x * s + y * k - z * j,
        w * j - x * k + y * s + z * i,
        w * k + x * j - y * i + z * s,
    )
    return jnp.stack(rows, axis=-1)


def turn_scene(scene: Mapping[str, Array], quarters: Array) -> dict[str, Array]:
    """One scene's example turned about the vertical through the cube's middle by quarters, 0 to 3.

    Grid, voxels and quaternions are turned together; see `read_examples` for what they are.
    """
    grids = jnp.stack([jnp.rot90(scene["grid"], each, axes=(0, 1)) for each in range(4)])
    i, j, k = (scene["voxel"][:, axis] for axis in range(3))
    last = RESOLUTION - 1
    voxels = jnp.stack(
        [
            jnp.stack(each, -1)
            for each in ((i, j, k), (last - j, i, k), (last - i, last - j, k), (j, last - i, k))
        ]
    )
    half = quarters * np.pi / 4
    about_z = jnp.stack([jnp.cos(half), jnp.zeros(()), jnp.zeros(()), jnp.sin(half)])
    turned = multiply(jnp.broadcast_to(about_z, scene["turn"].shape), scene["turn"])
    return {**scene, "grid": grids[quarters], "voxel": voxels[quarters], "turn": turned}


@dataclass(frozen=True)
class GraspLearner:
    """The network and what it learns from scenes (`Learner`).

    Attributes:
      config: sizes of the network.
    """

    config: NetworkSizes = NetworkSizes()

    def init(self, key: Array) -> Any:
        """Fresh weights."""
        return GraspNetwork(self.config).init(key, jnp.zeros((1, *[RESOLUTION] * 3)))

    def predict(self, params: Any, grid: Array) -> dict[str, Array]:
        """Grasps at all voxels of one volume f[40, 40, 40]: `quality` from 0 to 1, `turn` and `width`."""
        found: Any = GraspNetwork(self.config).apply(params, grid[None])
        return {
            **{name: value[0] for name, value in found.items()},
            "quality": jax.nn.sigmoid(found["quality"][0]),
        }

    def logits(self, params: Any, examples: Mapping[str, Array]) -> Array:
        """f[B, L]: of the quality of the labelled grasps, as they lie."""
        found: Any = GraspNetwork(self.config).apply(params, examples["grid"], examples["voxel"])
        return found["quality"]

    def loss(self, params: Any, examples: Mapping[str, Array], key: Array) -> tuple[Array, dict[str, Array]]:
        """Over the labelled grasps of scenes that are turned by chance; its parts by name."""
        quarters = jax.random.randint(key, examples["label"].shape[:1], 0, 4)
        scenes = jax.vmap(turn_scene)(dict(examples), quarters)
        found: Any = GraspNetwork(self.config).apply(params, scenes["grid"], scenes["voxel"])
        label, weight = scenes["label"], scenes["weight"]
        number = jnp.maximum((weight > 0).sum(), 1)
        other = multiply(scenes["turn"], jnp.asarray(_HALF_TURN, jnp.float32))
        alike = [jnp.abs((found["turn"] * each).sum(-1)) for each in (scenes["turn"], other)]
        parts = {
            "quality": optax.sigmoid_binary_cross_entropy(found["quality"], label),
            "turn": label * (1 - jnp.maximum(*alike)),
            "width": label * _WIDTH_WEIGHT * (found["width"] - scenes["width"]) ** 2,
        }
        means = {name: (weight * each).sum() / number for name, each in parts.items()}
        return sum(means.values(), start=jnp.float32(0)), means


def read_examples(folders: Sequence[Path]) -> dict[str, np.ndarray]:
    """The scenes of datasets of `cluttergen robot dataset`, S of them, with L labelled grasps at most.

    Candidates of a dataset are antipodal, so that a network that learnt from them alone would find good
    grasps where there is nothing to grasp. Behind them come voxels before a surface, drawn by chance, that
    are more than two voxels from every candidate: bad grasps, `_IDLE` of a scene.

    Returns:
      grid: f16[S, 40, 40, 40]. voxel: i16[S, L, 3], in which the fingers' root is. turn: f32[S, L, 4],
      T_task_tool's quaternion, wxyz. width: f32[S, L], voxels. label: f32[S, L], 1 where something was
      lifted. weight: f32[S, L], with which good and bad grasps count the same in all; 0 behind the last one.
      is_idle: bool[S, L], of a voxel without a candidate.

    Raises:
      ConfigError: a folder holds no such dataset, or none of its grasps lifts something, or all do.
    """
    scenes = [each for folder in folders for each in _scenes_of(folder)]
    labels = np.concatenate([rows[:, 9] for _, rows in scenes]) if scenes else np.zeros(0)
    num, good = len(labels), int(labels.sum())
    if not 0 < good < num:
        raise ConfigError(
            f"{num} labelled grasps, {good} of which lift something", "some that do and some that do not"
        )
    most = max(len(rows) for _, rows in scenes) + _IDLE
    bad = num - good + _IDLE * len(scenes)
    made: dict[str, np.ndarray] = {
        "grid": np.zeros((len(scenes), *[RESOLUTION] * 3), np.float16),
        "voxel": np.zeros((len(scenes), most, 3), np.int16),
        "turn": np.tile(np.array([1, 0, 0, 0], np.float32), (len(scenes), most, 1)),
        "width": np.zeros((len(scenes), most), np.float32),
        "label": np.zeros((len(scenes), most), np.float32),
        "weight": np.zeros((len(scenes), most), np.float32),
        "is_idle": np.zeros((len(scenes), most), bool),
    }
    for index, (path, rows) in enumerate(scenes):
        with np.load(path, allow_pickle=False) as file:
            made["grid"][index] = file["grid"][0]
        here = (index, slice(len(rows)))
        made["voxel"][here] = np.clip(np.floor(rows[:, 5:8]), 0, RESOLUTION - 1)
        made["turn"][here] = rows[:, [4, 1, 2, 3]]
        made["width"][here], made["label"][here] = rows[:, 8], rows[:, 9]
        made["weight"][here] = np.where(rows[:, 9] > 0, (good + bad) / (2 * good), (good + bad) / (2 * bad))
        idle = _idle_voxels(made["grid"][index], made["voxel"][here], np.random.default_rng(index))
        behind = (index, slice(len(rows), len(rows) + len(idle)))
        made["voxel"][behind], made["is_idle"][behind] = idle, True
        made["weight"][behind] = (good + bad) / (2 * bad)
    return made


def _idle_voxels(grid: np.ndarray, taken: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """i[E, 3], `_IDLE` at most: voxels of a volume before a surface and away from those i[L, 3] of grasps."""
    is_far = np.ones(grid.shape, bool)
    is_far[tuple(taken.astype(int).T)] = False
    found = np.argwhere(is_before_surface(grid) & (distance_transform_edt(is_far) > _IDLE_APART))
    return rng.permutation(found)[:_IDLE]


def _scenes_of(folder: Path) -> list[tuple[Path, np.ndarray]]:
    """Each scene's volume and rows of `grasps.csv` of a dataset."""
    place = folder / "voxels"
    if not (place / "grasps.csv").is_file():
        raise ConfigError(f"{folder}", "a finished dataset of `cluttergen robot dataset`")
    rows = np.loadtxt(place / "grasps.csv", delimiter=",", skiprows=1, ndmin=2)
    numbers = rows[:, 0].astype(int)
    return [(place / f"scenes/{each:06d}.npz", rows[numbers == each]) for each in np.unique(numbers)]


def split_of(scenes: Mapping[str, np.ndarray], split: str) -> dict[str, np.ndarray]:
    """The scenes of `train` or `val`."""
    number = len(scenes["label"])
    every = min(_HELD_OUT, number)
    is_held_out = np.arange(number) % every == every - 1
    return {name: each[is_held_out == (split == "val")] for name, each in scenes.items()}


def area_under_curve(score: np.ndarray, is_good: np.ndarray) -> float:
    """How often a good one of scores f[N] is above a bad one; NaN where there are none of either."""
    good, bad = int(is_good.sum()), int((~is_good).sum())
    if not good or not bad:
        return float("nan")
    return float((rankdata(score)[is_good].sum() - good * (good + 1) / 2) / (good * bad))


class GraspTraining(FitRun):
    """A run that fits the network; see `FitRun`.

    Args:
      scenes: of `read_examples`; one in ten is held out. data: what tells them from others.
      learner, config, folder: see `FitRun`.
    """

    kind: ClassVar[str] = "grasps"
    unit: ClassVar[str] = "scene"

    def __init__(
        self,
        learner: GraspLearner,
        config: FitConfig,
        scenes: Mapping[str, np.ndarray],
        data: Sequence[str],
        folder: Path,
    ) -> None:
        self._scenes = scenes
        super().__init__(learner, config, {"data": list(data)}, folder)

    def examples(self, split: str) -> Any:
        """Of `train` or `val`."""
        return split_of(self._scenes, split)

    def save(self, state: FitState, held_out: Any) -> Path:
        """With how well grasps of the scenes held out are told apart."""
        return self.store(state, judge_labels(self.learner, state.best, held_out, self.config.batch_size))


def judge_labels(learner: Any, params: Any, examples: Any, batch_size: int) -> dict[str, float]:
    """Of labelled grasps `accuracy` (at one half), that of both labels alike, and `area` under the curve."""
    call = jax.jit(lambda part: learner.logits(params, part))
    logits = np.concatenate(list(in_parts(call, examples, batch_size)))
    is_known = (examples["weight"] > 0) & ~examples["is_idle"]
    told, is_good = logits[is_known], examples["label"][is_known] > 0
    is_right = (told > 0) == is_good
    shares = [float(is_right[which].mean()) for which in (is_good, ~is_good) if which.any()]
    return {
        "grasps": float(len(told)),
        "good": float(is_good.mean()),
        "accuracy": float(is_right.mean()),
        "balanced_accuracy": float(np.mean(shares)),
        "area": area_under_curve(told, is_good),
    }
