"""A support alone, seen from above: its height over a fine grid, and the cells of a map around a region."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import grey_closing

from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.geometry import rectangle_corners

VOID = -1e3
"""Height of a cell with nothing under it, metres."""

_CELL = 0.0025
_MOST_CELLS = 2_000_000
_MOST_MAP_CELLS = 40_000
_NARROW_GAP = 0.02
_LOWEST = -0.01


def boxes_of(support: SupportAsset) -> np.ndarray:
    """f64[B, 7]: centre, half extents and yaw of all boxes; world frame, metres, radians."""
    return np.array([(*box.center, *box.half_extents, box.yaw) for box in support.boxes], np.float64)


def top_boxes(boxes: np.ndarray, top: float) -> np.ndarray:
    """Those of f64[B, 7] that reach up to the support's top, or to a centimetre below it."""
    return boxes[boxes[:, 2] + boxes[:, 5] - top > _LOWEST]


def ground_heights(boxes: np.ndarray, top: float) -> tuple[np.ndarray, np.ndarray, float]:
    """The highest box over each cell; gaps too narrow to matter, as between planks, are bridged.

    Args:
      boxes: f64[B, 7], from `top_boxes`.
      top: metres.

    Returns:
      f64[W, H], metres above the top, VOID where there is nothing, its border VOID; f64[2], where cell (0, 0)
      begins, world x and y, metres; the side of a cell, metres.
    """
    corners = _corners(boxes)
    low, high = corners.min(0), corners.max(0)
    cell = max(_CELL, float(np.sqrt((high - low).prod() / _MOST_CELLS)))
    counts = np.ceil((high - low) / cell - 1e-4).astype(int)
    axes = [low[axis] + (np.arange(counts[axis]) + 0.5) * cell for axis in (0, 1)]
    x, y = np.meshgrid(*axes, indexing="ij")
    height = np.full(x.shape, VOID)
    for box in boxes:
        cos, sin = np.cos(box[6]), np.sin(box[6])
        along, across = cos * (x - box[0]) + sin * (y - box[1]), cos * (y - box[1]) - sin * (x - box[0])
        covers = (np.abs(along) <= box[3]) & (np.abs(across) <= box[4])
        height[covers] = np.maximum(height[covers], box[2] + box[5] - top)
    width = int(_NARROW_GAP / cell) + 1
    bridged = grey_closing(np.pad(height, width, constant_values=VOID), size=(width, width))
    return bridged, low - width * cell, cell


def reach_beyond(
    boxes: np.ndarray, T_region_world: np.ndarray, half_extents: np.ndarray, radius: float
) -> np.ndarray:
    """f64[2]: how far beyond a region's sides objects centred in it can find the support, metres.

    Args:
      boxes: f64[B, 7], from `top_boxes`.
      T_region_world: f[4, 4]; half_extents: f[2], the region's.
      radius: that of the largest object seen from above, metres.
    """
    inverse = np.asarray(T_region_world, np.float64)
    local = _corners(boxes) @ inverse[:2, :2].T + inverse[:2, 3]
    return np.clip(np.abs(local).max(0) - np.asarray(half_extents), 0.0, radius)


def map_cells(half: np.ndarray, finest: float) -> tuple[tuple[float, float], tuple[int, int]]:
    """The sides of a map's cells and their numbers, a border of one cell included.

    The sides are whole numbers of cells, so that cells end where the support does.

    Args:
      half: f64[2], half the map's sides without its border, metres.
      finest: the smallest side of a cell, metres; larger where there would be too many.
    """
    counts = np.ceil(2 * half / max(finest, np.sqrt(4 * half.prod() / _MOST_MAP_CELLS)) - 1e-4)
    cell = (float(2 * half[0] / counts[0]), float(2 * half[1] / counts[1]))
    return cell, (int(counts[0]) + 2, int(counts[1]) + 2)


def _corners(boxes: np.ndarray) -> np.ndarray:
    """f64[4 B, 2]: boxes from above."""
    return np.concatenate([rectangle_corners(box[:2], box[3:5], box[6]) for box in boxes])
