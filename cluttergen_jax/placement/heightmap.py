"""The free space over a queried region: a height map, and where an object let down onto it would rest.

Pure geometry, no physics: what lies under each cell, from the placed objects' columns and the support's boxes.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import jaxlie
from flax import struct

from cluttergen_jax.placement.region import Region, from_pose
from cluttergen_jax.placement.types import Geometry
from cluttergen_jax.types import Array

CELL = 0.01
MARGIN_CELLS = 2
VOID = -1e3
"""Height of a cell with nothing under it, metres."""


@struct.dataclass
class HeightMap:
    """Heights above the support's top, region frame.

    Attributes:
      height: f32[H, W], metres: the highest surface over each cell, 0 on the bare top, VOID off the support.
        Axis 0 runs along the region's x, axis 1 along its y.
      origin: f32[2], the position of cell (0, 0)'s centre in the region frame, metres.
    """

    height: Array
    origin: Array


def grid_shape(half_extents: tuple[float, float]) -> tuple[int, int]:
    """Cells along x and y for regions up to these half extents (static under `jit`), margin included."""
    counts = [-(-2 * side // CELL) + 2 * MARGIN_CELLS for side in half_extents]
    return int(counts[0]), int(counts[1])


def make_height_map(
    geometry: Geometry, region: Region, poses: Array, is_placed: Array, shape: tuple[int, int]
) -> HeightMap:
    """The height map of a scene.

    Args:
      poses: f32[K, 7], world; is_placed: bool[K]; shape: from `grid_shape`.
    """
    origin = -(jnp.array(shape, jnp.float32) - 1) / 2 * CELL
    axes = [origin[axis] + CELL * jnp.arange(shape[axis]) for axis in (0, 1)]
    cells = jnp.stack(jnp.meshgrid(*axes, indexing="ij"), axis=-1)
    height = _support_height(geometry, region, cells)
    T_region_world = region.T_world_region.inverse()

    def tops(pose: Array, xy: Array, top: Array) -> Array:
        T_region_object = T_region_world @ from_pose(pose)
        return jax.vmap(T_region_object.apply)(jnp.append(xy, top[:, None], axis=1))

    points = jax.vmap(tops)(poses, geometry.column_xy, geometry.column_top)
    counts = geometry.is_column & is_placed[:, None]
    index = jnp.round((points[..., :2] - origin) / CELL).astype(jnp.int32)
    in_grid = jnp.all((index >= 0) & (index < jnp.array(shape)), axis=-1) & counts
    flat = jnp.where(in_grid, index[..., 0] * shape[1] + index[..., 1], shape[0] * shape[1])
    raised = height.ravel().at[flat.ravel()].max(points[..., 2].ravel(), mode="drop")
    return HeightMap(raised.reshape(shape), origin)


def _support_height(geometry: Geometry, region: Region, cells: Array) -> Array:
    """The highest box under each cell, relative to the top: f32[H, W] from f32[H, W, 2]."""
    T = region.T_world_region
    rotation = T.rotation().as_matrix()[:2, :2]
    world = cells @ rotation.T + T.translation()[:2]

    def under(height: Array, box: Array) -> tuple[Array, None]:
        offset = world - box[:2]
        cos, sin = jnp.cos(box[6]), jnp.sin(box[6])
        x = cos * offset[..., 0] + sin * offset[..., 1]
        y = cos * offset[..., 1] - sin * offset[..., 0]
        covers = (jnp.abs(x) <= box[3]) & (jnp.abs(y) <= box[4])
        top = box[2] + box[5] - geometry.top
        return jnp.where(covers & (top > -0.01), jnp.maximum(height, top), height), None

    return jax.lax.scan(under, jnp.full(cells.shape[:2], VOID, jnp.float32), geometry.boxes)[0]


def heights_under(heights: HeightMap, xy: Array) -> Array:
    """The map's height at points, f32[...] from f32[..., 2] in the region frame; VOID off the map."""
    shape = heights.height.shape
    index = jnp.round((xy - heights.origin) / CELL).astype(jnp.int32)
    in_grid = jnp.all((index >= 0) & (index < jnp.array(shape)), axis=-1)
    index = jnp.clip(index, 0, jnp.array(shape) - 1)
    return jnp.where(in_grid, heights.height[index[..., 0], index[..., 1]], VOID)


def columns_at(xy: Array, position: Array, yaw: Array) -> Array:
    """Points of an upright object's frame, f32[C, 2], where they stand in the region frame."""
    return xy @ jaxlie.SO2.from_radians(yaw).as_matrix().T + position
