"""The trained segmenter: a network's coarse answers, made masks by what depth tells of edges.

The network is a small U-Net on colour, depth and height, with a vote for objects' centres.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, median_filter
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from cluttergen_jax.downstream.fitting import blank_params, config_of, embedded_checkpoints
from cluttergen_jax.downstream.perception.types import (
    BACKGROUND,
    FIRST_OBJECT,
    Segmentation,
    check_images,
    num_classes,
)
from cluttergen_jax.errors import PoolError
from cluttergen_jax.geometry import Array
from cluttergen_jax.learning import read_policy, read_record
from cluttergen_jax.sensing import Camera

# Pixels of what the network reads and answers.
WIDTH = 160
HEIGHT = 120

NO_DEPTH = -8.0
"""In place of metres where nothing was measured."""
_COLOUR = 3
_GROUPS = 8
VOTE_SCALE = 20.0
"""Pixels; votes are told in these."""
_DEPTH_MIDDLE = 0.8
_DEPTH_SCALE = 0.4
_HEIGHT_SCALE = 0.1


@dataclass(frozen=True)
class SegmentConfig:
    """Sizes of the network.

    Attributes:
      num_objects: K, that it knows.
      widths: channels at a half, a quarter, an eighth and a sixteenth of the picture.
      colour: read colours too; False for depth alone.
    """

    num_objects: int
    widths: tuple[int, int, int, int] = (24, 48, 80, 96)
    colour: bool = True


class Block(nn.Module):
    """Two convolutions of 3 x 3, each normalised over groups of channels."""

    width: int

    @nn.compact
    def __call__(self, x: Array) -> Array:
        for _ in range(2):
            x = nn.Conv(self.width, (3, 3), use_bias=False)(x)
            x = nn.relu(nn.GroupNorm(num_groups=_GROUPS)(x))
        return x


class SegmentNet(nn.Module):
    """A U-Net; its first and last layers work on squares of 2 x 2 pixels."""

    config: SegmentConfig

    @nn.compact
    def __call__(self, images: Array) -> tuple[Array, Array]:
        """Logits f32[B, H, W, C] of the classes; votes f32[B, H, W, 2], in `VOTE_SCALE`, right and down.

        Args:
          images: f32[B, H, W, 5], as `network_images` makes them.
        """
        first, *deeper = self.config.widths
        x = _space_to_depth(images if self.config.colour else images[..., _COLOUR:])
        skips = [x := Block(first)(x)]
        for width in deeper:
            x = nn.max_pool(x, (2, 2), (2, 2), padding="SAME")
            skips.append(x := Block(width)(x))
        for skip in skips[-2::-1]:
            x = jnp.repeat(jnp.repeat(x, 2, axis=1), 2, axis=2)[:, : skip.shape[1]]
            x = nn.Conv(skip.shape[-1], (1, 1))(x) + skip
            x = Block(skip.shape[-1])(x)
        number = num_classes(self.config.num_objects)
        out = _depth_to_space(nn.Conv(4 * (number + 2), (1, 1))(x))
        return out[..., :number], out[..., number:]


def _space_to_depth(x: Array) -> Array:
    """f[B, H/2, W/2, 4 C]: squares of pixels as one."""
    b, h, w, c = x.shape
    return (
        x.reshape(b, h // 2, 2, w // 2, 2, c)
        .transpose(0, 1, 3, 2, 4, 5)
        .reshape(b, h // 2, w // 2, 4 * c)
    )


def _depth_to_space(x: Array) -> Array:
    """The inverse of `_space_to_depth`."""
    b, h, w, c = x.shape
    return (
        x.reshape(b, h, w, 2, 2, c // 4)
        .transpose(0, 1, 3, 2, 4, 5)
        .reshape(b, 2 * h, 2 * w, c // 4)
    )


def network_images(rgb: Array, depth: Array, height: Array) -> Array:
    """f32[..., H, W, 5], each about as large as 1, of pictures, depths and heights.

    Args:
      rgb: u8[..., H, W, 3]. depth, height: f[..., H, W], metres, the latter over the table; `NO_DEPTH` where
        nothing was measured.
    """
    depth = depth.astype(jnp.float32)
    height = height.astype(jnp.float32)
    is_there = depth > 0
    far = jnp.where(is_there, (depth - _DEPTH_MIDDLE) / _DEPTH_SCALE, -2.0)
    high = jnp.where(is_there, jnp.clip(height / _HEIGHT_SCALE, -2.0, 4.0), -2.0)
    light = rgb / 255.0
    axes = (-3, -2, -1)
    # Whatever the exposure, a picture is as bright and as rich in contrast as any other.
    light = (light - light.mean(axes, keepdims=True)) / (light.std(axes, keepdims=True) + 0.01)
    return jnp.concatenate([light, jnp.stack([far, high], axis=-1)], axis=-1)


@dataclass(frozen=True)
class SegmentModel:
    """The network of some sizes, whose weights are given."""

    config: SegmentConfig

    def init(self, key: Array) -> Any:
        """Fresh weights."""
        return SegmentNet(self.config).init(key, jnp.zeros((1, HEIGHT, WIDTH, 5)))

    def apply(self, params: Any, images: Array) -> tuple[Array, Array]:
        """Logits and votes (`SegmentNet`) of images f32[B, H, W, 5]."""
        found: Any = SegmentNet(self.config).apply(params, images)
        return found

    def answers(self, params: Any, images: Array) -> tuple[Array, Array]:
        """Probabilities f32[B, H, W, C]; where pixels say that their object's centre is, f32[B, H, W, 2]."""
        logits, votes = self.apply(params, images)
        return jax.nn.softmax(logits), pixel_places() + VOTE_SCALE * votes


def pixel_places() -> Array:
    """f32[H, W, 2]: the middles of the network's pixels, right and down."""
    return jnp.stack(jnp.meshgrid(jnp.arange(WIDTH) + 0.5, jnp.arange(HEIGHT) + 0.5), axis=-1)


def shrink(rgb: np.ndarray, depth: np.ndarray, height: np.ndarray) -> tuple[np.ndarray, ...]:
    """Images of any size as the network reads them: u8[120, 160, 3], and f16[120, 160] twice.

    Args:
      depth, height: f32[H, W], metres, nan where nothing was measured.
    """
    rows, columns = sample_pixels(depth.shape)
    at = np.ix_(rows, columns)
    stacked = np.stack([depth, height])[:, rows][:, :, columns]
    stacked = np.where(np.isfinite(stacked), stacked, NO_DEPTH).astype(np.float16)
    factor = depth.shape[0] // HEIGHT
    if depth.shape == (factor * HEIGHT, factor * WIDTH):
        small = rgb.reshape(HEIGHT, factor, WIDTH, factor, 3).mean((1, 3))
        return np.round(small).astype(np.uint8), stacked[0], stacked[1]
    return rgb[at], stacked[0], stacked[1]


def sample_pixels(shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The rows and columns of a picture that stand for the network's."""
    rows = ((np.arange(HEIGHT) + 0.5) * shape[0] / HEIGHT).astype(int)
    columns = ((np.arange(WIDTH) + 0.5) * shape[1] / WIDTH).astype(int)
    return rows, columns


_STEP = 0.008
"""Metres of depth between two neighbouring pixels from which on they count as parts of different things."""
_SHARE = 0.6
"""How much of a pixel's chances come from the piece that it belongs to."""
# Metres over the table: below the first nothing of an object is seen; pieces begin at the second; what is
# above the third and near to an object is a part of it.
_FLAT = 0.002
_LOW = 0.004
_RAISED = 0.006

_SELDOM = 0.1
"""What is left of the chance that something raised is background."""
_NEAR = 6
"""Pixels."""


def smooth(height: np.ndarray) -> np.ndarray:
    """f32[H, W]: the medians of 3 x 3 heights, of which noise leaves single ones too high or too low.

    Args:
      height: f32[H, W], metres over the table, nan where nothing was measured, as it is in the answer.
    """
    is_there = np.isfinite(height)
    return np.where(is_there, median_filter(np.where(is_there, height, 0.0), 3), np.nan).astype(
        np.float32
    )


def enlarge(image: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """f32[H, W, C] of f32[h, w, C], each pixel mixed from the four nearest."""
    (low_rows, high_rows, down), (low, high, right) = (
        _between(size, wanted) for size, wanted in zip(image.shape, shape, strict=False)
    )
    upper = _mix(image[low_rows], image[high_rows], down[:, None, None])
    return _mix(upper[:, low], upper[:, high], right[None, :, None])


def _between(size: int, wanted: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    place = np.clip((np.arange(wanted) + 0.5) * size / wanted - 0.5, 0, size - 1)
    low = place.astype(int)
    return low, np.minimum(low + 1, size - 1), (place - low).astype(np.float32)


def _mix(one: np.ndarray, other: np.ndarray, share: np.ndarray) -> np.ndarray:
    return one + share * (other - one)


def by_pieces(chance: np.ndarray, depth: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Chances f32[H, W, C] that mostly agree within each piece of surface over the table that has no step.

    Args:
      depth: f32[H, W], metres; height: f32[H, W], metres over the table; not finite where
        nothing was measured.
    """
    rows, columns, classes = chance.shape
    with np.errstate(invalid="ignore"):
        is_over = np.isfinite(depth) & (height > _LOW)
        beside = is_over[:, 1:] & is_over[:, :-1] & (np.abs(np.diff(depth, axis=1)) < _STEP)
        below = is_over[1:] & is_over[:-1] & (np.abs(np.diff(depth, axis=0)) < _STEP)
    number = np.arange(rows * columns).reshape(rows, columns)
    one = np.concatenate([number[:, 1:][beside], number[1:][below]])
    other = np.concatenate([number[:, :-1][beside], number[:-1][below]])
    graph = coo_matrix((np.ones(len(one), bool), (one, other)), shape=(rows * columns,) * 2)
    num_pieces, piece = connected_components(graph, directed=False)
    flat = chance.reshape(-1, classes)
    size = np.bincount(piece, minlength=num_pieces)
    mean = (
        np.stack([np.bincount(piece, each, num_pieces) for each in flat.T], axis=1) / size[:, None]
    )
    mixed = (1 - _SHARE) * flat + _SHARE * mean[piece]
    return mixed.reshape(chance.shape).astype(np.float32)


def with_raised(chance: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Chances f32[H, W, C] where what is above the table f32[H, W], metres, is seldom background."""
    with np.errstate(invalid="ignore"):
        is_raised = height > _RAISED
    fitted = chance.copy()
    fitted[is_raised, BACKGROUND] *= _SELDOM
    return fitted


def fit_to_depth(label: np.ndarray, height: np.ndarray) -> np.ndarray:
    """u8[H, W]: labels with what lies flat on the table left out of objects, and thin raised parts added."""
    fitted = label.copy()
    far, nearest = distance_transform_edt(label < FIRST_OBJECT, return_indices=True)
    with np.errstate(invalid="ignore"):
        is_part = (label == BACKGROUND) & (height > _RAISED) & (far <= _NEAR)
        is_flat = height < _FLAT
    if (label >= FIRST_OBJECT).any():
        fitted[is_part] = label[nearest[0][is_part], nearest[1][is_part]]
    fitted[is_flat & (fitted >= FIRST_OBJECT)] = BACKGROUND
    return fitted


KIND = "segmenter"
"""Of a checkpoint, as its record names it."""
_TRAIN = "python -m studies.perception train"
_HINT = f"the folder named segmenter of a run of `{_TRAIN}` in a checkout"
_NUM_WIDTHS = 4
# Pixels: of the votes' histogram, of its blur, and from its peak within which votes are believed.
_BIN = 2
_SPREAD = 2.0
_REACH = 25.0

_MIRRORED: tuple[Callable[[np.ndarray], np.ndarray], ...] = (
    lambda image: image,
    np.fliplr,
    np.flipud,
    lambda image: image[::-1, ::-1],
)
"""Each is its own inverse."""

network_answers: Any = jax.jit(
    lambda model, params, rgb, depth, height: model.answers(
        params, network_images(rgb, depth, height)
    ),
    static_argnums=0,
)
"""`SegmentModel.answers` of what `network_images` takes."""


class NetworkSegmenter:
    """Segments by a trained network, and by where depth has steps (below).

    Of each object those pixels are kept whose votes for its centre agree.

    Args:
      names: of the objects. params: the network's weights. config: its sizes.
      top: height of the table's top, metres.
    """

    def __init__(
        self, names: tuple[str, ...], params: Any, config: SegmentConfig, top: float
    ) -> None:
        self._names = tuple(names)
        self._params = params
        self._top = top
        self._model = SegmentModel(config)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the objects that it knows."""
        return self._names

    def __call__(
        self, rgb: np.ndarray, depth: np.ndarray, camera: Camera, among: Sequence[str] | None = None
    ) -> Segmentation:
        rgb, depth = check_images(rgb, depth, camera)
        height = (camera.points(depth)[..., 2] - self._top).astype(np.float32)
        # The picture and its mirror images, which the network has learned from alike.
        images = [
            np.stack([turn(each) for turn in _MIRRORED]) for each in shrink(rgb, depth, height)
        ]
        chances, centers = map(np.asarray, network_answers(self._model, self._params, *images))
        mean = np.mean([turn(each) for turn, each in zip(_MIRRORED, chances, strict=True)], axis=0)
        chance = enlarge(mean, depth.shape)
        height = smooth(height)
        absent = [
            k for k, name in enumerate(self._names) if among is not None and name not in among
        ]
        chance[..., [FIRST_OBJECT + k for k in absent]] = 0.0
        chance = with_raised(by_pieces(chance, depth, height), height)
        center = enlarge(centers[0], depth.shape)
        label = chance.argmax(-1).astype(np.uint8)
        for index in range(len(self._names)):
            mask = label == FIRST_OBJECT + index
            if mask.any():
                keeps = mask.copy()
                keeps[mask] = agreeing(center[mask])
                label[mask & ~keeps] = 0
        return Segmentation(self._names, fit_to_depth(label, height))


def agreeing(votes: np.ndarray) -> np.ndarray:
    """bool[P]: the votes f32[P, 2], pixels, that are near to where most of them are."""
    cells = np.clip((votes / _BIN).astype(int), 0, [WIDTH // _BIN - 1, HEIGHT // _BIN - 1])
    histogram = np.zeros((WIDTH // _BIN, HEIGHT // _BIN))
    np.add.at(histogram, (cells[:, 0], cells[:, 1]), 1.0)
    smooth = gaussian_filter(histogram, _SPREAD)
    peak = _BIN * (np.array(np.unravel_index(smooth.argmax(), smooth.shape)) + 0.5)
    return np.linalg.norm(votes - peak, axis=1) < _REACH


def embedded_segmenters() -> dict[str, Path]:
    """The trained segmenters that come with the package, by the name of their pool."""
    return embedded_checkpoints("segmenters")


def segmenter_folder(segmenter: str | Path) -> Path:
    """Where a trained segmenter is: that of a pool's name, a folder of its own, or a run's.

    Raises:
      PoolError: it is neither.
    """
    known = embedded_segmenters()
    path = known.get(str(segmenter), Path(segmenter))
    for folder in (path / KIND, path):
        if (folder / "record.json").is_file():
            return folder
    raise PoolError(
        f"no segmenter {str(segmenter)!r}",
        f"{', '.join(known) or 'none comes with the package'}; {_HINT}",
        f"{_TRAIN}, in a checkout",
    )


def load_segmenter(segmenter: str | Path) -> NetworkSegmenter:
    """The segmenter in a folder, or of a pool's name.

    Raises:
      PoolError: there is none, it is damaged, or of another kind.
    """
    path = segmenter_folder(segmenter)
    record = read_record(path)
    if record.get("kind") != KIND:
        raise PoolError(
            f"{path} holds a network of kind {record.get('kind')!r}, no segmenter", hint=_HINT
        )
    config = config_of(SegmentConfig, record, path, _HINT)
    try:
        names = tuple(map(str, record["names"]))
        top = float(record["top"])
        if len(names) != config.num_objects or len(config.widths) != _NUM_WIDTHS:
            raise ValueError(f"{len(names)} names, widths {config.widths}")
        blank = blank_params(SegmentModel(config))
    except (TypeError, KeyError, ValueError) as error:
        place = path / "record.json"
        raise PoolError(
            f"{place} does not say what network it holds ({error})", hint=_HINT
        ) from error
    return NetworkSegmenter(names, read_policy(path, blank), config, top)
