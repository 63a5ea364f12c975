"""From a network's coarse answers to masks at the size of the picture, by what depth tells of edges."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt, median_filter
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from cluttergen_jax.downstream.perception.classes import BACKGROUND, FIRST_OBJECT

_STEP = 0.008
"""Metres of depth between two neighbouring pixels from which on they count as parts of different things."""
_SHARE = 0.6
"""How much of a pixel's chances come from the piece that it belongs to."""
_FLAT, _LOW, _RAISED = 0.002, 0.004, 0.006
"""Metres over the table: below the first nothing of an object is seen; pieces begin at the second; what is
above the third and near to an object is a part of it."""
_SELDOM = 0.1
"""What is left of the chance that something raised is background."""
_NEAR = 6
"""Pixels."""


def smoothed(height: np.ndarray) -> np.ndarray:
    """f32[H, W]: the medians of 3 x 3 heights, of which noise leaves single ones too high or too low.

    Args:
      height: f32[H, W], metres over the table, nan where nothing was measured, as it is in the answer.
    """
    is_there = np.isfinite(height)
    return np.where(is_there, median_filter(np.where(is_there, height, 0.0), 3), np.nan).astype(np.float32)


def enlarged(image: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """f32[H, W, C] of f32[h, w, C], each pixel mixed from the four nearest."""
    (low_rows, high_rows, down), (low, high, right) = (
        _between(size, wanted) for size, wanted in zip(image.shape, shape, strict=False)
    )
    upper = _mixed(image[low_rows], image[high_rows], down[:, None, None])
    return _mixed(upper[:, low], upper[:, high], right[None, :, None])


def _between(size: int, wanted: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    place = np.clip((np.arange(wanted) + 0.5) * size / wanted - 0.5, 0, size - 1)
    low = place.astype(int)
    return low, np.minimum(low + 1, size - 1), (place - low).astype(np.float32)


def _mixed(one: np.ndarray, other: np.ndarray, share: np.ndarray) -> np.ndarray:
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
    flat, size = chance.reshape(-1, classes), np.bincount(piece, minlength=num_pieces)
    mean = np.stack([np.bincount(piece, each, num_pieces) for each in flat.T], axis=1) / size[:, None]
    mixed = (1 - _SHARE) * flat + _SHARE * mean[piece]
    return mixed.reshape(chance.shape).astype(np.float32)


def with_raised(chance: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Chances f32[H, W, C] where what is above the table f32[H, W], metres, is seldom background."""
    with np.errstate(invalid="ignore"):
        is_raised = height > _RAISED
    fitted = chance.copy()
    fitted[is_raised, BACKGROUND] *= _SELDOM
    return fitted


def fitted_to_depth(label: np.ndarray, height: np.ndarray) -> np.ndarray:
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
