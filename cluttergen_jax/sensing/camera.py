"""Cameras: pinhole ones in OpenCV's frame, presets around a support, and those that a user asks for.

The camera's x points right in the picture, y down, z forward along the optical axis; the middle of the pixel
in row i and column j is at (j + 0.5, i + 0.5). Depth is measured along the optical axis, not along the ray.
A `CameraPlan` says where a camera stands in every scene: by name or from a file, fixed or drawn anew.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np

from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.schema import SchemaError, convert, read_json

# Width, height and focal length in pixels of the depth image of an Intel RealSense D435.
REALSENSE_SIZE = (640, 480)
REALSENSE_FOCAL = 615.0

# The same at a quarter of the resolution: what pairs for learning are made with.
SIZE = (160, 120)
FOCAL = REALSENSE_FOCAL / 4

_OVERHEAD_HEIGHT = 0.75
_SEEN_BEYOND = 0.03
_SIDE_HEIGHT = 0.40
_SIDE_DISTANCE = 2.0
_SIDE_FIELD = 60.0
_SIDE_SIZE = 224
_FREE_ELEVATION = (25.0, 65.0)
_FREE_DISTANCE = (0.6, 1.1)
_FREE_JITTER = 0.03


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera without distortion.

    Attributes:
      width, height: pixels.
      K: f64[3, 3], intrinsics, pixels.
      T_world_camera: f64[4, 4], metres.

    Raises:
      ConfigError: a picture without pixels, intrinsics of no camera, or a pose that is no rigid transform:
        a mirrored one is none.
    """

    width: int
    height: int
    K: np.ndarray
    T_world_camera: np.ndarray

    def __post_init__(self) -> None:
        K = np.asarray(self.K, np.float64)
        T = np.asarray(self.T_world_camera, np.float64)
        if self.width < 1 or self.height < 1:
            raise ConfigError(
                f"a camera of {self.width} x {self.height} pixels", "1 pixel or more a side"
            )
        if K.shape != (3, 3) or not (np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0):
            raise ConfigError(
                f"intrinsics {K.tolist()}", "a 3 x 3 matrix with focal lengths above 0"
            )
        if not _is_rigid(T):
            raise ConfigError(
                f"a camera's pose {T.tolist()}",
                "a 4 x 4 rigid transform of finite numbers, not mirrored",
                "x right, y down, z forward in the camera's own frame",
            )
        object.__setattr__(self, "K", K)
        object.__setattr__(self, "T_world_camera", T)

    @staticmethod
    def looking(
        eye: np.ndarray,
        target: np.ndarray,
        width: int = SIZE[0],
        height: int = SIZE[1],
        focal: float = FOCAL,
        up: tuple[float, float, float] = (0.0, 0.0, 1.0),
    ) -> Camera:
        """A camera at `eye` that looks at `target`, f[3] each, world frame, metres.

        Args:
          focal: the focal length, pixels.
          up: what points up in the picture, world frame; not along the line of sight.

        Raises:
          ConfigError: there is no direction to look into, or none that is up.
        """
        forward = np.asarray(target, np.float64) - np.asarray(eye, np.float64)
        right = np.cross(forward, up)
        length = float(np.linalg.norm(forward))
        across = float(np.linalg.norm(right))
        if not across > 1e-9 * max(length, 1e-9):
            raise ConfigError(
                f"a camera at {np.round(eye, 4).tolist()} that looks at {np.round(target, 4).tolist()}",
                "two places, not one above the other along `up`",
                "another `up`",
            )
        forward = forward / length
        right = right / across
        T = np.eye(4)
        T[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
        T[:3, 3] = eye
        return Camera(width, height, intrinsics(width, height, focal), T)

    @property
    def eye(self) -> np.ndarray:
        """f64[3]: where the camera is, world frame, metres."""
        return self.T_world_camera[:3, 3]

    def record(self) -> dict[str, object]:
        """As JSON files have it: width, height, K and T_world_camera."""
        return {
            "width": self.width,
            "height": self.height,
            "K": self.K.tolist(),
            "T_world_camera": self.T_world_camera.tolist(),
        }

    @property
    def rotation(self) -> np.ndarray:
        """f64[3, 3]: columns are the camera's right, down and forward in the world."""
        return self.T_world_camera[:3, :3]

    @cached_property
    def directions(self) -> np.ndarray:
        """f64[H, W, 3]: from the eye through each pixel's middle, world frame; 1 m along the optical axis."""
        return _pixel_directions(self.width, self.height, self.K.tobytes()) @ self.rotation.T

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where world points f[..., 3] are seen.

        Returns:
          f64[..., 2], pixels, x right and y down from the picture's upper left corner; f64[...], their depth,
          metres. Points with a depth of 0 or less are behind the camera, and their pixels mean nothing.
        """
        seen = (np.asarray(points, np.float64) - self.eye) @ self.rotation
        depth = seen[..., 2]
        ahead = np.where(np.abs(depth) < 1e-12, 1e-12, depth)
        return (seen / ahead[..., None] @ self.K.T)[..., :2], depth

    def points(self, depth: np.ndarray) -> np.ndarray:
        """f64[H, W, 3]: the world points that the pixels' middles show at depths f[H, W]; nan without one."""
        metres = np.where(np.isfinite(depth), depth, np.nan).astype(np.float64)
        return self.eye + self.directions * metres[..., None]


def _is_rigid(T: np.ndarray) -> bool:
    """Whether it is f[4, 4], a turn and a shift."""
    if T.shape != (4, 4) or not np.isfinite(T).all():
        return False
    turn = T[:3, :3]
    return bool(np.abs(turn @ turn.T - np.eye(3)).max() < 1e-5 and np.linalg.det(turn) > 0)


@lru_cache(maxsize=16)
def _pixel_directions(width: int, height: int, K: bytes) -> np.ndarray:
    """f64[H, W, 3]: directions of the pixels' middles in the camera's own frame; read alone."""
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    pixels = np.stack([x, y, np.ones_like(x)], axis=-1)
    directions = pixels @ np.linalg.inv(np.frombuffer(K, np.float64).reshape(3, 3)).T
    directions.flags.writeable = False
    return directions


def intrinsics(width: int, height: int, focal: float) -> np.ndarray:
    """f64[3, 3]: square pixels, the optical axis through the picture's middle; `focal` in pixels."""
    return np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])


def realsense_focal(width: int) -> float:
    """The focal length of a RealSense's depth image at a picture's width, both in pixels."""
    return REALSENSE_FOCAL * width / REALSENSE_SIZE[0]


def overhead(
    support: SupportAsset, width: int = SIZE[0], height: int = SIZE[1], focal: float = FOCAL
) -> Camera:
    """Straight above the region's middle, 0.75 m or as high as it takes to see the whole region.

    The region's longer side runs along the picture's longer one.
    """
    half = np.array(support.region.half_extents)
    turn = support.region.yaw + (math.pi / 2 if (half[0] < half[1]) == (width > height) else 0.0)
    across, along = sorted(half + _SEEN_BEYOND)
    distance = focal * max(2 * along / max(width, height), 2 * across / min(width, height))
    target = _middle(support)
    eye = target + np.array([0.0, 0.0, max(_OVERHEAD_HEIGHT, distance)])
    up = (-math.sin(turn), math.cos(turn), 0.0)
    return Camera.looking(eye, target, width, height, focal, up)


def side(support: SupportAsset) -> Camera:
    """The camera whose pictures the paper's placement network was trained on.

    0.40 m above the top, a region's width beyond the middle of its -x side, 224 x 224 pixels, 60 degrees.
    """
    focal = _SIDE_SIZE / 2 / math.tan(math.radians(_SIDE_FIELD) / 2)
    distance = _SIDE_DISTANCE * support.region.half_extents[0]
    target = _middle(support)
    ahead = np.array([math.cos(support.region.yaw), math.sin(support.region.yaw), 0.0])
    eye = target - distance * ahead + np.array([0.0, 0.0, _SIDE_HEIGHT])
    return Camera.looking(eye, target, _SIDE_SIZE, _SIDE_SIZE, focal)


def free(
    support: SupportAsset,
    rng: np.random.Generator,
    width: int = SIZE[0],
    height: int = SIZE[1],
    focal: float = FOCAL,
) -> Camera:
    """A camera somewhere around the region, looking about at its middle.

    Azimuth uniform over the circle, elevation over 25 to 65 degrees, distance over 0.6 to 1.1 m; what it
    looks at lies up to 3 cm from the region's middle along each axis.
    """
    azimuth = rng.uniform(0.0, 2 * math.pi)
    elevation = math.radians(rng.uniform(*_FREE_ELEVATION))
    distance = rng.uniform(*_FREE_DISTANCE)
    flat = math.cos(elevation)
    away = np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])
    target = _middle(support) + rng.uniform(-_FREE_JITTER, _FREE_JITTER, 3)
    return Camera.looking(_middle(support) + distance * away, target, width, height, focal)


PRESETS: dict[str, Callable[[SupportAsset, np.random.Generator], Camera]] = {
    "overhead": lambda support, rng: overhead(support),
    "side": lambda support, rng: side(support),
    "free": free,
}
"""Cameras by name; only `free` draws."""


def find_preset(name: str) -> Callable[[SupportAsset, np.random.Generator], Camera]:
    """The preset of that name (ConfigError: there is none)."""
    if name not in PRESETS:
        raise ConfigError(f"camera {name!r}", ", ".join(PRESETS))
    return PRESETS[name]


def _middle(support: SupportAsset) -> np.ndarray:
    """f64[3]: the region's middle on the support's top, world frame."""
    return support.region_points[0]


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
        focal = realsense_focal(width)
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
        focal = stored.focal or realsense_focal(stored.width)
        if stored.fovy is not None:
            focal = 0.5 * stored.height / math.tan(math.radians(stored.fovy) / 2)
        K = intrinsics(width, height, focal * scale)
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
