"""The trained segmenter: a network's coarse answers, made masks by what depth tells of edges."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, median_filter
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from cluttergen_jax.downstream.fitting import blank_params, config_of, embedded_checkpoints
from cluttergen_jax.downstream.perception.segment.network import (
    HEIGHT,
    WIDTH,
    SegmentConfig,
    SegmentExample,
    SegmentLearner,
    network_images,
    shrink,
)
from cluttergen_jax.downstream.perception.types import (
    BACKGROUND,
    FIRST_OBJECT,
    Segmentation,
    check_images,
)
from cluttergen_jax.errors import PoolError
from cluttergen_jax.learning import folder_hash, read_policy, read_record
from cluttergen_jax.sensing import Camera

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
_HINT = "the folder named segmenter of a run of `cluttergen perception train`"
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

_answers: Any = jax.jit(
    lambda learner, params, rgb, depth, height: learner.answers(
        params, network_images(rgb, depth, height)
    ),
    static_argnums=0,
)


def answers_of(
    learner: Any, params: Any, examples: SegmentExample
) -> tuple[np.ndarray, np.ndarray]:
    """Probabilities f32[B, H, W, C] and centres f32[B, H, W, 2] that the network tells of examples."""
    found = _answers(learner, params, examples.rgb, examples.depth, examples.height)
    return np.asarray(found[0]), np.asarray(found[1])


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
        self._learner = SegmentLearner(config)

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
        images = (
            np.stack([turn(each) for turn in _MIRRORED]) for each in shrink(rgb, depth, height)
        )
        chances, centers = (
            np.asarray(each) for each in _answers(self._learner, self._params, *images)
        )
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
        "cluttergen perception train",
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
        if len(names) != config.num_objects or len(config.widths) != len(
            set(SegmentConfig(1).widths)
        ):
            raise ValueError(f"{len(names)} names, widths {config.widths}")
        blank = blank_params(SegmentLearner(config))
    except (TypeError, KeyError, ValueError) as error:
        place = path / "record.json"
        raise PoolError(
            f"{place} does not say what network it holds ({error})", hint=_HINT
        ) from error
    return NetworkSegmenter(names, read_policy(path, blank), config, top)


def network_hash(folder: Path) -> str:
    """The digest of a segmenter's own files, without the rule of certainty beside them."""
    return folder_hash(folder, ("record.json", "weights.npz"))
