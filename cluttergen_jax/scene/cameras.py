"""Cameras around a support: where they stand, and how they look at its region; the same for all its scenes.

What files of scenes say of a camera is in the frame of MuJoCo, OpenGL, USD and glTF: it looks along its own
-z, its +y points up and its +x right in the picture. Everywhere else a camera is a `sensing.camera.Camera`,
in OpenCV's frame, which these are made from and can be turned into again (`pinhole`). All look at the middle
of the region, on the support's top; directions are those of the region, whose x is its first side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.sensing.camera import Camera, intrinsics

CAMERAS = ("overhead", "front", "side", "wrist")
"""overhead: straight down, +y up in the picture. front: from -y, 30 degrees down. side: from +x, the same.
wrist: as on a robot's hand, 30 cm above the top, 60 degrees down."""

SIZE = (640, 480)
"""Width and height of the picture in pixels, where a format asks for them."""
_FOVY = 45.0
_WIDE_FOVY = 65.0
_ELEVATION = 30.0
_WRIST_ELEVATION = 60.0
_WRIST_HEIGHT = 0.30
# Metres that objects may rise above the top and reach beyond the region and are still seen.
_TALL = 0.35
_OVERHANG = 0.10

_FLIP = np.array([1.0, -1.0, -1.0])
"""From columns right, down, forward to right, up, backward, and back."""


@dataclass(frozen=True, eq=False)
class FixedCamera:
    """A camera that stands still, as files of scenes have it.

    Attributes:
      name: one of `CAMERAS`.
      position: f64[3], metres, world frame.
      quaternion: f64[4], wxyz, the turn of T_world_camera; it looks along its own -z, +y is up.
      fovy: degrees, the vertical field of view.
      width, height: pixels.
    """

    name: str
    position: np.ndarray
    quaternion: np.ndarray
    fovy: float
    width: int = SIZE[0]
    height: int = SIZE[1]

    @staticmethod
    def of(name: str, camera: Camera) -> FixedCamera:
        """A pinhole camera whose axis goes through the picture's middle and whose pixels are square."""
        from scipy.spatial.transform import Rotation

        # No zero is negative, in files neither.
        quaternion = Rotation.from_matrix(camera.rotation * _FLIP).as_quat(scalar_first=True) + 0.0
        fovy = 2 * math.degrees(math.atan(camera.height / 2 / camera.K[1, 1]))
        return FixedCamera(name, camera.eye, quaternion, fovy, camera.width, camera.height)

    @property
    def pinhole(self) -> Camera:
        """The same camera in OpenCV's frame, as everything that senses takes it."""
        T = np.eye(4)
        T[:3, :3] = self.rotation * _FLIP
        T[:3, 3] = self.position
        focal = self.height / 2 / math.tan(math.radians(self.fovy) / 2)
        return Camera(self.width, self.height, intrinsics(self.width, self.height, focal), T)

    @property
    def rotation(self) -> np.ndarray:
        """f64[3, 3]: columns are the camera's right, up and backward in the world."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self.quaternion, scalar_first=True).as_matrix()

    @property
    def fovx(self) -> float:
        """Degrees, the horizontal field of view."""
        tangent = math.tan(math.radians(self.fovy) / 2) * self.width / self.height
        return math.degrees(2 * math.atan(tangent))


def scene_cameras(support: SupportAsset, names: Sequence[str] = CAMERAS) -> tuple[FixedCamera, ...]:
    """Cameras of these names around a support, in this order.

    Raises:
      ConfigError: there is no such camera, or one is named twice.
    """
    unknown = [name for name in names if name not in CAMERAS]
    if unknown or len(set(names)) < len(names):
        raise ConfigError(f"cameras {', '.join(names)}", f"each once of {', '.join(CAMERAS)}")
    return tuple(_camera(name, support) for name in names)


def _camera(name: str, support: SupportAsset) -> FixedCamera:
    reach = np.array(support.region.half_extents) + _OVERHANG
    tangent = math.tan(math.radians(_FOVY) / 2)
    if name == "overhead":
        distance = _TALL + max(reach[1] / tangent, reach[0] / (tangent * SIZE[0] / SIZE[1]))
        return _looking(name, support, 0.0, 90.0, distance, _FOVY)
    if name == "wrist":
        distance = _WRIST_HEIGHT / math.sin(math.radians(_WRIST_ELEVATION))
        return _looking(name, support, 0.0, _WRIST_ELEVATION, distance, _WIDE_FOVY)
    distance = math.hypot(*reach, _TALL / 2) / math.sin(math.radians(_FOVY) / 2)
    return _looking(name, support, 0.0 if name == "front" else 90.0, _ELEVATION, distance, _FOVY)


def _looking(
    name: str, support: SupportAsset, azimuth: float, elevation: float, distance: float, fovy: float
) -> FixedCamera:
    """A camera so far from the region's middle; degrees: azimuth 0 is at its -y, 90 at its +x."""
    turn = support.region.yaw + math.radians(azimuth)
    down = math.radians(elevation)
    ahead = np.array([-math.sin(turn), math.cos(turn), 0.0])
    forward = math.cos(down) * ahead - math.sin(down) * np.array([0.0, 0.0, 1.0])
    # Straight down, what is ahead is up in the picture; at any other angle it is above what is below.
    up = math.sin(down) * ahead + math.cos(down) * np.array([0.0, 0.0, 1.0])
    target = support.region_points[0]
    width, height = SIZE
    focal = height / 2 / math.tan(math.radians(fovy) / 2)
    eye = target - distance * forward
    return FixedCamera.of(
        name, Camera.looking(eye, target, width, height, focal, (up[0], up[1], up[2]))
    )
