"""A small arrow on the support that shows where the seat of a natural scene is."""

from __future__ import annotations

import numpy as np

from cluttergen_jax.assets.support import Rectangle, SupportAsset
from cluttergen_jax.geometry import transform_points
from cluttergen_jax.placement.natural import SEATS
from cluttergen_jax.rendering.renderer import Trail

_HALF_WIDTH = 0.03
_LENGTH = 0.025
_INSET = 0.01
"""Metres: of the arrow, whose tip points to the middle, and from the region's side to its ends."""
_LIFT = 0.002
_RGB = (0.15, 0.35, 0.75)


def seat_points(region: Rectangle, support: SupportAsset, seat: str) -> np.ndarray:
    """f64[3, 3]: the line of the arrow, world, metres.

    Args:
      seat: a side of the region, as in `SceneSpec.seat`.
    """
    away = np.array([np.cos(SEATS[seat]), np.sin(SEATS[seat])]).round()
    side = np.array([-away[1], away[0]])
    edge = away * (np.abs(away) @ region.half_extents - _INSET)
    tip = edge - _LENGTH * away
    line = np.array([edge - _HALF_WIDTH * side, tip, edge + _HALF_WIDTH * side])
    cos = np.cos(region.yaw)
    sin = np.sin(region.yaw)
    line = line @ np.array([[cos, sin], [-sin, cos]]) + region.center
    pose = np.array([0.0, 0.0, support.top, 1.0, 0.0, 0.0, 0.0])
    if support.named and not support.chosen.is_level:
        pose = support.chosen.pose
    return transform_points(pose, np.column_stack([line, np.full(3, _LIFT)]))


def seat_mark(region: Rectangle, support: SupportAsset, seat: str) -> tuple[Trail, ...]:
    """The arrow as pictures draw it; nothing for a scene without a seat, ""."""
    if not seat:
        return ()
    return (Trail(seat_points(region, support, seat), _RGB, radius=0.003),)
