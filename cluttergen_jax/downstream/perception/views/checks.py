"""What views on disk must be: their record, and the rows of a block."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
import numpy as np
import pyarrow as pa

from cluttergen_jax.config import MAX_VIEWS
from cluttergen_jax.downstream.columns import lengths_of, numbers_of
from cluttergen_jax.schema import Numbers, check_numbers, refuse

_MOST_PIXELS = 4096
"""Of an image's side."""
_FAR = 100.0
"""Metres beyond which nothing of a table's scene is."""
_UNIT = 1e-3
"""By which the length of a quaternion may differ from 1."""


class ViewSplit(msgspec.Struct):
    """How a split was made, as far as it is read."""

    num_views: Annotated[int, msgspec.Meta(ge=1, le=MAX_VIEWS)]
    recipes: list[dict[str, Any]]


class ViewRecord(msgspec.Struct):
    """What `views.json` holds."""

    assets: dict[str, Any]
    names: list[str]
    splits: dict[Literal["train", "val", "test"], ViewSplit]


_NUMBERS = {
    "texture": Numbers("i4", ("views",), 0),
    "camera_K": Numbers("f8", ("views", 9), -1e5, 1e5),
    "T_world_camera": Numbers("f8", ("views", 16), -_FAR, _FAR),
    "width": Numbers("i4", ("views",), 1, _MOST_PIXELS),
    "height": Numbers("i4", ("views",), 1, _MOST_PIXELS),
    "objects": Numbers("i4", ("objects",), 0),
    "poses": Numbers("f8", ("objects", 7), -_FAR, _FAR),
}
"""Of a block's columns."""


def check_rows(table: pa.Table) -> None:
    """Refuses rows of views that no `ViewMaker` makes.

    Raises:
      SchemaError: a number is not finite or out of its range, or the parts of a row do not belong together.
    """
    inner = {"camera_K": 9, "T_world_camera": 16, "poses": 7}
    found = {name: numbers_of(table, name, *([inner[name]] if name in inner else [])) for name in _NUMBERS}
    check_numbers(found, _NUMBERS)
    pixels = found["width"].astype(np.int64) * found["height"]
    expected = {
        "rgb": 3 * pixels,
        "depth": 2 * pixels,
        "label": pixels,
        "poses": lengths_of(table, "objects"),
    }
    faults = [
        f"{name!r} is not as long as it should be"
        for name, length in expected.items()
        if not np.array_equal(lengths_of(table, name), length)
    ]
    faults += [f"{name!r} lacks a value" for name in ("method", "has_arm") if table[name].null_count]
    if np.abs(np.linalg.norm(found["poses"][:, 3:], axis=1) - 1).max(initial=0) > _UNIT:
        faults.append("a quaternion is not of length 1")
    refuse(faults)
