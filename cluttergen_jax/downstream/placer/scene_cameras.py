"""Cameras that look at partial scenes of one world: depth by rays, as pairs have it."""

from __future__ import annotations

import threading
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement import Problem
from cluttergen_jax.sensing import SUPPORT, Camera, DepthImage, RaySensor, find_preset, sensed_model
from cluttergen_jax.views import depth_of as metres_of

MANY = "free"
"""The preset that draws: only of it there is more than one camera."""
MOST_CAMERAS = 64
MILLIMETRES = 1000

_VIEWS = 20
"""Cameras that are tried until one sees the support and is not inside it."""


class DepthView(NamedTuple):
    """A depth image, f32[H, W] in metres along the optical axis, inf where nothing is, and its camera."""

    depth: np.ndarray
    camera: Camera


class SceneCameras:
    """Looks at scenes of one world by cameras of one preset; serves many threads.

    Args:
      problem: the world; preset: the cameras' name.

    Raises:
      ConfigError: there is no such preset.
    """

    def __init__(self, problem: Problem, preset: str) -> None:
        world = problem.world
        self.preset = preset
        self._draw = find_preset(preset)
        self._support = world.support
        self._sensor = RaySensor(sensed_model(world.objects, world.support))
        self._local = threading.local()

    def look(
        self, poses: np.ndarray, is_placed: np.ndarray, rng: np.random.Generator
    ) -> tuple[Camera, DepthImage]:
        """A camera that sees the support and is not inside it, and what it sees.

        Args:
          poses: f[K, 7], T_world_object; is_placed: bool[K].

        Raises:
          ConfigError: there is none.
        """
        data = self._pose(poses, is_placed)
        for _ in range(_VIEWS):
            camera = self._draw(self._support, rng)
            image = self._sensor.sense(data, camera)
            if not _is_inside(camera, self._support) and (image.label >= SUPPORT).any():
                return camera, image
        raise ConfigError(
            f"camera {self.preset!r} is inside the support or does not see it",
            "a camera that looks at the support from outside",
            "another camera, or another support",
        )

    def further(
        self, poses: np.ndarray, is_placed: np.ndarray, seed: tuple[int, ...], num_cameras: int
    ) -> list[DepthView]:
        """What all of `num_cameras` see but the first, as it would be stored.

        Camera k is drawn of the seed and its number, and so the same however many there are.
        """
        views = []
        for number in range(1, num_cameras):
            rng = np.random.default_rng((*seed, number, 5))
            camera, image = self.look(poses, is_placed, rng)
            views.append(
                DepthView(depth_of(depth_bytes(image.depth), camera.width, camera.height), camera)
            )
        return views

    def views(
        self, poses: np.ndarray, is_placed: np.ndarray, cameras: list[Camera]
    ) -> list[DepthView]:
        """What given cameras see, as it would be stored."""
        data = self._pose(poses, is_placed)
        images = [depth_bytes(self._sensor.sense(data, camera).depth) for camera in cameras]
        return [
            DepthView(depth_of(stored, camera.width, camera.height), camera)
            for stored, camera in zip(images, cameras, strict=True)
        ]

    def draw_cameras(self, seed: tuple[int, ...], num_cameras: int) -> list[Camera]:
        """Cameras that are not looked through first; the first is drawn of the seed itself."""
        seeds = [seed, *((*seed, number) for number in range(1, num_cameras))]
        return [self._draw(self._support, np.random.default_rng(each)) for each in seeds]

    def _pose(self, poses: np.ndarray, is_placed: np.ndarray) -> Any:
        if not hasattr(self._local, "data"):
            self._local.data = self._sensor.make_data()
        self._sensor.pose(self._local.data, poses, is_placed)
        return self._local.data


def check_cameras(num_cameras: int, preset: str) -> None:
    """Refuses more cameras than there are.

    Raises:
      ConfigError: of a preset that does not draw there is one.
    """
    if not 1 <= num_cameras <= MOST_CAMERAS:
        raise ConfigError(f"cameras = {num_cameras}", f"1 to {MOST_CAMERAS}", "cameras=2")
    if num_cameras > 1 and preset != MANY:
        raise ConfigError(
            f"cameras = {num_cameras} of the camera {preset!r}, of which there is one",
            f"1, or pairs that were made with the camera {MANY!r}",
            "cameras=1",
        )


def depth_of(data: bytes, width: int, height: int) -> np.ndarray:
    """f32[H, W], metres, inf where nothing is, from a row's bytes."""
    return metres_of(np.frombuffer(data, "<u2").reshape(height, width), MILLIMETRES)


def depth_bytes(depth: np.ndarray) -> bytes:
    """The inverse of `depth_of`, to the millimetre."""
    whole = np.round(np.where(np.isfinite(depth), depth, 0.0) * MILLIMETRES)
    return np.clip(whole, 0, np.iinfo(np.uint16).max).astype("<u2").tobytes()


def _is_inside(camera: Camera, support: Any) -> bool:
    """Whether a camera is inside one of the support's boxes or convex parts."""
    for part in support.parts:
        planes = ConvexHull(part.vertices).equations
        if (planes[:, :3] @ camera.eye + planes[:, 3] <= 0).all():
            return True
    for box in support.boxes:
        cos = np.cos(box.yaw)
        sin = np.sin(box.yaw)
        x, y, z = camera.eye - np.asarray(box.center)
        local = np.abs([cos * x + sin * y, cos * y - sin * x, z])
        if (local <= np.asarray(box.half_extents)).all():
            return True
    return False
