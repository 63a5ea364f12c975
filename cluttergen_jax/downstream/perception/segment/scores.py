"""How good a segmentation is: intersection over union of each class."""

from __future__ import annotations

import numpy as np

from cluttergen_jax.downstream.perception.classes import num_classes


def confusion(found: np.ndarray, true: np.ndarray, num_objects: int) -> np.ndarray:
    """i64[C, C]: pixels of each true class (rows) that were taken for each class (columns)."""
    number = num_classes(num_objects)
    index = true.astype(np.int64).ravel() * number + found.astype(np.int64).ravel()
    return np.bincount(index, minlength=number * number).reshape(number, number)


def iou_of(confused: np.ndarray) -> np.ndarray:
    """f64[C]: intersection over union of each class of a confusion i64[C, C]; nan where there is neither."""
    both = np.diag(confused)
    either = confused.sum(0) + confused.sum(1) - both
    return np.where(either > 0, both / np.maximum(either, 1), np.nan)


def intersection_over_union(found: np.ndarray, true: np.ndarray, num_objects: int) -> np.ndarray:
    """f64[C]: of labels [...] and true ones; over all pixels together."""
    return iou_of(confusion(found, true, num_objects))
