"""What cameras see of a partial scene, and what their images tell a placer: from an image to a query."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from cluttergen_jax.downstream.noise import NOISE_OFF, NoiseConfig, noisy
from cluttergen_jax.downstream.placer.query import CELL, NUM_POINTS, PlacementQuery
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement import VOID, HeightMap, Problem, UnderSide
from cluttergen_jax.sensing import (
    SUPPORT,
    Camera,
    DepthImage,
    Grid,
    PartialMap,
    RaySensor,
    find_preset,
    level_camera,
    merge_maps,
    sensed_model,
)

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
            views.append(_as_stored(image, camera))
        return views

    def views(
        self, poses: np.ndarray, is_placed: np.ndarray, cameras: list[Camera]
    ) -> list[DepthView]:
        """What given cameras see, as it would be stored."""
        data = self._pose(poses, is_placed)
        return [_as_stored(self._sensor.sense(data, camera), camera) for camera in cameras]

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
    whole = np.frombuffer(data, "<u2").reshape(height, width)
    return np.where(whole > 0, whole / np.float32(MILLIMETRES), np.inf).astype(np.float32)


def depth_bytes(depth: np.ndarray) -> bytes:
    """The inverse of `depth_of`, to the millimetre."""
    whole = np.round(np.where(np.isfinite(depth), depth, 0.0) * MILLIMETRES)
    return np.clip(whole, 0, np.iinfo(np.uint16).max).astype("<u2").tobytes()


def _as_stored(image: DepthImage, camera: Camera) -> DepthView:
    return DepthView(depth_of(depth_bytes(image.depth), camera.width, camera.height), camera)


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


_LOWEST = -0.005
_HIGHEST = 0.6
# With noise: of the filter of depths, and pixels that make a surface.
_MEDIAN = 3
_LEAST_PIXELS = 2


class SceneMaps(NamedTuple):
    """What was seen of one scene; region frame, metres.

    Attributes:
      heights, ceilings: f32[W, H], see `PlacementQuery`.
      cloud: f32[2048, 3]; cloud_mask: bool[2048].
      unseen: share of the region's cells that something may be hidden in.
    """

    heights: np.ndarray
    ceilings: np.ndarray
    cloud: np.ndarray
    cloud_mask: np.ndarray
    unseen: float


class QueryMaker:
    """Makes queries of depth images of scenes in one world.

    Args:
      problem: the world and its queried region.

    Attributes:
      grid: the cells of its maps. half_extents: f32[2], half of the region's sides, metres.
    """

    def __init__(self, problem: Problem) -> None:
        geometry = problem.rules.geometry
        self._geometry = {
            name: np.asarray(getattr(geometry, name))
            for name in (
                "half_extents",
                "center_of_mass",
                "own_margin",
                "cloud",
                "column_xy",
                "column_bottom",
                "is_column",
            )
        }
        self._support = problem.world.support
        self._region = problem.region
        self._radius = float(np.linalg.norm(self._geometry["half_extents"][:, :2], axis=1).max())
        self.grid = self.grid_of(CELL)
        self.half_extents = np.asarray(problem.region.half_extents, np.float32)

    def grid_of(self, cell: float) -> Grid:
        """The same part of the top in cells of another size, metres."""
        return Grid.of(self._support, self._radius, self._region, cell)

    @property
    def T_world_region(self) -> np.ndarray:
        """f64[4, 4]."""
        return self.grid.T_world_region

    def see(
        self, depth: np.ndarray, camera: Camera, noise: NoiseConfig, rng: np.random.Generator
    ) -> SceneMaps:
        """What a depth image shows, f32[H, W] in metres along the optical axis, inf where nothing is.

        With noise, the top, which is known, corrects the camera's stated pose (`level_camera` of sensing).
        """
        return self.see_all([(depth, camera)], noise, rng)

    def see_all(
        self,
        views: Sequence[tuple[np.ndarray, Camera]],
        noise: NoiseConfig,
        rng: np.random.Generator,
    ) -> SceneMaps:
        """What several cameras show of the same scene, each with noise of its own.

        `heights` is the highest that any of them saw, `ceilings` the lowest from which on one of them sees
        that all is empty (`sensing.partial.merge_maps`); points are drawn from all of them.
        """
        believed = [self.measure(depth, camera, noise, rng) for depth, camera in views]
        return self.fuse(believed, noise, rng)

    def measure(
        self, depth: np.ndarray, camera: Camera, noise: NoiseConfig, rng: np.random.Generator
    ) -> DepthView:
        """What a camera gives with noise, and where it is believed to stand."""
        if noise == NOISE_OFF:
            return DepthView(depth, camera)
        depth, camera = noisy(depth, camera, noise, rng)
        return DepthView(depth, level_camera(depth, camera, self.grid))

    def partial(
        self, depth: np.ndarray, camera: Camera, noise: NoiseConfig, grid: Grid | None = None
    ) -> PartialMap:
        """The map of one image as it was measured; grid: its cells; the queries' own if not given."""
        grid = grid or self.grid
        if noise == NOISE_OFF:
            return PartialMap.of(depth, camera, grid)
        return PartialMap.of(depth, camera, grid, median=_MEDIAN, least_pixels=_LEAST_PIXELS)

    def fuse(
        self,
        views: Sequence[tuple[np.ndarray, Camera]],
        noise: NoiseConfig,
        rng: np.random.Generator,
    ) -> SceneMaps:
        """As `see_all`, of images as they were measured."""
        found = merge_maps([self.partial(depth, camera, noise) for depth, camera in views])
        cloud = _sample_points(
            np.concatenate([self._points(depth, camera) for depth, camera in views]), rng
        )
        return SceneMaps(found.height, found.ceiling, *cloud, self._unseen(found))

    def query(self, sight: SceneMaps, object_index: int) -> PlacementQuery:
        """The query for one of the world's objects, NumPy arrays."""
        has = {name: array[object_index] for name, array in self._geometry.items()}
        corner = np.asarray(self.grid.corner, np.float32)
        highest = np.float32(sight.heights.max(initial=0.0))
        return PlacementQuery(
            heights=HeightMap(sight.heights, corner, self.grid.cell),
            ceilings=HeightMap(sight.ceilings, corner, self.grid.cell),
            under=UnderSide(
                has["column_xy"], has["column_bottom"], has["is_column"], has["center_of_mass"][:2]
            ),
            half_extents=has["half_extents"],
            center_of_mass=has["center_of_mass"],
            own_margin=has["own_margin"],
            object_cloud=has["cloud"],
            cloud=sight.cloud,
            cloud_mask=sight.cloud_mask,
            region_half_extents=self.half_extents,
            height_range=highest + 2 * has["half_extents"][2],
        )

    def _points(self, depth: np.ndarray, camera: Camera) -> np.ndarray:
        """f64[N, 3]: points on and above the mapped part of the top, region frame."""
        T = self.T_world_region
        points = (camera.points(depth)[np.isfinite(depth)] - T[:3, 3]) @ T[:3, :3]
        beyond = np.abs(points[:, :2]) > np.abs(self.grid.corner)
        return points[~beyond.any(1) & (points[:, 2] > _LOWEST) & (points[:, 2] < _HIGHEST)]

    def _unseen(self, found: PartialMap) -> float:
        x, y = (
            np.abs(corner + cell * (np.arange(number) + 0.5)) < half
            for corner, cell, number, half in zip(
                self.grid.corner, self.grid.cell, found.height.shape, self.half_extents, strict=True
            )
        )
        is_asked = x[:, None] & y & (found.height > VOID)
        return float((~found.is_seen)[is_asked].mean()) if is_asked.any() else 0.0


def _sample_points(points: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """f32[2048, 3], some of the points f64[N, 3], and bool[2048], which count; all where there are fewer."""
    chosen = rng.permutation(len(points))[:NUM_POINTS]
    cloud = np.zeros((NUM_POINTS, 3), np.float32)
    cloud[: len(chosen)] = points[chosen]
    return cloud, np.arange(NUM_POINTS) < len(chosen)
