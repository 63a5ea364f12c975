"""A support: the fixed thing that carries the objects, its collision made of boxes."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cluttergen_jax.assets.shape import Piece, Provenance
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import rectangle_corners


@dataclass(frozen=True)
class Box:
    """A solid box in the world frame.

    Attributes:
      center: metres.
      half_extents: metres.
      yaw: radians about z.
      rgba: its colour where the support has no visual pieces.
    """

    center: tuple[float, float, float]
    half_extents: tuple[float, float, float]
    yaw: float = 0.0
    rgba: tuple[float, float, float, float] = (0.72, 0.55, 0.38, 1.0)


@dataclass(frozen=True)
class Rectangle:
    """A queried region as it lies on a support's top; finite, its sides above zero.

    Attributes:
      center: metres, world x and y.
      half_extents: metres, along its own x and y.
      yaw: radians, from world x to its own x.
    """

    center: tuple[float, float] = (0.0, 0.0)
    half_extents: tuple[float, float] = (0.3, 0.35)
    yaw: float = 0.0

    def __post_init__(self) -> None:
        numbers = (*self.center, *self.half_extents, self.yaw)
        if not all(map(math.isfinite, numbers)) or min(self.half_extents) <= 0:
            x, y = self.half_extents
            raise ConfigError(
                f"a rectangle of {2 * x:g} x {2 * y:g} m about {tuple(self.center)}, turned by {self.yaw:g}",
                "finite numbers, sides above zero",
                "metres, such as 0.4x0.5",
            )

    @property
    def corners(self) -> np.ndarray:
        """f64[4, 2], metres, world x and y, counter-clockwise."""
        return rectangle_corners(self.center, self.half_extents, self.yaw)


@dataclass(frozen=True)
class SupportAsset:
    """A table. World frame: z up, origin on the floor below the support's centre.

    Attributes:
      boxes: all of its collision, every part of the flat top among them.
      top: height of the flat top that carries objects, metres.
      region: the region queried by default: the largest good rectangle on the top, clear of rims and risers.
      pieces: what is drawn instead of the boxes; empty means the boxes themselves are drawn.
    """

    name: str
    label: str
    boxes: tuple[Box, ...]
    top: float
    region: Rectangle
    provenance: Provenance
    pieces: tuple[Piece, ...] = ()


def cuboid_table(width: float = 0.60, depth: float = 0.70, height: float = 0.70) -> SupportAsset:
    """The paper's table: one box whose whole top is the queried region (paper, section 4).

    Args:
      width, depth, height: metres along x, y and z, each in [0.02, 10].

    Raises:
      ConfigError: a size is out of range or not a number.
    """
    size = np.array([width, depth, height], np.float64)
    if not np.all(np.isfinite(size)) or size.min() < 0.02 or size.max() > 10.0:
        raise ConfigError(
            f"a table of {width} x {depth} x {height} m",
            "each side between 0.02 and 10 m",
            "sizes in metres, such as 0.60 x 0.70",
        )
    half = tuple(float(side) / 2 for side in size)
    return SupportAsset(
        name="table",
        label="cuboid table",
        boxes=(Box((0.0, 0.0, half[2]), (half[0], half[1], half[2])),),
        top=float(height),
        region=Rectangle((0.0, 0.0), (half[0], half[1]), 0.0),
        provenance=Provenance("cluttergen_jax", "Apache-2.0"),
    )


def _numbers(text: str, what: str, form: str) -> list[float]:
    try:
        values = [float(part) for part in re.split(r"[,x]", text.strip())]
    except ValueError as error:
        raise ConfigError(f"{what} {text!r}", form) from error
    if not all(math.isfinite(value) for value in values):
        raise ConfigError(f"{what} {text!r}", f"finite numbers: {form}")
    return values


def parse_region(text: str, default: Rectangle) -> Rectangle:
    """A queried region: `WxD` about the default region's centre, or `X,Y,W,D[,YAW]` (metres, degrees).

    Raises:
      ConfigError: it is neither.
    """
    form = "WxD, or X,Y,W,D or X,Y,W,D,YAW; metres and degrees, such as 0.4x0.5"
    values = _numbers(text, "region", form)
    if len(values) == 2:
        return Rectangle(default.center, (values[0] / 2, values[1] / 2), default.yaw)
    if len(values) in (4, 5):
        x, y, width, depth, *yaw = values
        return Rectangle((x, y), (width / 2, depth / 2), math.radians(yaw[0]) if yaw else 0.0)
    raise ConfigError(f"region {text!r}", form)


def parse_keep_out(text: str) -> Rectangle:
    """A keep-out box, `X,Y,W,D[,YAW]` (metres, degrees).

    Raises:
      ConfigError: it is not.
    """
    form = "X,Y,W,D or X,Y,W,D,YAW; metres and degrees, such as 0.1,0,0.2,0.2"
    values = _numbers(text, "keep-out box", form)
    if len(values) not in (4, 5):
        raise ConfigError(f"keep-out box {text!r}", form)
    return parse_region(text, Rectangle())


def parse_boxes(boxes: Sequence[Rectangle | str], argument: str) -> list[Rectangle]:
    """Keep-out boxes, each a rectangle or text.

    Raises:
      ConfigError: they are no sequence, or one of them is something else.
    """
    if isinstance(boxes, str | Rectangle):
        raise ConfigError(f"{argument} = {boxes!r}", "a sequence of boxes", f"{argument}=[{boxes!r}]")
    return [parse_keep_out(box) if isinstance(box, str) else box for box in boxes]


def recorded_rectangle(entry: str | Mapping[str, Any]) -> Rectangle:
    """A rectangle of a bank's record: its fields, or a keep-out box in the words of a command line."""
    if isinstance(entry, str):
        return parse_keep_out(entry)
    return Rectangle(tuple(entry["center"]), tuple(entry["half_extents"]), float(entry["yaw"]))
