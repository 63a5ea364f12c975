"""Rectangles as text, on the command line and in a bank's record."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.errors import ConfigError


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
        raise ConfigError(f"{argument} = {boxes!r}", "a sequence of Rectangles", f"{argument}=[{boxes!r}]")
    return [parse_keep_out(box) if isinstance(box, str) else box for box in boxes]


def recorded_rectangle(entry: str | Mapping[str, Any]) -> Rectangle:
    """A rectangle of a bank's record: its fields, or a keep-out box in the words of a command line."""
    if isinstance(entry, str):
        return parse_keep_out(entry)
    return Rectangle(tuple(entry["center"]), tuple(entry["half_extents"]), float(entry["yaw"]))
