"""Columns: what cameras saw of a table, and where something may be hidden, as boxes that the arm avoids."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from cluttergen_jax.assets import Box
from cluttergen_jax.placement import VOID
from cluttergen_jax.sensing import PartialMap

CELL = 0.005
"""Metres: the sides of a cell of the map that the arm is planned in."""
THIN = 0.005
"""Metres above the top from which on something is taken to stand there: depth cameras are not more exact."""
_BAND = 0.005
"""Metres that heights within one box may differ by; the box has the highest."""


class OccupancyBoxes(NamedTuple):
    """Boxes from the support's top upwards, world frame.

    Attributes:
      seen: up to the highest surface that was seen. hidden: up to where it was seen to be empty.
    """

    seen: tuple[Box, ...]
    hidden: tuple[Box, ...]


def occupancy_boxes(found: PartialMap) -> OccupancyBoxes:
    """The columns of a map: all that was not seen to be empty counts as taken."""
    is_on = found.grid.bare > VOID
    seen = np.where(is_on & (found.height > THIN), found.height, 0.0)
    hidden = np.where(is_on & ~found.is_seen, found.ceiling, 0.0)
    return OccupancyBoxes(tuple(_boxes(seen, found)), tuple(_boxes(hidden, found)))


def _boxes(height: np.ndarray, found: PartialMap) -> Iterator[Box]:
    """Boxes that cover heights f[W, H] above 0: runs of like cells, joined with those of the next row."""
    open_runs: dict[tuple[int, int], tuple[int, float, float]] = {}
    for row in range(len(height) + 1):
        runs = _runs(height[row]) if row < len(height) else {}
        for span, (first, low, high) in list(open_runs.items()):
            if span in runs and max(high, runs[span][1]) - min(low, runs[span][0]) <= _BAND:
                more = runs.pop(span)
                open_runs[span] = first, min(low, more[0]), max(high, more[1])
            else:
                del open_runs[span]
                yield _box(found, (first, row), span, high)
        open_runs |= {span: (row, low, high) for span, (low, high) in runs.items()}


def _runs(row: np.ndarray) -> dict[tuple[int, int], tuple[float, float]]:
    """First cell and the one after the last of runs of like heights above 0: the least and the greatest."""
    runs = {}
    first = 0
    while first < len(row):
        end = first + 1
        low = float(row[first])
        high = float(row[first])
        while low > 0 and end < len(row) and row[end] > 0:
            lower = min(low, float(row[end]))
            higher = max(high, float(row[end]))
            if higher - lower > _BAND:
                break
            end = end + 1
            low = lower
            high = higher
        if low > 0:
            runs[first, end] = low, high
        first = end
    return runs


def _box(found: PartialMap, rows: tuple[int, int], span: tuple[int, int], height: float) -> Box:
    grid = found.grid
    T = found.grid.T_world_region
    ends = grid.corner + np.array([rows, span], np.float64).T * grid.cell
    middle = T[:3, :3] @ np.array([*ends.mean(0), height / 2]) + T[:3, 3]
    half = (ends[1] - ends[0]) / 2
    yaw = float(np.arctan2(T[1, 0], T[0, 0]))
    x, y, z = middle.tolist()
    return Box((x, y, z), (float(half[0]), float(half[1]), height / 2), yaw)
