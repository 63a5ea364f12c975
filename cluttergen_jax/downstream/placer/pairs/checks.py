"""What pairs on disk must be: their record, and the rows of a block."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
import numpy as np
import pyarrow as pa

from cluttergen_jax.config import MAX_PAIRS
from cluttergen_jax.downstream.columns import labels_fault, lengths_of, numbers_of
from cluttergen_jax.schema import Numbers, check_numbers, refuse
from cluttergen_jax.types import Verdict

MOST_PIXELS = 4096
"""Of an image's side."""
_FAR = 100.0
"""Metres beyond which nothing of a table's scene is."""
_UNIT = 1e-3
"""By which the length of a quaternion may differ from 1."""


class PairSplit(msgspec.Struct):
    """How a split was made, as far as it is read."""

    num_pairs: Annotated[int, msgspec.Meta(ge=1, le=MAX_PAIRS)]
    seed: Annotated[int, msgspec.Meta(ge=0)]
    camera: str
    recipe: dict[str, Any]


class PairRecord(msgspec.Struct):
    """What `pairs.json` holds."""

    assets: dict[str, Any]
    splits: dict[Literal["train", "val", "test"], PairSplit]


_NUMBERS = {
    "camera_K": Numbers("f8", ("pairs", 9), -1e5, 1e5),
    "T_region_camera": Numbers("f8", ("pairs", 16), -_FAR, _FAR),
    "width": Numbers("i4", ("pairs",), 1, MOST_PIXELS),
    "height": Numbers("i4", ("pairs",), 1, MOST_PIXELS),
    "standing_poses": Numbers("f4", (None, 7), -_FAR, _FAR),
    "target_pose": Numbers("f4", ("pairs", 7), -_FAR, _FAR),
    "candidate": Numbers("f4", (None, 4), -_FAR, _FAR),
    "candidate_source": Numbers("u1", (None,), 0, 2),
    "candidate_verdict": Numbers("u1", (None,), 0, max(Verdict)),
}
"""Of a block's columns."""


def check_rows(table: pa.Table) -> None:
    """Refuses rows of pairs that no `PairMaker` makes.

    Raises:
      SchemaError: a number is not finite or out of its range, or the parts of a row do not belong together.
    """
    inner = {"camera_K": 9, "T_region_camera": 16, "standing_poses": 7, "target_pose": 7, "candidate": 4}
    found = {name: numbers_of(table, name, *([inner[name]] if name in inner else [])) for name in _NUMBERS}
    check_numbers(found, _NUMBERS)
    for name in ("scene", "slot", "object", "standing"):
        numbers_of(table, name)
    standing, pixels = numbers_of(table, "num_standing"), found["width"].astype(np.int64) * found["height"]
    candidates = lengths_of(table, "candidate")
    expected = {
        "standing": standing,
        "standing_poses": standing,
        "depth": 2 * pixels,
        "labels": pixels,
        "candidate": np.full(len(pixels), candidates[0]),
        "candidate_source": candidates,
        "candidate_verdict": candidates,
    }
    faults = [
        f"{name!r} is not as long as it should be"
        for name, length in expected.items()
        if not np.array_equal(lengths_of(table, name), length)
    ]
    turns = [np.linalg.norm(found[name][:, 3:], axis=1) for name in ("standing_poses", "target_pose")]
    if np.abs(np.concatenate(turns) - 1).max(initial=0) > _UNIT:
        faults.append("a quaternion is not of length 1")
    refuse(faults or [fault for fault in [labels_fault(table, "labels", 1 + standing)] if fault])
