"""What views on disk must be: their record, and the rows of a block."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
import pyarrow as pa

from cluttergen_jax.assets import ObjectAsset, SupportAsset, public_name
from cluttergen_jax.downstream.digests import json_digest
from cluttergen_jax.downstream.noise import NOISE_OFF, NoiseConfig, noisy
from cluttergen_jax.downstream.perception.types import num_classes
from cluttergen_jax.downstream.samples import (
    FAR,
    MOST_PIXELS,
    SampleFormat,
    SampleSet,
    faults_of,
    lengths_of,
    read_columns,
)
from cluttergen_jax.errors import BankError
from cluttergen_jax.scene import Bank
from cluttergen_jax.schema import Numbers, refuse
from cluttergen_jax.sensing import Camera, View
from cluttergen_jax.views import TENTH_OF_A_MILLIMETRE, depth_levels

MAX_VIEWS = 1_000_000
"""Of a split: a larger number is a slip of the hand."""


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
    "T_world_camera": Numbers("f8", ("views", 16), -FAR, FAR),
    "width": Numbers("i4", ("views",), 1, MOST_PIXELS),
    "height": Numbers("i4", ("views",), 1, MOST_PIXELS),
    "objects": Numbers("i4", ("objects",), 0),
    "poses": Numbers("f8", ("objects", 7), -FAR, FAR),
}
"""Of a block's columns."""


def check_rows(table: pa.Table) -> None:
    """Refuses rows that no `PerceptionViews` draws.

    Raises:
      SchemaError: a number is not finite or out of its range, or the parts of a row do not belong together.
    """
    found = read_columns(table, _NUMBERS)
    pixels = found["width"].astype(np.int64) * found["height"]
    objects = lengths_of(table, "objects")
    lengths = {"rgb": 3 * pixels, "depth": 2 * pixels, "label": pixels, "poses": objects}
    lacking = [name for name in ("method", "has_arm") if table[name].null_count]
    refuse(
        [
            *faults_of(table, lengths, found["poses"]),
            *(f"{name!r} lacks a value" for name in lacking),
        ]
    )


TENTHS_A_METRE = 10_000

SCHEMA = pa.schema(
    [
        ("view", pa.int32()),
        ("scene", pa.int32()),
        ("method", pa.string()),
        ("texture", pa.int32()),
        ("has_arm", pa.bool_()),
        ("camera_K", pa.list_(pa.float64(), 9)),
        ("T_world_camera", pa.list_(pa.float64(), 16)),
        ("width", pa.int32()),
        ("height", pa.int32()),
        ("rgb", pa.binary()),
        ("depth", pa.binary()),
        ("label", pa.binary()),
        ("objects", pa.list_(pa.int32())),
        ("poses", pa.list_(pa.list_(pa.float64(), 7))),
    ]
)
"""`objects` are those that stand, by their number in the pool, at `poses`, T_world_object, metres and wxyz.
Depth is u16 in tenths of a millimetre along the optical axis, little-endian, row by row, 0 where nothing is
or beyond 6.5 m; labels are u8 (`types`); rgb is u8. Neither exposure nor noise is in them."""
VIEWS = SampleFormat(
    "views", "view", "python -m studies.perception data", SCHEMA, 64, ViewRecord, check_rows
)


@dataclass(frozen=True, eq=False)
class StoredView:
    """A view as it is read.

    Attributes:
      number: of the view in its split. view: what was seen.
      objects: i[n], numbers in the pool of what stands; poses: f64[n, 7], T_world_object.
      method: of the scene. has_arm: the arm was there.
    """

    number: int
    view: View
    objects: np.ndarray
    poses: np.ndarray
    method: str
    has_arm: bool


class ViewSet(SampleSet):
    """A folder of views that is read. `record` is what `views.json` holds."""

    form = VIEWS

    @cached_property
    def objects(self) -> tuple[ObjectAsset, ...]:
        """The pool's objects, in the order of their numbers.

        Raises:
          BankError: an asset is missing or damaged.
        """
        bank = Bank(self.path, {"assets": self.record["assets"]})
        return tuple(bank.object(name) for name in self.record["names"])

    @property
    def pool(self) -> str:
        """The name of the pool, for people."""
        recipes = [
            recipe for split in self.record["splits"].values() for recipe in split["recipes"]
        ]
        return public_name(str(recipes[0].get("pool"))) if recipes else ""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the objects."""
        return tuple(self.record["names"])

    @cached_property
    def support(self) -> SupportAsset:
        """The table."""
        return Bank(self.path, {"assets": self.record["assets"]}).support

    def digest(self, split: str) -> str:
        """Equal for equal views of a split."""
        told = [self.record["assets"], self.split(split)]
        return json_digest(told, 20)

    def views(self, split: str, number: int | None = None) -> Iterator[StoredView]:
        """The first views of a split, all if no number is given.

        Raises:
          ConfigError: there is no such split, or it has fewer; BankError: a block is missing or damaged.
        """
        known = len(self.names)
        for table in self.tables(split, number):
            for view in map(_view_of, table.to_pylist()):
                if max(view.objects, default=0) >= known or view.view.label.max() >= num_classes(
                    known
                ):
                    fault = f"view {view.number} shows objects beyond the {known} of its record"
                    raise BankError(f"{self.path} is damaged: {fault}", hint=VIEWS.again)
                yield view


read_views = ViewSet.read


def row_of(stored: StoredView, scene: int, texture: int) -> dict[str, object]:
    """A view as a row of `SCHEMA`."""
    view = stored.view
    camera = stored.view.camera
    depth = depth_levels(view.depth.astype(np.float64), TENTH_OF_A_MILLIMETRE).astype("<u2")
    return {
        "view": stored.number,
        "scene": scene,
        "method": stored.method,
        "texture": texture,
        "has_arm": stored.has_arm,
        "camera_K": camera.K.ravel().tolist(),
        "T_world_camera": camera.T_world_camera.ravel().tolist(),
        "width": camera.width,
        "height": camera.height,
        "rgb": view.colours.tobytes(),
        "depth": depth.tobytes(),
        "label": view.label.tobytes(),
        "objects": stored.objects.tolist(),
        "poses": stored.poses.tolist(),
    }


def _view_of(row: dict[str, Any]) -> StoredView:
    """The inverse of `row_of`."""
    shape = (row["height"], row["width"])
    camera = Camera(
        row["width"],
        row["height"],
        np.array(row["camera_K"]).reshape(3, 3),
        np.array(row["T_world_camera"]).reshape(4, 4),
    )
    levels = np.frombuffer(row["depth"], "<u2").reshape(shape)
    metres = levels / np.float32(TENTHS_A_METRE)
    depth = np.where(levels > 0, metres, np.inf).astype(np.float32)
    rgb = np.frombuffer(row["rgb"], np.uint8).reshape(*shape, 3)
    label = np.frombuffer(row["label"], np.uint8).reshape(shape)
    poses = np.array(row["poses"], np.float64).reshape(-1, 7)
    objects = np.array(row["objects"], np.int64)
    return StoredView(
        row["view"],
        View(depth, label, camera, rgb),
        objects,
        poses,
        row["method"],
        row["has_arm"],
    )


def simulate_camera(stored: StoredView, noise: NoiseConfig, seed: int) -> View:
    """What a camera of some exposure and noise makes of a stored view; with no noise the exposure stays, too.

    Depth is nan where nothing was measured; labels stay exact.
    """
    view = stored.view
    rng = np.random.default_rng((seed, stored.number, 7))
    if noise == NOISE_OFF:
        return view
    rgb = expose(view.colours, rng)
    depth, camera = noisy(view.depth, view.camera, noise, rng)
    return replace(view, rgb=rgb, depth=depth, camera=camera)


def expose(rgb: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """u8[H, W, 3]: a picture u8[H, W, 3] as a camera of another exposure and with noise takes it."""
    gain, gamma, sigma = rng.uniform([0.7, 0.8, 0.0], [1.35, 1.25, 0.015])
    balance = rng.normal(1.0, 0.03, 3)
    light = gain * balance * (rgb / 255.0) ** gamma + sigma * rng.standard_normal(rgb.shape)
    return np.round(255 * np.clip(light, 0, 1)).astype(np.uint8)
