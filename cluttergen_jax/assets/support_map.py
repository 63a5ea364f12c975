"""Supports and surfaces seen from above: heights on a grid, and where on a top objects may be asked for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.support import MOST_SIDE, Rectangle, SupportAsset, Surface
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import cell_centers, closing, rectangle_corners, rotate_in_plane

VOID = -1e3
"""Height of a cell with nothing under it, metres."""

_CELL = 0.0025
_MOST_CELLS = 2_000_000
_MOST_MAP_CELLS = 40_000
_NARROW_GAP = 0.02
_LOWEST = -0.01


def boxes_of(support: SupportAsset) -> np.ndarray:
    """f64[B, 7]: centre, half extents and yaw of all boxes; world frame, metres, radians."""
    return np.array(
        [(*box.center, *box.half_extents, box.yaw) for box in support.boxes], np.float64
    )


def top_boxes(boxes: np.ndarray, top: float) -> np.ndarray:
    """Those of f64[B, 7] that reach up to the support's top, or to a centimetre below it."""
    return boxes[boxes[:, 2] + boxes[:, 5] - top > _LOWEST]


def ground_heights(boxes: np.ndarray, top: float) -> tuple[np.ndarray, np.ndarray, float]:
    """The highest box over each cell; gaps too narrow to matter, as between planks, are bridged.

    Args:
      boxes: f64[B, 7], from `top_boxes`.
      top: metres.

    Returns:
      f64[W, H], metres above the top, VOID where there is nothing, its border VOID; f64[2], where cell (0, 0)
      begins, world x and y, metres; the side of a cell, metres.
    """
    corners = _corners(boxes)
    low = corners.min(0)
    high = corners.max(0)
    cell = max(_CELL, float(np.sqrt((high - low).prod() / _MOST_CELLS)))
    counts = np.ceil((high - low) / cell - 1e-4).astype(int)
    x, y = np.moveaxis(cell_centers(low, cell, counts), -1, 0)
    height = np.full(x.shape, VOID)
    for box in boxes:
        cos = np.cos(box[6])
        sin = np.sin(box[6])
        along = cos * (x - box[0]) + sin * (y - box[1])
        across = cos * (y - box[1]) - sin * (x - box[0])
        covers = (np.abs(along) <= box[3]) & (np.abs(across) <= box[4])
        height[covers] = np.maximum(height[covers], box[2] + box[5] - top)
    width = int(_NARROW_GAP / cell) + 1
    bridged = closing(np.pad(height, width, constant_values=VOID), width)
    return bridged, low - width * cell, cell


def reach_beyond(
    boxes: np.ndarray, T_region_world: np.ndarray, half_extents: np.ndarray, radius: float
) -> np.ndarray:
    """f64[2]: how far beyond a region's sides objects centred in it can find the support, metres.

    Args:
      boxes: f64[B, 7], from `top_boxes`.
      T_region_world: f[4, 4]; half_extents: f[2], the region's.
      radius: that of the largest object seen from above, metres.
    """
    inverse = np.asarray(T_region_world, np.float64)
    local = _corners(boxes) @ inverse[:2, :2].T + inverse[:2, 3]
    return np.clip(np.abs(local).max(0) - np.asarray(half_extents), 0.0, radius)


def map_cells(half: np.ndarray, finest: float) -> tuple[tuple[float, float], tuple[int, int]]:
    """The sides of a map's cells and their numbers, a border of one cell included.

    The sides are whole numbers of cells, so that cells end where the support does.

    Args:
      half: f64[2], half the map's sides without its border, metres.
      finest: the smallest side of a cell, metres; larger where there would be too many.
    """
    counts = np.ceil(2 * half / max(finest, np.sqrt(4 * half.prod() / _MOST_MAP_CELLS)) - 1e-4)
    cell = (float(2 * half[0] / counts[0]), float(2 * half[1] / counts[1]))
    return cell, (int(counts[0]) + 2, int(counts[1]) + 2)


def _corners(boxes: np.ndarray) -> np.ndarray:
    """f64[4 B, 2]: boxes from above."""
    return np.concatenate([rectangle_corners(box[:2], box[3:5], box[6]) for box in boxes])


_OVERHANG = 0.01
_GRID = 41


class TopBounds(NamedTuple):
    """Where a region's corners may lie: `lower` <= corner @ `axes` <= `upper`, world x and y, metres.

    Attributes:
      axes: f64[2, 2], columns along the sides of the support's own region; lower, upper: f64[2].
    """

    axes: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


def top_bounds_of(support: SupportAsset) -> TopBounds:
    """The smallest rectangle that holds all boxes of the support's top, and a centimetre more.

    Of a support with surfaces of its own, that around the chosen one, in its frame.
    """
    axes = rotate_in_plane(np.eye(2), -support.region.yaw)
    outlines = [box.outline for box in support.level_boxes or support.boxes]
    if support.named:
        outlines = [support.chosen.polygon]
    rim = np.concatenate(outlines) @ axes
    return TopBounds(axes, rim.min(0) - _OVERHANG, rim.max(0) + _OVERHANG)


_OUTSIDE = 0.004


def rim_height(region: Rectangle, support: SupportAsset) -> float:
    """Metres: how high what stands all around a region rises above the top, at its lowest; 0 of open ones."""
    along = np.linspace(-1, 1, _GRID)
    sides = [np.stack([along, np.full(_GRID, sign)], -1) for sign in (-1, 1)]
    rim = np.concatenate([*sides, *(side[:, ::-1] for side in sides)])
    points = region.spread(rim, _OUTSIDE)
    height = np.zeros(len(points))
    for box in support.boxes:
        is_under = Rectangle(box.center[:2], box.half_extents[:2], box.yaw).covers(points)
        height = np.maximum(height, np.where(is_under, box.top - support.top, 0.0))
    return float(height.min())


def check_region(region: Rectangle, support: SupportAsset) -> None:
    """Refuses a region that reaches over the edges of the support's top by more than a centimetre.

    Raises:
      ConfigError: it does.
    """
    reach = top_bounds_of(support)
    corners = region.corners @ reach.axes
    if (corners < reach.lower).any() or (corners > reach.upper).any():
        raise ConfigError(
            f"a region of {_rectangle_text(region)} reaches beyond support {support.name!r}",
            f"a rectangle on its {support.surface or 'top'}, by default {_rectangle_text(support.region)}",
            _hint_for(region, support),
        )


def _rectangle_text(region: Rectangle) -> str:
    (x, y) = region.center
    (half_x, half_y) = region.half_extents
    turned = f", turned by {np.degrees(region.yaw):g} degrees" if region.yaw else ""
    return f"{2 * half_x:g} x {2 * half_y:g} m about ({x:g}, {y:g}){turned}"


def _hint_for(region: Rectangle, support: SupportAsset) -> str:
    """A region of this support's, or the smallest table that the region lies on."""
    width, depth = 2 * np.array(support.region.half_extents)
    smaller = f"region='{width:g}x{depth:g}'"
    reach = np.abs(region.corners).max(0)
    sides = np.ceil(2 * reach * 100 - 1e-6) / 100
    if sides.max() > MOST_SIDE:
        return smaller
    return f"{smaller}, or support='table-{sides[0]:.2f}x{sides[1]:.2f}'"


def check_keep_out(boxes: Sequence[Rectangle], region: Rectangle) -> None:
    """Refuses boxes that leave no place for the centre of any object.

    Raises:
      ConfigError: they do.
    """
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, _GRID)] * 2), -1).reshape(-1, 2)
    places = region.spread(grid)
    if boxes and np.any([box.covers(places) for box in boxes], axis=0).all():
        raise ConfigError(
            f"keep-out boxes {', '.join(map(str, boxes))}",
            "boxes that leave some of the queried region free",
            "smaller ones: X,Y,W,D are a centre and whole sides, in metres",
        )


class SurfaceHeights(NamedTuple):
    """What stands on a surface and what hangs over it, on a grid in the surface's frame.

    Attributes:
      ground: f64[W, H], metres above the surface's plane up to which a cell is filled; VOID where nothing
        carries there; its border is VOID.
      ceiling: f64[W, H], metres up to which the space above that is free; inf under the open sky.
      origin: f64[2], where cell (0, 0) begins, metres; cell: its side, metres.
    """

    ground: np.ndarray
    ceiling: np.ndarray
    origin: np.ndarray
    cell: float

    @property
    def centers(self) -> np.ndarray:
        """f64[W, H, 2]: the middles of the cells, in the surface's frame."""
        return cell_centers(self.origin, self.cell, self.ground.shape)


_AROUND = 0.4
_TOUCH = 0.002


def surface_heights(
    support: SupportAsset, surface: Surface, finest: float = _CELL
) -> SurfaceHeights:
    """A surface's surroundings, by the support's collision, 40 cm beyond its outline.

    What reaches down to the surface, or to what stands on it, raises the ground; the rest hangs over it.

    Args:
      finest: the smallest side of a cell, metres.
    """
    inverse = np.linalg.inv(surface.T_world_surface)
    solids = [
        piece.mesh.transform(inverse[:3, :3], inverse[:3, 3]) for piece in support.collision_pieces
    ]
    solids = [mesh for mesh in solids if mesh.bounds[1, 2] > _LOWEST]
    corners = np.concatenate([mesh.vertices[:, :2] for mesh in solids])
    low = np.maximum(corners.min(0), surface.polygon.min(0) - _AROUND)
    high = np.minimum(corners.max(0), surface.polygon.max(0) + _AROUND)
    cell = max(finest, float(np.sqrt((high - low).prod() / _MOST_CELLS)))
    shape = np.ceil((high - low) / cell - 1e-4).astype(int)
    ground = np.full(shape, VOID)
    ceiling = np.full(shape, np.inf)
    spans = [_span(mesh, low, cell, shape) for mesh in solids]
    while True:
        before = ground.copy()
        for window, under, over in spans:
            reaches = (under <= np.maximum(ground[window], 0.0) + _TOUCH) & (over > _LOWEST)
            ground[window] = np.where(reaches, np.maximum(ground[window], over), ground[window])
        if (ground == before).all():
            break
    for window, under, over in spans:
        hangs = (under > np.maximum(ground[window], 0.0) + _TOUCH) & np.isfinite(over)
        ceiling[window] = np.where(hangs, np.minimum(ceiling[window], under), ceiling[window])
    width = int(_NARROW_GAP / cell) + 1
    ground = closing(np.pad(ground, width, constant_values=VOID), width)
    ceiling = np.pad(ceiling, width, constant_values=np.inf)
    return SurfaceHeights(ground, ceiling, low - width * cell, cell)


def _span(
    mesh: Mesh, origin: np.ndarray, cell: float, shape: np.ndarray
) -> tuple[tuple[slice, slice], np.ndarray, np.ndarray]:
    """Of a convex mesh the window of cells that it is over, and its lower and upper height in each."""
    first = np.clip(np.floor((mesh.bounds[0, :2] - origin) / cell).astype(int), 0, shape - 1)
    last = np.clip(np.ceil((mesh.bounds[1, :2] - origin) / cell).astype(int), first + 1, shape)
    lower = origin + cell * first
    upper = origin + cell * last
    over = look_down(mesh, lower, upper, last - first).height
    under = -look_down(mesh.transform(np.diag([1.0, 1.0, -1.0])), lower, upper, last - first).height
    return (slice(first[0], last[0]), slice(first[1], last[1])), under, over


def free_height(heights: SurfaceHeights, region: Rectangle) -> float:
    """Metres from a surface up to the lowest thing over a region of it; inf under the open sky."""
    is_over = region.covers(heights.centers)
    return float(heights.ceiling[is_over].min(initial=np.inf))


# The steepest slope that still counts as level: 2 degrees.
_LEVEL_COSINE = np.cos(np.radians(2.0)).item()

Span = tuple[int, int, int, int]
"""A rectangle of cells: x from, x to, y from, y to; ends are exclusive."""


@dataclass(frozen=True, eq=False)
class Overhead:
    """The highest surface over the centre of each cell."""

    origin: np.ndarray  # f64[2], the grid's lower corner, metres.
    cell: np.ndarray  # f64[2], a cell's sides, metres.
    height: np.ndarray  # f64[X, Y], metres; -inf where nothing is.
    is_level: np.ndarray  # bool[X, Y], whether the highest surface there is horizontal.


def level_faces(mesh: Mesh) -> np.ndarray:
    """bool[F]: horizontal triangles, whichever side they were drawn from."""
    return np.abs(mesh.normals[:, 2]) > _LEVEL_COSINE * np.maximum(mesh.areas, 1e-15)


def look_down(mesh: Mesh, lower: np.ndarray, upper: np.ndarray, shape: np.ndarray) -> Overhead:
    """Looks at a mesh from above.

    Args:
      mesh: its triangles may overlap and need not close.
      lower, upper: f64[2], corners of the rectangle to look at; the grid fills it exactly.
      shape: i[2], cells along x and y, at least one each.
    """
    cell = (upper - lower) / shape
    height = np.full(shape, -np.inf)
    is_level = np.zeros(shape, bool)
    level = level_faces(mesh)
    for face, window, over, is_hit in cells_below(mesh, lower, upper, shape):
        # Of two surfaces at the same height the level one counts: an edge must not hide a top.
        above = (over > height[window] + 1e-6) | (
            (over > height[window] - 1e-6) & bool(level[face])
        )
        is_hit &= above
        height[window] = np.where(is_hit, np.maximum(over, height[window]), height[window])
        is_level[window] = np.where(is_hit, level[face], is_level[window])
    return Overhead(np.asarray(lower, np.float64), cell, height, is_level)


def cells_below(
    mesh: Mesh, lower: np.ndarray, upper: np.ndarray, shape: np.ndarray
) -> Iterator[tuple[int, tuple[slice, slice], np.ndarray, np.ndarray]]:
    """Of each triangle that is not upright and covers the centre of a cell: its index, a window of cells,
    its plane's height over each, and bool, which of them it covers.

    The arguments are those of `look_down`.
    """
    cell = (upper - lower) / shape
    triangles = mesh.corners
    spots = (triangles[:, :, :2] - lower) / cell - 0.5
    first = np.maximum(np.ceil(spots.min(1) - 1e-6), 0).astype(int)
    last = np.minimum(np.floor(spots.max(1) + 1e-6), shape - 1).astype(int)
    upright = np.abs(mesh.normals[:, 2]) < 1e-14
    for face in np.flatnonzero((first <= last).all(1) & ~upright).tolist():
        window = slice(first[face, 0], last[face, 0] + 1), slice(first[face, 1], last[face, 1] + 1)
        yield face, window, *_cover(spots[face], triangles[face, :, 2], first[face], last[face])


def _cover(
    corners: np.ndarray, z: np.ndarray, first: np.ndarray, last: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The height of one triangle's plane, its corners in cells, over cells, and whose centres it covers."""
    x, y = np.meshgrid(
        np.arange(first[0], last[0] + 1), np.arange(first[1], last[1] + 1), indexing="ij"
    )
    (bx, by) = corners[1] - corners[0]
    (cx, cy) = corners[2] - corners[0]
    px = x - corners[0, 0]
    py = y - corners[0, 1]
    area = bx * cy - by * cx
    u = (px * cy - py * cx) / area
    v = (bx * py - by * px) / area
    over = z[0] + u * (z[1] - z[0]) + v * (z[2] - z[0])
    return over, (u >= -1e-6) & (v >= -1e-6) & (u + v <= 1 + 1e-6)


def largest_rectangle(mask: np.ndarray) -> Span:
    """The largest all-True rectangle of a bool[X, Y].

    Row by row, the lengths of the True runs that end there form a histogram whose largest rectangle a stack
    finds in one pass. (0, 0, 0, 0) if nothing is True.
    """
    best = (0, 0, 0, 0)
    best_area = 0
    run = np.zeros(mask.shape[1] + 1, int)
    for x, row in enumerate(mask):
        run[:-1] = np.where(row, run[:-1] + 1, 0)
        stack: list[tuple[int, int]] = []
        for y, length in enumerate(run.tolist()):
            start = y
            while stack and stack[-1][1] >= length:
                start, tall = stack.pop()
                if tall * (y - start) > best_area:
                    best_area = tall * (y - start)
                    best = (x + 1 - tall, x + 1, start, y)
            stack.append((start, length))
    return best


def cover(mask: np.ndarray, missing: float = 0.005, limit: int = 40) -> list[Span]:
    """Disjoint rectangles inside a bool[X, Y], largest first.

    Args:
      missing: share of the True cells that may stay uncovered.
      limit: rectangles at most.
    """
    rest = mask.copy()
    spans: list[Span] = []
    allowed = missing * mask.sum()
    while rest.sum() > allowed and len(spans) < limit:
        span = largest_rectangle(rest)
        spans.append(span)
        rest[span[0] : span[1], span[2] : span[3]] = False
    return spans
