"""What a camera's depth image tells a placer: from an image to a query."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cluttergen_jax.downstream.noise import NOISE_OFF, NoiseConfig, noisy
from cluttergen_jax.downstream.placer.query import CELL, NUM_POINTS, PlacementQuery
from cluttergen_jax.downstream.placer.scene_cameras import DepthView
from cluttergen_jax.placement import VOID, HeightMap, Problem, UnderSide
from cluttergen_jax.sensing import Camera, Grid, PartialMap, level_camera, merge_maps

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
      grid: the cells of its maps.
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
        self._half = np.asarray(problem.region.half_extents, np.float32)

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
            region_half_extents=self._half,
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
                self.grid.corner, self.grid.cell, found.height.shape, self._half, strict=True
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
