"""The surfaces of furniture beside its top: found where things can be put down, whatever the mesh is like.

Vertical lines through the cells of a grid cross the mesh layer by layer. A crossing can carry if it is within
10 degrees of level, has 5 cm of air above it (`SURFACE_AIR`), and a cube of 2 to 3 cm can get there from
outside, so that the inside of boards and of closed cabinets has none. Crossings of neighbouring cells that
continue each other are one surface. It counts if the largest rectangle on it is 5 cm wide and 50 cm^2 large
(`SURFACE_WIDTH`, `SURFACE_AREA`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from cluttergen_jax.assets.config import SURFACE_AIR, SURFACE_AREA, SURFACE_WIDTH
from cluttergen_jax.assets.mesh import Mesh, component_labels
from cluttergen_jax.assets.solid import Voxels
from cluttergen_jax.assets.support import Rectangle, Ring, Surface, outline_of_cells
from cluttergen_jax.assets.support_map import Span, cells_below, cover, largest_rectangle
from cluttergen_jax.geometry import box_corners, cell_centers, rotate_in_plane, yaw_matrix

_STEEPEST = math.radians(10.05)
_LEVEL = math.radians(0.5)
_NARROW_GAP = 0.02
_FLAT = 0.003
_PITCH = 0.01
_MOST_CELLS = 300
_VOXELS = 140
_PASSAGE = 0.012
_FEWEST = 4


@dataclass(frozen=True, eq=False)
class FoundSurface:
    """A surface and the cells that it is made of.

    Attributes:
      surface: its name is empty and its free height not known yet.
      mask: bool[X, Y], its cells, in its frame turned by the yaw of its region.
      lower: f64[2], where cell (0, 0) begins; cell: f64[2], its sides, metres.
      thickness: metres of what is below it, 4 cm at most.
    """

    surface: Surface
    mask: np.ndarray
    lower: np.ndarray
    cell: np.ndarray
    thickness: float

    @cached_property
    def plates(self) -> list[np.ndarray]:
        """f64[4, 2] each, in its frame: rectangles that cover it."""
        return [self.corners(span) for span in cover(self.mask)]

    def corners(self, span: Span) -> np.ndarray:
        """f64[4, 2]: the corners of a rectangle of cells, in its frame."""
        return _corners(span, self.lower, self.cell, self.surface.region.yaw)

    def is_on(self, xy: np.ndarray) -> np.ndarray:
        """bool[...]: whether points f64[..., 2] of its frame are on it, a cell from its edge."""
        inner = ndimage.binary_erosion(self.mask, np.ones((3, 3)))
        local = (rotate_in_plane(xy, -self.surface.region.yaw) - self.lower) / self.cell
        index = np.clip(local.astype(int), 0, np.array(self.mask.shape) - 1)
        return (
            inner[index[..., 0], index[..., 1]]
            & (local >= 0).all(-1)
            & (local < self.mask.shape).all(-1)
        )


def _corners(span: Span, lower: np.ndarray, cell: np.ndarray, yaw: float) -> np.ndarray:
    low = lower + cell * (span[0], span[2])
    high = lower + cell * (span[1], span[3])
    return rotate_in_plane(box_corners(low, high), yaw)


def find_surfaces(mesh: Mesh, yaw: float) -> tuple[list[FoundSurface], list[str]]:
    """All surfaces of a piece of furniture that stands on the floor, the highest first.

    Args:
      mesh: metres, z up.
      yaw: radians, the direction of its sides.

    Returns:
      They, and in words what is too small for anything to stand on or is not flat.
    """
    aligned = mesh.transform(yaw_matrix(-yaw), np.zeros(3))
    voxels = Voxels.of(aligned, _VOXELS)
    layers = _Layers.of(aligned, voxels)
    samples = voxels.samples @ yaw_matrix(yaw).T
    found: list[FoundSurface] = []
    notes: list[str] = []
    for spots in layers.patches():
        spots = spots @ yaw_matrix(yaw).T
        where = f"no surface at {spots[:, 2].mean():.2f} m"
        fit = _plane(spots)
        near = np.abs(spots[:, :2] @ fit[:2] + fit[2] - spots[:, 2]) <= _FLAT / 2
        if near.mean() > 0.5:
            # Broken edges are no part of the plane.
            fit = _plane(spots[near])
        slope = math.atan(math.hypot(*fit[:2]))
        if slope < _LEVEL:
            fit = np.array([0.0, 0.0, np.median(spots[:, 2])])
        away = np.abs(spots[:, :2] @ fit[:2] + fit[2] - spots[:, 2])
        if slope > _STEEPEST or np.mean(away > _FLAT) > 0.1:
            notes.append(f"{where}: not flat")
            continue
        several = _measure(mesh, samples, spots[away <= _FLAT], fit, yaw, layers.pitch)
        found += several
        if not several:
            notes.append(
                f"{where}: narrower than {100 * SURFACE_WIDTH:g} cm, or smaller than "
                f"{1e4 * SURFACE_AREA:g} cm^2"
            )
    return sorted(found, key=lambda each: -each.surface.position[2]), notes


def num_cells(size: np.ndarray, pitch: float) -> np.ndarray:
    """i[2]: how many cells of at most `pitch` fill a rectangle."""
    return np.maximum(np.ceil(size / pitch - 1e-9), 1).astype(int)


def without_cracks(mask: np.ndarray) -> np.ndarray:
    """bool[X, Y]: the True cells, with gaps of one cell or two between them closed."""
    closed = ndimage.binary_closing(np.pad(mask, 1), np.ones((3, 3)))
    return np.asarray(closed[1:-1, 1:-1])


def _plane(spots: np.ndarray) -> np.ndarray:
    """f64[3]: the plane z = fit . (x, y, 1) nearest to points."""
    return np.linalg.lstsq(
        np.column_stack([spots[:, :2], np.ones(len(spots))]), spots[:, 2], rcond=None
    )[0]


@dataclass(frozen=True, eq=False)
class _Layers:
    """Where vertical lines through cells of X x Y cross a mesh that is aligned with them, L times at most.

    Attributes:
      z: f64[L, X, Y], ascending, nan where there are fewer.
      carries: bool[L, X, Y].
    """

    lower: np.ndarray
    pitch: float
    z: np.ndarray
    carries: np.ndarray

    @staticmethod
    def of(mesh: Mesh, voxels: Voxels) -> _Layers:
        lower, upper = mesh.bounds[:, :2]
        pitch = max(_PITCH, float((upper - lower).max()) / _MOST_CELLS)
        shape = num_cells(upper - lower, pitch)
        is_level = np.abs(mesh.normals[:, 2]) > math.cos(_STEEPEST) * mesh.areas - 1e-9
        cells = [np.zeros(0, int)]
        heights = [np.zeros(0)]
        level = [np.zeros(0, bool)]
        number = np.arange(shape.prod()).reshape(shape)
        for face, window, over, is_hit in cells_below(mesh, lower, lower + pitch * shape, shape):
            cells.append(number[window][is_hit])
            heights.append(over[is_hit])
            level.append(np.full(len(cells[-1]), is_level[face]))
        cell, height, flat = (np.concatenate(each) for each in (cells, heights, level))
        order = np.lexsort((height, cell))
        cell = cell[order]
        height = height[order]
        flat = flat[order]
        rank = np.arange(len(cell)) - np.searchsorted(cell, cell)
        z = np.full((rank.max(initial=0) + 1, shape.prod()), np.nan)
        carries = np.zeros(z.shape, bool)
        z[rank, cell] = height
        carries[rank, cell] = flat
        above = np.concatenate([z[1:], np.full((1, z.shape[1]), np.nan)])
        carries &= ~(above - z < SURFACE_AIR)
        layers = _Layers(lower, pitch, z.reshape(-1, *shape), carries.reshape(-1, *shape))
        layers.carries[...] &= _is_reached(voxels, layers)
        return layers

    def spots(self) -> np.ndarray:
        """f64[L, X, Y, 3]: the crossings."""
        xy = cell_centers(self.lower, self.pitch, self.z.shape[1:])
        return np.stack(np.broadcast_arrays(xy[..., 0], xy[..., 1], self.z), axis=-1)

    def patches(self) -> list[np.ndarray]:
        """f64[N, 3] each: crossings that carry and continue each other from cell to cell."""
        number = np.full(self.z.shape, -1)
        number[self.carries] = np.arange(self.carries.sum())
        pairs = [np.zeros((0, 2), int)]
        used = np.flatnonzero(self.carries.any((1, 2)))
        for axis, far in product((0, 1), range(1, int(_NARROW_GAP / self.pitch) + 2)):
            reach = far * math.tan(_STEEPEST) * self.pitch + 0.001
            z, own = (np.moveaxis(each, axis + 1, 1) for each in (self.z, number))
            for one, other in product(used, used):
                here = own[one, :-far]
                there = own[other, far:]
                is_one = (
                    (here >= 0) & (there >= 0) & (np.abs(z[one, :-far] - z[other, far:]) <= reach)
                )
                pairs.append(np.stack([here[is_one], there[is_one]], axis=1))
        edges = np.concatenate(pairs)
        label = component_labels(edges, int(self.carries.sum()))
        spots = self.spots()[self.carries]
        groups = [spots[label == each] for each in np.flatnonzero(np.bincount(label) >= _FEWEST)]
        return sorted(groups, key=lambda group: -group[:, 2].mean())


def _is_reached(voxels: Voxels, layers: _Layers) -> np.ndarray:
    """bool[L, X, Y]: whether the air just above a crossing is reached from outside by more than gaps."""
    radius = max(_PASSAGE, 1.5 * voxels.pitch)
    more = math.ceil(radius / voxels.pitch)
    # A cube in place of a ball: its dilations go axis by axis.
    near = ndimage.maximum_filter(np.pad(voxels.surface, 2 * more + 1).view(np.uint8), 2 * more + 1)
    regions, _ = ndimage.label(near == 0)
    outside = (regions == regions[0, 0, 0]).view(np.uint8)
    inner = slice(2 * more + 1, -2 * more - 1)
    reached = (
        ndimage.maximum_filter(outside, 2 * more + 3).view(bool)[inner, inner, inner]
        & voxels.outside
    )
    spots = layers.spots() + np.array([0.0, 0.0, radius + voxels.pitch])
    is_there = np.isfinite(layers.z)
    result = np.zeros(layers.z.shape, bool)
    result[is_there] = reached[voxels.index(spots[is_there])]
    return result


def _measure(
    mesh: Mesh, samples: np.ndarray, spots: np.ndarray, fit: np.ndarray, yaw: float, pitch: float
) -> list[FoundSurface]:
    """The surfaces on the plane z = fit . (x, y, 1) around `spots` that are large enough."""
    surface = Surface("", (0.0, 0.0, float(fit[2])), Rectangle(), (), quaternion=_turn(fit))
    inverse = yaw_matrix(-yaw) @ surface.T_world_surface[:3, :3].T

    def local(points: np.ndarray) -> np.ndarray:
        return (points - surface.position) @ inverse.T

    flat = Mesh(local(mesh.vertices), mesh.faces)
    seeds = local(spots)[:, :2]
    above = samples[:, 2] - samples[:, :2] @ fit[:2] - fit[2]
    risen = local(samples[(above > 0.0) & (above < 2 * SURFACE_AIR)])
    is_low = np.abs(flat.corners[:, :, 2]).max(1) <= _FLAT
    corners = flat.corners[is_low].reshape(-1, 3)[:, :2]
    near = cKDTree(seeds).query(corners)[0] <= 2 * pitch if len(corners) else np.zeros(0, bool)
    # Cell borders fall on the surface's own sides, where it has any.
    ends = np.concatenate([seeds, corners[near]])
    lower = ends.min(0)
    upper = ends.max(0)
    if (upper - lower).min() < SURFACE_WIDTH:
        return []
    shape = np.maximum(np.ceil((upper - lower) / _PITCH - 1e-6), 1).astype(int)
    shape = np.minimum(shape, _MOST_CELLS)
    cell = (upper - lower) / shape
    mask = np.zeros(shape, bool)
    below = np.full(shape, -np.inf)
    upright = Mesh(flat.vertices, flat.faces[flat.corners[:, :, 2].max(1) <= _FLAT])
    for _, window, over, is_hit in cells_below(upright, lower, upper, shape):
        mask[window] |= is_hit & (np.abs(over) <= _FLAT)
        is_under = is_hit & (over < -_FLAT)
        below[window] = np.where(is_under, np.maximum(below[window], over), below[window])
    centers = cell_centers(lower, cell, shape)
    mask &= cKDTree(seeds).query(centers)[0] <= 1.01 * pitch
    mask = without_cracks(mask)
    walls = risen[(risen[:, 2] > _FLAT + 0.001) & (risen[:, 2] < SURFACE_AIR)][:, :2]
    # A wall's inner face lies on a cell's border: it belongs to the cell farther out.
    index = np.floor((walls + 0.001 * np.sign(walls - centers.mean((0, 1))) - lower) / cell)
    index = index[((index >= 0) & (index < shape)).all(1)].astype(int)
    mask[tuple(index.T)] = False
    under = -below[mask & np.isfinite(below)]
    thickness = float(np.clip(np.median(under) if len(under) else 0.0, 0.002, 0.04))
    label, count = ndimage.label(mask)

    def turned(ring: Ring) -> Ring:
        return tuple((float(x), float(y)) for x, y in rotate_in_plane(ring, yaw))

    found = []
    for own in (label == number for number in range(1, count + 1)):
        span = largest_rectangle(own)
        half = cell * (span[1] - span[0], span[3] - span[2]) / 2
        if 2 * half.min() < SURFACE_WIDTH - 1e-9 or 4 * half.prod() < SURFACE_AREA - 1e-9:
            continue
        center = _corners(span, lower, cell, yaw).mean(0)
        region = Rectangle(
            (float(center[0]), float(center[1])), (float(half[0]), float(half[1])), yaw
        )
        outline, *holes = outline_of_cells(own, lower, cell, 1.1 * float(cell.max()))
        rings = turned(outline), tuple(map(turned, holes))
        one = replace(surface, region=region, outline=rings[0], holes=rings[1])
        found.append(FoundSurface(one, own, lower, cell, thickness))
    return found


def _turn(fit: np.ndarray) -> tuple[float, float, float, float]:
    """The smallest turn, wxyz, that takes z to the normal of a plane z = fit . (x, y, 1)."""
    normal = np.array([-fit[0], -fit[1], 1.0]) / math.sqrt(fit[0] ** 2 + fit[1] ** 2 + 1)
    w = math.sqrt((1 + float(normal[2])) / 2)
    return w, float(-normal[1] / (2 * w)), float(normal[0] / (2 * w)), 0.0
