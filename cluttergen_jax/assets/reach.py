"""Where on a support objects may be asked for: regions that lie on its top, boxes that leave some of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cluttergen_jax.assets.support import Box, Rectangle, SupportAsset
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import rotate_in_plane

_OVERHANG = 0.01
_LEVEL = 0.002
_GRID = 41


class Reach(NamedTuple):
    """Where a region's corners may lie: `lower` <= corner @ `axes` <= `upper`, world x and y, metres.

    Attributes:
      axes: f64[2, 2], columns along the sides of the support's own region; lower, upper: f64[2].
    """

    axes: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


def reach_of(support: SupportAsset) -> Reach:
    """The smallest rectangle that holds all boxes of the support's top, and a centimetre more."""
    level = [box for box in support.boxes if _is_top(box, support)]
    tops = [Rectangle(box.center[:2], box.half_extents[:2], box.yaw) for box in level or support.boxes]
    axes = rotate_in_plane(np.eye(2), -support.region.yaw)
    rim = np.concatenate([top.corners for top in tops]) @ axes
    return Reach(axes, rim.min(0) - _OVERHANG, rim.max(0) + _OVERHANG)


def check_reach(region: Rectangle, support: SupportAsset) -> None:
    """Refuses a region that reaches over the edges of the support's top by more than a centimetre.

    Raises:
      ConfigError: it does.
    """
    reach = reach_of(support)
    corners = region.corners @ reach.axes
    if (corners < reach.lower).any() or (corners > reach.upper).any():
        raise ConfigError(
            f"a region of {region} reaches beyond support {support.name!r}",
            f"a rectangle on its top, by default {support.region}",
            "a smaller region, or a larger table such as support='table-1.40x1.40'",
        )


def check_keep_out(boxes: Sequence[Rectangle], region: Rectangle) -> None:
    """Refuses boxes that leave no place for the centre of any object.

    Raises:
      ConfigError: they do.
    """
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, _GRID)] * 2), -1).reshape(-1, 2)
    places = rotate_in_plane(grid * region.half_extents, region.yaw) + region.center
    is_free = np.ones(len(places), bool)
    for box in boxes:
        local = rotate_in_plane(places - np.array(box.center), -box.yaw)
        is_free &= (np.abs(local) > box.half_extents).any(1)
    if not is_free.any():
        raise ConfigError(
            f"keep-out boxes {', '.join(map(str, boxes))}",
            "boxes that leave some of the queried region free",
            "smaller ones: X,Y,W,D are a centre and whole sides, in metres",
        )


def _is_top(box: Box, support: SupportAsset) -> bool:
    return abs(box.center[2] + box.half_extents[2] - support.top) < _LEVEL
