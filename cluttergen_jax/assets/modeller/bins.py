"""Open containers that are piled into, on a table: a bin, a tote and a tray of any size.

Collision is the table, the container's floor and its four walls, which rise above the support's top: the
floor. The region is the whole floor.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Draw, hex_colors, made_by
from cluttergen_jax.assets.support import Box, Rectangle, SupportAsset
from cluttergen_jax.errors import ConfigError

WOODS = hex_colors("c9a375 b5814f 8a5a3a dcc49c a4683f")

SIZES: dict[str, tuple[float, float, float]] = {
    "bin": (0.40, 0.30, 0.15),
    "tote": (0.60, 0.40, 0.20),
    "tray": (0.45, 0.32, 0.04),
}
"""Width, depth and height inside, metres."""

# Metres: thickness of walls and floor, the shortest and the longest side inside.
WALL = 0.008
LEAST = 0.02
MOST = 2.0

# Metres: the paper's table, wider where less of it than this would be left around the container.
_TABLE = (0.60, 0.70)
_AROUND = 0.10
_HEIGHT = 0.70

_CORNER = 0.012
_CANONICAL = Draw()
_COLORS = dict(zip(SIZES, hex_colors("4f6d8c 8a9099 b5814f"), strict=True))


def slab(size: Sequence[float], center: Sequence[float], low: float) -> Box:
    """The collision box of `size` (x, y, z) standing on height `low`, centred on `center` (x, y)."""
    half = (size[0] / 2, size[1] / 2, size[2] / 2)
    return Box((float(center[0]), float(center[1]), low + half[2]), half)


def table(
    name: str,
    top: float,
    region: Rectangle,
    boxes: Sequence[Box],
    pieces: Sequence[cad.Painted],
    label: str = "",
) -> SupportAsset:
    """Puts a table together; its provenance is the modeller, and its label the name's words if empty."""
    label = label or name.replace("_", " ")
    return SupportAsset(
        name,
        label,
        tuple(boxes),
        top,
        region,
        made_by(name),
        tuple(cad.piece(*each) for each in pieces),
    )


def open_container(
    kind: str, size: tuple[float, ...] | None = None, vary: Draw = _CANONICAL
) -> SupportAsset:
    """A bin, a tote or a tray on a table of 0.70 m.

    Args:
      kind: a key of `SIZES`.
      size: width, depth and perhaps height inside, metres; those of its kind if not given.
      vary: the canonical sizes and colours by default.

    Raises:
      ConfigError: a size is out of range or not a number.
    """
    width, depth, height = (*(size or ()), *SIZES[kind][len(size or ()) :])
    given = np.array([width, depth, height], np.float64)
    if not np.all(np.isfinite(given)) or given.min() < LEAST or given.max() > MOST:
        raise ConfigError(
            f"a {kind} of {width} x {depth} x {height} m inside",
            f"each side between {LEAST:g} and {MOST:g} m",
            f"support='{kind}-{'x'.join(f'{side:.2f}' for side in SIZES[kind])}'",
        )
    width, depth, height = (vary(float(side), 0.1) for side in given)
    outer = (width + 2 * WALL, depth + 2 * WALL)
    top = _HEIGHT + WALL
    under = tuple(max(least, side + 2 * _AROUND) for least, side in zip(_TABLE, outer, strict=True))
    color = vary.color(_COLORS[kind])
    wood = vary.color(*WOODS)
    walls: list[Box] = []
    for sign in (-1, 1):
        walls.append(slab((WALL, outer[1], WALL + height), (sign * (width + WALL) / 2, 0), _HEIGHT))
        walls.append(slab((width, WALL, WALL + height), (0, sign * (depth + WALL) / 2), _HEIGHT))
    shell = cad.difference(
        cad.extrude(cad.rounded_rect(*outer, _CORNER), WALL + height, _HEIGHT),
        cad.box((width, depth, 2 * height), z=top),
    )
    return table(
        kind,
        top,
        Rectangle((0.0, 0.0), (width / 2, depth / 2)),
        [
            slab((*under, _HEIGHT), (0, 0), 0.0),
            slab((width, depth, WALL), (0, 0), _HEIGHT),
            *walls,
        ],
        [(cad.box((*under, _HEIGHT)), wood), (shell, color)],
        f"{kind} on a table",
    )
