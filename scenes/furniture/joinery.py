"""Boards, legs and tops: each with the boxes that stand for it in collision. Metres, z up.

A table top that is not a rectangle is one core box, as large as fits, and strips between the core and the
outline. Objects in the region touch the core alone, so that one resting face does not become many contacts.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from manifold3d import Manifold

from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.bins import slab
from cluttergen_jax.assets.modeller.draw import Draw, hex_colors
from cluttergen_jax.assets.support import Box, Rectangle

PAINTS = hex_colors("ece8df d7dde0 5b6b78 44584c b9694a")
METALS = hex_colors("33363b 9ba1a6 5a5d61")
DARK_STEEL = METALS[0]

_STRIPS_PER_SIDE = 6
# Above 1, strips are thinner near the core's corners, where the outline runs askew to them.
_STRIP_CROWDING = 1.35


def darker(color: cad.Rgb, factor: float) -> cad.Rgb:
    """A colour with every channel multiplied by `factor`, at most white."""
    red, green, blue = (min(factor * channel, 1.0) for channel in color)
    return red, green, blue


def block(lower: Sequence[float], upper: Sequence[float]) -> Box:
    """The collision box between two corners."""
    low = np.asarray(lower, np.float64)
    high = np.asarray(upper, np.float64)
    center = ((low + high) / 2).tolist()
    half = ((high - low) / 2).tolist()
    return Box((center[0], center[1], center[2]), (half[0], half[1], half[2]))


def oval_boxes(rx: float, ry: float, low: float, top: float) -> tuple[Box, ...]:
    """An elliptic top as one core box and strips around it that keep the ellipse's area.

    Args:
      rx, ry: half axes along x and y.
      low, top: heights of the lower and the upper face.
    """
    share = np.linspace(0.0, 1.0, _STRIPS_PER_SIDE + 1) ** _STRIP_CROWDING
    turn = np.pi / 4 * (1 + share)
    reach = np.sin(turn)
    # The mean of sqrt(1 - t^2) between two values of t, which is the strip's half length on a unit circle.
    area = 0.5 * (reach * np.sqrt(1 - reach**2) + np.arcsin(reach))
    length = np.diff(area) / np.diff(reach)
    core = np.sqrt(0.5)
    boxes = [block((-core * rx, -core * ry, low), (core * rx, core * ry, top))]
    for near, far, half in zip(reach[:-1], reach[1:], length, strict=True):
        for sign in (-1, 1):
            y0, y1 = sorted((sign * near * ry, sign * far * ry))
            x0, x1 = sorted((sign * near * rx, sign * far * rx))
            boxes.append(block((-half * rx, y0, low), (half * rx, y1, top)))
            boxes.append(block((x0, -half * ry, low), (x1, half * ry, top)))
    return tuple(boxes)


def oval_region(rx: float, ry: float) -> Rectangle:
    """The largest rectangle inside an ellipse."""
    return Rectangle((0.0, 0.0), (rx * np.sqrt(0.5).item(), ry * np.sqrt(0.5).item()))


def rounded_boxes(
    width: float, depth: float, radius: float, low: float, top: float
) -> tuple[Box, ...]:
    """A rectangle with round corners as three boxes of the same area."""
    length = width / 2 - radius * (1 - np.pi / 4)
    inner = depth / 2 - radius
    outer = depth / 2
    return (
        block((-width / 2, -inner, low), (width / 2, inner, top)),
        block((-length, -outer, low), (length, -inner, top)),
        block((-length, inner, low), (length, outer, top)),
    )


def plate(outline: np.ndarray, low: float, top: float, bevel: float = 0.003) -> Manifold:
    """A plate with a convex outline f64[N, 2], its edges broken by `bevel`, its faces flat."""
    half = np.abs(outline).max(0)
    inner = outline * (1 - bevel / half)
    layers = [(inner, low), (outline, low + bevel), (outline, top - bevel), (inner, top)]
    return cad.hull(
        np.concatenate([np.column_stack([rim, np.full(len(rim), z)]) for rim, z in layers])
    )


def board(
    size: Sequence[float], center: Sequence[float], low: float, bevel: float = 0.002
) -> Manifold:
    """A rectangular board of `size` (x, y, z) on height `low` with broken edges."""
    half = np.asarray(size[:2]) / 2
    outline = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half
    return plate(outline, low, low + size[2], min(bevel, min(size) / 4)).translate(
        (center[0], center[1], 0)
    )


def bar(start: Sequence[float], end: Sequence[float], width: float, depth: float) -> Manifold:
    """A leg whose ends are cut level: a rectangle `width` x `depth` (x, y) led from `start` to `end`."""
    corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) * (width / 2, depth / 2, 0)
    return cad.hull(np.concatenate([corners + np.asarray(point) for point in (start, end)]))


def round_leg(
    foot: Sequence[float], head: Sequence[float], foot_radius: float, head_radius: float
) -> Manifold:
    """A tapered round leg between two points, its ends cut level."""
    turns = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = np.column_stack([np.cos(turns), np.sin(turns), np.zeros(24)])
    return cad.hull(
        np.concatenate(
            [ring * foot_radius + np.asarray(foot), ring * head_radius + np.asarray(head)]
        )
    )


def mirror_corners(x: float, y: float) -> list[tuple[float, float]]:
    """The four corners (+-x, +-y)."""
    return [(sx * x, sy * y) for sx in (-1, 1) for sy in (-1, 1)]


def square_legs(
    x: float, y: float, side: float, height: float, color: cad.Rgb
) -> tuple[tuple[Box, ...], tuple[cad.Painted, ...]]:
    """Four upright square legs centred on (+-x, +-y)."""
    places = mirror_corners(x, y)
    solids = [cad.box((side, side, height), place) for place in places]
    return tuple(slab((side, side, height), place, 0.0) for place in places), (
        (cad.union(*solids), color),
    )


def planks(
    vary: Draw,
    width: float,
    depths: Sequence[float],
    gap: float,
    y: float,
    low: float,
    high: float,
    color: cad.Rgb,
) -> tuple[tuple[Box, ...], tuple[cad.Painted, ...]]:
    """Boards along x, side by side from `y` onwards with gaps, each a little lighter or darker.

    Args:
      depths: along y, one per board.
      low, high: heights of the lower and the upper face.
    """
    noise = vary.rng or np.random.default_rng(5)
    boxes = []
    pieces = []
    for depth in depths:
        center = (0.0, y + depth / 2)
        size = (width, depth, high - low)
        boxes.append(slab(size, center, low))
        pieces.append((board(size, center, low), darker(color, noise.uniform(0.93, 1.05))))
        y += depth + gap
    return tuple(boxes), tuple(pieces)
