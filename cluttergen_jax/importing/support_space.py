"""The air over a surface: how much is seen, how much parts leave, and parts cut where the air is seen.

Convex parts of a drawer or a compartment with thin walls fill it. What of them is where the mesh has nothing,
in upright boxes over rectangles of the surface, is cut away, which leaves convex parts around each box.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from cluttergen_jax.assets.config import SURFACE_AIR
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.assets.support import SupportAsset, Surface
from cluttergen_jax.assets.support_map import cells_below, cover, surface_heights
from cluttergen_jax.assets.voxels import Voxels
from cluttergen_jax.geometry import rotate_in_plane
from cluttergen_jax.importing.surfaces import FoundSurface

_START = 0.005
"""Metres over a surface from which on something hangs over it."""
# Of a region: metres from its edges, and the share of it, that do not count.
_INSET = 0.01
_SHARE = 0.02

# Metres, and the share of what is seen, by which parts may leave less.
_LESS = 0.02
_LESS_SHARE = 0.1

_CELL = 0.005
_VOXELS = 140
_INSETS = (0.0, 0.005, 0.01, 0.02)
"""Metres."""
_MOST_COLUMNS = 8
_MISSING = 0.05
_MOST_PARTS = 400
# Metres and cubic metres: thinner and smaller pieces of a part are dropped.
_THIN = 0.001
_GRAIN = 1e-7


@dataclass(frozen=True)
class Air:
    """Metres of free air over a surface: as seen, and as the collision leaves it; inf under the open sky."""

    seen: float
    collided: float

    @property
    def is_short(self) -> bool:
        """Whether the collision fills what is seen free."""
        return self.collided < self.seen - max(_LESS, _LESS_SHARE * min(self.seen, 1.0))


def air_over(mesh: Mesh, support: SupportAsset, surface: Surface) -> Air:
    """The air over the region of a surface, its edges aside; of the lowest places 2 % do not count.

    Args:
      mesh: what is seen of the furniture, world frame; support: with its collision.
    """
    half = np.maximum(np.array(surface.region.half_extents) - _INSET, 1e-3)
    inverse = np.linalg.inv(surface.T_world_surface)
    local = mesh.transform(inverse[:3, :3], inverse[:3, 3])
    turn = np.eye(4)
    turn[:2, :2] = rotate_in_plane(np.eye(2), -surface.region.yaw).T
    aligned = Mesh(local.vertices @ turn[:3, :3].T, local.faces)
    center = rotate_in_plane(np.array(surface.region.center), -surface.region.yaw)
    shape = np.maximum(np.ceil(2 * half / _CELL), 1).astype(int)
    over = np.full(shape, np.inf)
    for _, window, height, is_hit in cells_below(aligned, center - half, center + half, shape):
        hangs = is_hit & (height > _START)
        over[window] = np.where(hangs, np.minimum(over[window], height), over[window])
    heights = surface_heights(support, surface, _CELL)
    x, y = (
        heights.origin[k] + heights.cell * (np.arange(heights.ground.shape[k]) + 0.5)
        for k in (0, 1)
    )
    xy = rotate_in_plane(
        np.stack(np.meshgrid(x, y, indexing="ij"), -1) - surface.region.center, -surface.region.yaw
    )
    is_in = (np.abs(xy) <= half).all(-1)
    left = np.where(heights.ground > _START, 0.0, heights.ceiling)[is_in]
    return Air(_low(over.ravel()), _low(left))


def _low(heights: np.ndarray) -> float:
    return float(np.sort(heights)[int(_SHARE * len(heights))]) if len(heights) else math.inf


def note_of_air(surface: Surface, before: Air, after: Air) -> str:
    """What is to be said of a surface over which the collision fills, or filled, what is seen free."""
    where = f"the surface at {surface.position[2]:.2f} m"
    if after.collided < SURFACE_AIR:
        return (
            f"no surface at {surface.position[2]:.2f} m: {_metres(after.seen)} of air are seen over it, "
            + (f"and its parts leave {_metres(after.collided)}")
        )
    if after.is_short:
        return f"{where}: {_metres(after.seen)} of air are seen over it, and its parts leave " + (
            _metres(after.collided)
        )
    if before.is_short:
        return (
            f"{where}: {_metres(before.seen)} of air are seen over it, and convex parts left "
            f"{_metres(before.collided)}: they were cut, and leave {_metres(after.collided)}"
        )
    return ""


def _metres(height: float) -> str:
    return "all" if math.isinf(height) else f"{height:.2f} m"


@dataclass(frozen=True, eq=False)
class Column:
    """A box of air over a surface.

    Attributes:
      T_world_surface: f64[4, 4]; corners: f64[4, 2], in the surface's frame, counter-clockwise, metres.
      height: metres.
    """

    T_world_surface: np.ndarray
    corners: np.ndarray
    height: float

    @property
    def planes(self) -> list[tuple[np.ndarray, float]]:
        """Normals f64[3] that point out of the box, world frame, and offsets: the board below first."""
        following = np.roll(self.corners, -1, axis=0)
        sides = [
            (
                np.array([y1 - y0, x0 - x1, 0.0]) / math.hypot(x1 - x0, y1 - y0),
                np.array([x0, y0, 0.0]),
            )
            for (x0, y0), (x1, y1) in zip(self.corners, following, strict=True)
        ]
        up = np.array([0.0, 0.0, 1.0])
        local = [(-up, np.zeros(3)), *sides, (up, self.height * up)]
        R = self.T_world_surface[:3, :3]
        shift = self.T_world_surface[:3, 3]
        return [(R @ normal, float(R @ normal @ (R @ point + shift))) for normal, point in local]


def columns_over(samples: np.ndarray, found: FoundSurface, surface: Surface) -> list[Column]:
    """Boxes of air in which nothing of a mesh is, over the largest rectangles of a surface.

    Over what leans over an edge, boxes farther inside are higher.

    Args:
      samples: f64[N, 3], points of the mesh, at most half a centimetre or so apart (`surface_samples`).
    """
    T = surface.T_world_surface
    local = (samples - T[:3, 3]) @ T[:3, :3]
    local = local[local[:, 2] > 2 * _START]
    top = float(local[:, 2].max(initial=0.0)) + 2 * _START
    low = surface.polygon.min(0)
    high = surface.polygon.max(0)
    local = local[((local[:, :2] > low) & (local[:, :2] < high)).all(1)]
    yaw = surface.region.yaw
    flat = rotate_in_plane(local[:, :2], -yaw)
    columns = []
    for span in cover(found.mask, _MISSING, _MOST_COLUMNS):
        ends = rotate_in_plane(found.corners(span), -yaw)
        highest = _LESS
        for inset in _INSETS:
            low = ends.min(0) + inset
            high = ends.max(0) - inset
            if (high - low).min() < _LESS:
                break
            is_over = ((flat > low + _START / 2) & (flat < high - _START / 2)).all(1)
            height = float(local[is_over, 2].min(initial=top)) - _START
            if height > highest:
                corners = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
                columns.append(Column(T, rotate_in_plane(corners, yaw), height))
                highest = height + _START
    return columns


def surface_samples(mesh: Mesh) -> np.ndarray:
    """f64[N, 3]: points of a surface, every point of it near one."""
    return Voxels.of(mesh, _VOXELS).samples


def without_air(parts: list[np.ndarray], columns: list[Column]) -> list[np.ndarray]:
    """Convex parts, f64[V, 3] each, with what is inside of the columns cut away."""
    for column in columns:
        cut = [piece for points in parts for piece in _around(points, column)]
        if len(cut) > _MOST_PARTS:
            break
        parts = cut
    return parts


def _around(points: np.ndarray, column: Column) -> list[np.ndarray]:
    """A part itself if it is not in the box, or the convex pieces of it that are around it."""
    local = (points - column.T_world_surface[:3, 3]) @ column.T_world_surface[:3, :3]
    low = column.corners.min(0)
    high = column.corners.max(0)
    is_beside = (local[:, :2].max(0) <= low).any() or (local[:, :2].min(0) >= high).any()
    if is_beside or local[:, 2].max() <= _THIN or local[:, 2].min() >= column.height:
        return [points]
    rest = Manifold.hull_points(points)
    around = []
    for normal, offset in column.planes:
        outside, rest = rest.split_by_plane(normal, offset)
        around.append(outside)
    if rest.is_empty() or not _is_thick(_corners(rest)):
        return [points]
    corners = [_corners(each) for each in around if not each.is_empty()]
    return [each for each in corners if _is_thick(each)]


def _corners(solid: Manifold) -> np.ndarray:
    return np.array(solid.to_mesh64().vert_properties)[:, :3]


def _is_thick(points: np.ndarray) -> bool:
    hull = hull_of(points) if len(points) > 3 else None
    return hull is not None and hull.volume > max(_GRAIN, _THIN * hull.area / 2)
