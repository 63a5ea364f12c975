"""The height map that a camera can make of what stands on a support: what is seen, what may be hidden."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from cluttergen_jax.assets.support import Rectangle, SupportAsset
from cluttergen_jax.assets.support_map import (
    VOID,
    boxes_of,
    ground_heights,
    map_cells,
    reach_beyond,
    surface_heights,
    top_boxes,
)
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import yaw_matrix
from cluttergen_jax.sensing.camera import Camera

CELL = 0.01
"""Side of a cell, metres."""
SEEN_WITHIN = 0.01
"""A cell is seen where what may be hidden in it is no higher above what is seen than this, metres."""

_MAX_HEIGHT = 0.40
_STEP = 0.01
_SAME_SURFACE = 0.03
_BELOW = -0.02
_RUN = 1024
_HOLE = 2
_NEAR_TOP = 0.02
_ON_TOP = 0.005
_FEWEST_ON_TOP = 50
_MOST_SHIFT = 0.01
_MOST_SLOPE = 0.035


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells over a region, and the bare support in them. W x H cells.

    Attributes:
      T_world_region: f64[4, 4], origin at the region's centre on the support's top, z up, metres.
      bare: f32[W, H], the support's own height above its top, VOID off it and in the border; axis 0 runs
        along the region's x, axis 1 along its y.
      corner: f32[2], where cell (0, 0) begins, region frame, metres.
      cell: the sides of a cell, metres.
    """

    T_world_region: np.ndarray
    bare: np.ndarray
    corner: np.ndarray
    cell: tuple[float, float]

    @staticmethod
    def of(
        support: SupportAsset, radius: float, region: Rectangle | None = None, cell: float = CELL
    ) -> Grid:
        """The cells over a region, and beyond it by an object's radius where the support goes on.

        Args:
          radius: of the largest object seen from above, metres; the map is as large as that of
            `placement.heightmap.HeightMapper` for the same one.
          region: the support's own if None.
          cell: the smallest side of a cell, metres.
        """
        if not 0.001 <= cell <= 0.1 or radius < 0:
            raise ConfigError(
                f"cells of {cell} m, radius {radius} m", "0.001 to 0.1 m, a radius from 0 on"
            )
        region = region or support.region
        T = np.eye(4)
        T[:3, :3] = yaw_matrix(region.yaw)
        T[:3, 3] = (*region.center, support.top)
        T_map_region = T
        if support.named:
            T_map_region = T * np.array([1, 1, 0, 1])[:, None] + np.diag([0, 0, 1, 0])
            T = support.chosen.T_world_surface @ T_map_region
            height, _, low, side = surface_heights(support, support.chosen)
            middle = np.array(height.shape) * side / 2
            boxes = np.array([[*(low + middle), 0.0, *middle, 0.0, 0.0]])
        else:
            boxes = top_boxes(boxes_of(support), support.top)
            height, low, side = ground_heights(boxes, support.top)
        half = np.array(region.half_extents, np.float64)
        sides, shape = map_cells(
            half + reach_beyond(boxes, np.linalg.inv(T_map_region), half, radius), cell
        )
        corner = -np.array(shape) / 2 * sides
        x, y = (corner[axis] + sides[axis] * (np.arange(shape[axis]) + 0.5) for axis in (0, 1))
        xy = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
        index = ((xy @ T_map_region[:2, :2].T + T_map_region[:2, 3] - low) / side).astype(int)
        i, j = (np.clip(index[..., k], 0, height.shape[k] - 1) for k in (0, 1))
        bare = np.full(shape, VOID, np.float32)
        bare[1:-1, 1:-1] = height[i, j][1:-1, 1:-1]
        return Grid(T, bare, corner.astype(np.float32), sides)

    @cached_property
    def columns(self) -> np.ndarray:
        """f64[W, H, 3]: the cells' middles on the top, world frame."""
        x, y = (
            self.corner[axis] + self.cell[axis] * (np.arange(self.bare.shape[axis]) + 0.5)
            for axis in (0, 1)
        )
        flat = np.stack([*np.meshgrid(x, y, indexing="ij"), np.zeros(self.bare.shape)], axis=-1)
        return flat @ self.T_world_region[:3, :3].T + self.T_world_region[:3, 3]


@dataclass(frozen=True, eq=False)
class PartialMap:
    """What one view, or several, tell of the heights over a region.

    Attributes:
      grid: the cells.
      height: f32[W, H], metres above the top: the highest surface seen in each cell; 0 where the bare top is
        seen or assumed, VOID off the support.
      ceiling: f32[W, H], at least `height`: all above it has been seen to be empty.
      count: i32[W, H], pixels that show something in the cell.
    """

    grid: Grid
    height: np.ndarray
    ceiling: np.ndarray
    count: np.ndarray

    @staticmethod
    def of(
        depth: np.ndarray,
        camera: Camera,
        grid: Grid,
        *,
        max_height: float = _MAX_HEIGHT,
        median: int = 1,
        least_pixels: int = 1,
    ) -> PartialMap:
        """The map of one depth image.

        Args:
          depth: f32[H, W], metres along the optical axis; inf: nothing is there; nan: nothing was measured.
            Holes of a pixel or two hide what is behind the nearest of their neighbours, larger ones all.
          max_height: nothing is taken to be higher above the top, metres: the ceiling of what is not seen.
          median: side of the median filter that noisy depths go through first, pixels, odd; 1 is none.
          least_pixels: as many pixels have to show at least the height that a cell is given, so that a stray
            one makes no surface; 1 takes the highest.
        """
        from scipy.ndimage import median_filter

        if depth.shape != (camera.height, camera.width):
            raise ConfigError(
                f"a depth image of {depth.shape}", f"{(camera.height, camera.width)}, the camera's"
            )
        closed = _close_holes(depth)
        if median > 1:
            closed = np.where(
                np.isnan(closed),
                np.nan,
                median_filter(np.where(np.isnan(closed), np.inf, closed), median, mode="nearest"),
            )
        measured = np.where(np.isnan(depth), np.nan, closed)
        height, count = _surface_heights(measured, camera, grid, max_height, least_pixels)
        ceiling = np.maximum(_carve_space(closed, camera, grid, max_height), height)
        ceiling = np.where(grid.bare <= VOID, height, ceiling)
        return PartialMap(grid, height, ceiling.astype(np.float32), count)

    @property
    def is_seen(self) -> np.ndarray:
        """bool[W, H]: cells in which nothing much can be hidden."""
        return self.ceiling - self.height <= SEEN_WITHIN


def merge_maps(maps: Sequence[PartialMap]) -> PartialMap:
    """One map of several views of the same scene over the same grid."""
    height = np.max([one.height for one in maps], axis=0)
    ceiling = np.maximum(np.min([one.ceiling for one in maps], axis=0), height)
    count = np.sum([one.count for one in maps], axis=0)
    return replace(maps[0], height=height, ceiling=ceiling, count=count)


def level_camera(depth: np.ndarray, camera: Camera, grid: Grid) -> Camera:
    """The camera moved a little in height, pitch and roll, so that the bare top that it sees lies level at 0.

    The top is known, so most of the error of a camera's stated pose can be computed from it (least squares
    with weights that end at a distance, Tukey's). Returned as it was where too little of the top is seen,
    where more of what is seen lies at 0 as it is, or where it would move by more than 1 cm or turn by more
    than two degrees: then it looks at something else. Large flat things a few millimetres thick are taken for
    the top in part, and so are best left to a camera whose pose is known.

    Args:
      depth: f32[H, W], metres; nan and inf are left out.
    """
    from scipy.spatial.transform import Rotation

    T = grid.T_world_region
    half = np.abs(grid.corner) - grid.cell
    points = camera.points(depth)[np.isfinite(depth)]
    local = (points - T[:3, 3]) @ T[:3, :3]
    local = local[(np.abs(local[:, :2]) < half).all(1) & (np.abs(local[:, 2]) < _NEAR_TOP)]
    design = np.column_stack([local[:, :2], np.ones(len(local))])
    plane = np.zeros(3)
    for limit in (_NEAR_TOP, _NEAR_TOP / 2, _ON_TOP, _ON_TOP, _ON_TOP):
        weight = np.clip(1 - ((local[:, 2] - design @ plane) / limit) ** 2, 0.0, None)
        if (weight > 0).sum() < _FEWEST_ON_TOP:
            return camera
        plane = np.linalg.lstsq(design * weight[:, None], local[:, 2] * weight, rcond=None)[0]
    on_plane = np.abs(local[:, 2] - design @ plane) < _ON_TOP / 2
    is_far = abs(plane[2]) > _MOST_SHIFT or np.linalg.norm(plane[:2]) > _MOST_SLOPE
    if is_far or on_plane.sum() <= (np.abs(local[:, 2]) < _ON_TOP / 2).sum():
        return camera
    # The turn that takes the plane's normal to the vertical, about the middle of the region.
    turn = Rotation.from_rotvec([plane[1], -plane[0], 0.0]).inv().as_matrix()
    correction = np.eye(4)
    correction[:3, :3] = turn
    correction[2, 3] = -plane[2]
    return replace(camera, T_world_camera=T @ correction @ np.linalg.inv(T) @ camera.T_world_camera)


def _close_holes(depth: np.ndarray) -> np.ndarray:
    """f[H, W]: holes up to two pixels from something measured show the nearest of what is around them."""
    from scipy.ndimage import maximum_filter, minimum_filter

    for _ in range(_HOLE):
        hole = np.isnan(depth)
        if not hole.any():
            break
        around = minimum_filter(np.where(hole, np.inf, depth), 3, mode="nearest")
        known = maximum_filter(~hole, 3, mode="nearest")
        depth = np.where(hole, np.where(known, around, np.nan), depth)
    return depth


def _surface_heights(
    depth: np.ndarray, camera: Camera, grid: Grid, max_height: float, least_pixels: int
) -> tuple[np.ndarray, np.ndarray]:
    """f32[W, H], the highest surface seen in each cell; i32[W, H], how many pixels show one."""
    T = grid.T_world_region
    points = camera.points(depth)[np.isfinite(depth)]
    local = (points - T[:3, 3]) @ T[:3, :3]
    index = np.floor((local[:, :2] - grid.corner) / grid.cell).astype(int)
    shape = grid.bare.shape
    is_here = ((index >= 1) & (index < np.array(shape) - 1)).all(1)
    is_here &= (local[:, 2] > _BELOW) & (local[:, 2] <= max_height)
    cells = np.ravel_multi_index(tuple(index[is_here].T), shape)
    z = local[is_here, 2].astype(np.float32)
    count = np.bincount(cells, minlength=grid.bare.size)
    highest = _height_of_rank(cells, z, count, least_pixels)
    return np.maximum(grid.bare, highest.reshape(shape)), count.reshape(shape).astype(np.int32)


def _height_of_rank(cells: np.ndarray, z: np.ndarray, count: np.ndarray, rank: int) -> np.ndarray:
    """f32[C]: the `rank`-th highest of each cell's points, the lowest where there are fewer, VOID of none.

    Args:
      cells: i[N], of each point; z: f32[N], its height; count: i[C], points of each cell.
    """
    found = np.full(len(count), VOID, np.float32)
    for place in range(rank):
        highest = np.full(len(count), VOID, np.float32)
        np.maximum.at(highest, cells, z)
        found = np.where(count > place, highest, found)
        if place + 1 < rank:
            # One point of each cell that is as high is taken away.
            (top,) = np.nonzero(z == highest[cells])
            one = np.full(len(count), -1)
            one[cells[top]] = top
            is_left = np.ones(len(z), bool)
            is_left[one[one >= 0]] = False
            cells = cells[is_left]
            z = z[is_left]
    return found


def _carve_space(depth: np.ndarray, camera: Camera, grid: Grid, max_height: float) -> np.ndarray:
    """f32[W, H]: the lowest height above each cell's middle from which on everything is seen to be empty.

    Points above the cell's middle are projected into the picture; one is empty if it is nearer than what the
    picture shows there (space carving by one view). Above the field of view a column is as empty as where it
    leaves it, if it is nearer than what the picture's edge shows beside it: what stands there would be cut by
    the edge, and nothing floats.
    """
    heights = np.arange(0.0, max_height + _STEP, _STEP, dtype=np.float32)
    project = camera.K @ camera.rotation.T
    base = ((grid.columns.reshape(-1, 3) - camera.eye) @ project.T).astype(np.float32)
    rise = (project @ grid.T_world_region[:3, 2]).astype(np.float32)
    depth = np.asarray(depth, np.float32)
    # So many at a time that they stay in the processor's cache.
    runs = np.array_split(base, -(-len(base) // _RUN))
    lowest = [_lowest_empty(depth, run, rise, heights) for run in runs]
    return np.concatenate(lowest).reshape(grid.bare.shape)


def _lowest_empty(
    depth: np.ndarray, base: np.ndarray, rise: np.ndarray, heights: np.ndarray
) -> np.ndarray:
    """f32[C]: `_carve_space` of some columns.

    Args:
      base: f32[C, 3], their feet in homogeneous pixels; rise: f32[3], what a metre upwards adds.
      heights: f32[Z], metres, evenly spaced from 0.
    """
    x, y, near = (base[:, k] + rise[k] * heights[:, None] for k in range(3))
    ahead = 1 / np.maximum(near, 1e-6)
    shown, is_in_view = _interpolate_depth(depth, x * ahead, y * ahead)
    is_in_view &= near > 1e-6
    # What was not measured hides; nan compares as False.
    room = shown - near
    is_before = room > 0
    is_empty = is_before & is_in_view
    cells = np.arange(room.shape[1])
    highest = len(heights) - 1 - np.argmax(is_in_view[::-1], axis=0)
    is_above = np.arange(len(heights))[:, None] > highest
    is_empty |= is_above & is_before & is_empty[highest, cells]
    first = len(heights) - np.argmin(is_empty[::-1], axis=0)
    first = np.where(is_empty.all(0), 0, first)
    return _crossing(room, shown, first, heights)


def _crossing(
    room: np.ndarray, shown: np.ndarray, first: np.ndarray, heights: np.ndarray
) -> np.ndarray:
    """f32[C]: where between two samples emptiness begins, if both lie before the same surface."""
    cells = np.arange(room.shape[1])
    above = np.minimum(first, len(heights) - 1)
    below = np.maximum(first - 1, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        is_same = np.abs(shown[above, cells] - shown[below, cells]) < _SAME_SURFACE
        share = room[above, cells] / (room[above, cells] - room[below, cells])
    is_between = is_same & (above > below) & np.isfinite(share)
    return heights[above] - np.where(is_between, _STEP * np.clip(share, 0.0, 1.0), 0.0).astype(
        np.float32
    )


def _interpolate_depth(
    depth: np.ndarray, x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Depths at places in the picture, pixels; where neighbours differ much, the nearest of them.

    Returns:
      f32[...], nan where one of the neighbours was not measured; bool[...], whether it is in the picture.
    """
    height, width = depth.shape
    is_inside = (x >= 0) & (x <= width) & (y >= 0) & (y <= height)
    x = np.clip(x - 0.5, 0, width - 1)
    y = np.clip(y - 0.5, 0, height - 1)
    j = np.minimum(x.astype(np.int32), width - 2)
    i = np.minimum(y.astype(np.int32), height - 2)
    flat = np.asarray(depth, np.float32).ravel()
    index = (i * width + j).astype(np.intp)
    a, b, c, d = (flat[more:].take(index) for more in (0, 1, width, width + 1))
    low = np.minimum(np.minimum(a, b), np.minimum(c, d))
    high = np.maximum(np.maximum(a, b), np.maximum(c, d))
    u = x - j
    v = y - i
    with np.errstate(invalid="ignore"):
        mixed = (a * (1 - u) + b * u) * (1 - v) + (c * (1 - u) + d * u) * v
        return np.where(high - low < _SAME_SURFACE, mixed, low), is_inside
