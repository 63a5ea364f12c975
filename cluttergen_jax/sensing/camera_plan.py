"""Cameras as a user asks for them: by name, from a file, fixed or drawn anew for each scene."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np

from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.schema import SchemaError, convert, read_json
from cluttergen_jax.sensing.camera import (
    REALSENSE_FOCAL,
    REALSENSE_SIZE,
    Camera,
    free,
    overhead,
    side,
)

Size = tuple[int, int]
_Side = Annotated[int, msgspec.Meta(ge=16, le=8192)]
_Three = tuple[float, float, float]
_Range = tuple[float, float]
_MOST = 1000
_NAMED = ("free", "overhead", "side")
_HINT = "cameras=('free:4',), or a JSON file (docs/guide/datasets.md)"


class _Stored(msgspec.Struct, forbid_unknown_fields=True):
    """A camera of a file: `T_world_camera`, or `eye` and `target`, or ranges to draw from.

    `frame` is that of eye and target: of the region's middle on the top, or the world's.
    """

    name: Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9_-]+$")]
    width: _Side = REALSENSE_SIZE[0]
    height: _Side = REALSENSE_SIZE[1]
    K: tuple[_Three, _Three, _Three] | None = None
    focal: float | None = None
    fovy: float | None = None
    frame: Literal["world", "region"] = "region"
    T_world_camera: tuple[tuple[float, float, float, float], ...] | None = None
    eye: _Three | None = None
    target: _Three = (0.0, 0.0, 0.0)
    up: _Three = (0.0, 0.0, 1.0)
    azimuth: _Range | None = None
    elevation: _Range = (25.0, 65.0)
    distance: _Range = (0.6, 1.1)
    jitter: float = 0.0


class _File(msgspec.Struct, forbid_unknown_fields=True):
    cameras: list[_Stored]


@dataclass(frozen=True)
class CameraPlan:
    """A camera that looks at every scene.

    Attributes:
      name: of its views.
      size: width and height, pixels.
      stored: where it is, from a file; None for one of the names free, overhead and side.
      kind: one of these names.
    """

    name: str
    size: Size
    kind: str = ""
    stored: _Stored | None = None

    @property
    def is_fixed(self) -> bool:
        """Whether it stands at one place for all scenes on a support."""
        return self.kind != "free" if self.stored is None else self.stored.azimuth is None

    def draw(self, support: SupportAsset, rng: np.random.Generator) -> Camera:
        """The camera for one scene.

        Raises:
          ConfigError: its eye is where it looks, or it looks along `up`.
        """
        width, height = self.size
        if self.stored is not None:
            return _place_camera(self.stored, self.size, support, rng)
        focal = REALSENSE_FOCAL * width / REALSENSE_SIZE[0]
        if self.kind == "free":
            return free(support, rng, width, height, focal)
        if self.kind == "overhead":
            return overhead(support, width, height, focal)
        seen = side(support)
        # The paper's field of view, along the shorter side.
        focal = seen.K[0, 0] * min(width, height) / seen.width
        return Camera.looking(seen.eye, seen.eye + seen.rotation[:, 2], width, height, focal)


def parse_cameras(asked: Sequence[str | Path], size: Size | None = None) -> tuple[CameraPlan, ...]:
    """The cameras that are asked for.

    Args:
      asked: "free", "overhead" or "side", "free:4" for four of them, or the path of a JSON file.
      size: width and height of all, pixels; of a file's cameras their own if None, else 640 x 480.

    Raises:
      ConfigError: there is no such camera or file, the file is none, or two cameras have one name.
    """
    if isinstance(asked, str | Path) or not asked:
        raise ConfigError(f"cameras = {asked!r}", "one camera or more", _HINT)
    plans: list[CameraPlan] = []
    for text in map(str, asked):
        plans += (
            _read_file(Path(text), size) if text.endswith(".json") else _plans_by_name(text, size)
        )
    names = [plan.name for plan in plans]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ConfigError(
            f"cameras of one name: {', '.join(twice)}",
            "each name once",
            "'free:2' for two of a kind",
        )
    return tuple(plans)


def _plans_by_name(text: str, size: Size | None) -> list[CameraPlan]:
    match = re.fullmatch(r"([a-z]+)(?::(\d+))?", text)
    if match is None or match[1] not in _NAMED:
        raise ConfigError(
            f"camera {text!r}",
            f"{', '.join(_NAMED)}, NAME:NUMBER, or a JSON file",
            _HINT,
            closest(text, _NAMED),
        )
    kind = match[1]
    number = int(match[2] or 1)
    if not 1 <= number <= (_MOST if kind == "free" else 1):
        allowed = (
            f"free:1 to free:{_MOST}" if kind == "free" else f"one {kind}, which is always the same"
        )
        raise ConfigError(f"camera {text!r}", allowed, _HINT)
    names = [kind] if number == 1 else [f"{kind}-{place}" for place in range(number)]
    return [CameraPlan(name, size or REALSENSE_SIZE, kind) for name in names]


def _read_file(path: Path, size: Size | None) -> list[CameraPlan]:
    try:
        found = convert(read_json(path), _File)
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be read ({error.strerror})", "a JSON file of cameras", _HINT
        ) from error
    except SchemaError as error:
        raise ConfigError(
            f"{path} is no file of cameras: {error}", '{"cameras": [{"name": ...}]}', _HINT
        ) from error
    if not found.cameras:
        raise ConfigError(f"{path} has no camera", "one or more", _HINT)
    for each in found.cameras:
        _check(path, each)
        if (
            size is not None
            and each.K is not None
            and size[0] * each.height != size[1] * each.width
        ):
            raise ConfigError(
                f"{path}: camera {each.name!r} at {size[0]} x {size[1]}, K of {each.width} x {each.height}",
                "a size of the same shape",
                "`width` and `height` of K in the file, and no `size`",
            )
    return [
        CameraPlan(each.name, size or (each.width, each.height), stored=each)
        for each in found.cameras
    ]


def _check(path: Path, each: _Stored) -> None:
    places = [each.T_world_camera is not None, each.eye is not None, each.azimuth is not None]
    if sum(places) != 1:
        raise ConfigError(
            f"{path}: camera {each.name!r} has {sum(places)} of T_world_camera, eye and azimuth",
            "one of them",
        )
    lenses = [each.K is not None, each.focal is not None, each.fovy is not None]
    if sum(lenses) > 1:
        raise ConfigError(
            f"{path}: camera {each.name!r} has {sum(lenses)} of K, focal and fovy", "one of them"
        )
    if each.fovy is not None and not 1 <= each.fovy <= 170:
        raise ConfigError(
            f"{path}: camera {each.name!r} with fovy = {each.fovy}", "1 to 170 degrees"
        )
    if each.K is not None and (each.K[0][1] or each.K[1][0] or each.K[2] != (0.0, 0.0, 1.0)):
        allowed = "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]], without skew"
        raise ConfigError(f"{path}: camera {each.name!r} with K = {each.K}", allowed)
    for name in ("azimuth", "elevation", "distance"):
        low, high = getattr(each, name) or (0.0, 0.0)
        if not (math.isfinite(low) and math.isfinite(high) and low <= high):
            raise ConfigError(
                f"{path}: camera {each.name!r} with {name} = [{low}, {high}]", "a range, low first"
            )
    if each.distance[0] <= 0 or each.jitter < 0:
        raise ConfigError(
            f"{path}: camera {each.name!r} with distance {each.distance}, jitter {each.jitter}",
            "metres above 0",
        )


def _place_camera(
    stored: _Stored, size: Size, support: SupportAsset, rng: np.random.Generator
) -> Camera:
    width, height = size
    middle = support.region_points[0]
    origin = middle if stored.frame == "region" else np.zeros(3)
    scale = width / stored.width
    if stored.K is not None:
        K = np.array(stored.K, np.float64)
        K[:2] *= np.array([[scale], [height / stored.height]])
    else:
        focal = stored.focal or REALSENSE_FOCAL * stored.width / REALSENSE_SIZE[0]
        if stored.fovy is not None:
            focal = 0.5 * stored.height / math.tan(math.radians(stored.fovy) / 2)
        K = np.array([[focal * scale, 0, width / 2], [0, focal * scale, height / 2], [0, 0, 1.0]])
    if stored.T_world_camera is not None:
        return Camera(width, height, K, np.array(stored.T_world_camera, np.float64))
    target = origin + stored.target
    if stored.azimuth is None:
        assert stored.eye is not None
        eye = origin + stored.eye
    else:
        azimuth, elevation = (
            math.radians(rng.uniform(*each)) for each in (stored.azimuth, stored.elevation)
        )
        flat = math.cos(elevation)
        away = np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])
        eye = target + rng.uniform(*stored.distance) * away
        target = target + rng.uniform(-stored.jitter, stored.jitter, 3) if stored.jitter else target
    seen = Camera.looking(eye, target, width, height, 1.0, stored.up)
    return Camera(width, height, K, seen.T_world_camera)
