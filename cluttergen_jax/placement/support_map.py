"""The support seen from above, and how far objects reach beyond its edge."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.support import SupportAsset, Surface
from cluttergen_jax.assets.support_map import (
    VOID,
    SurfaceHeights,
    ground_heights,
    surface_heights,
    top_boxes,
)
from cluttergen_jax.placement.region import from_pose, to_pose
from cluttergen_jax.placement.types import Geometry, SupportMap
from cluttergen_jax.types import Array

_HALF = 0.25


def make_support_map(geometry: Geometry) -> SupportMap:
    """The map of a world's support; reads the arrays of `geometry`, outside `jit`."""
    if geometry.support_map is not None:
        return geometry.support_map
    height, corner, cell = ground_heights(top_boxes_of(geometry), float(geometry.top))
    height, corner = jax.device_put((height.astype(np.float32), corner.astype(np.float32)))
    return SupportMap(height, corner, cell)


def map_of_surfaces(support: SupportAsset) -> SupportMap | None:
    """The map of the surfaces that are asked for, NumPy arrays; None for a flat top without any of its own.

    Those of several have a leading axis, and the same size.
    """
    if not support.named:
        return None
    surfaces = [surface for surface, _ in support.asked]
    found = [surface_heights(support, surface) for surface in surfaces]
    coarsest = max(each.cell for each in found)
    if len(found) > 1:
        found = [surface_heights(support, surface, coarsest) for surface in surfaces]
    shape = np.max([each.ground.shape for each in found], axis=0)
    maps = [_map_of(*each, shape) for each in zip(surfaces, found, strict=True)]
    if all(surface.is_level for surface in surfaces):
        maps = [each.replace(T_map_world=None) for each in maps]
    if not any(np.isfinite(np.asarray(each.ceiling)).any() for each in maps):
        maps = [each.replace(ceiling=None) for each in maps]
    return jax.tree.map(lambda *each: np.stack(each), *maps) if len(maps) > 1 else maps[0]


def map_below(geometry: Geometry, surface: Array | None, focus: Array) -> SupportMap | None:
    """The map of the surface that an object goes on; None for a flat top.

    Args:
      surface: i32[K], `Episode.surface`; focus: i32, the object.
    """
    if geometry.support_map is None or surface is None:
        return geometry.support_map
    return geometry.support_map.of_surface(jnp.maximum(surface[focus], 0))


def _map_of(surface: Surface, found: SurfaceHeights, shape: np.ndarray) -> SupportMap:
    more = [(0, most - own) for most, own in zip(shape, found.ground.shape, strict=True)]
    inverse = np.linalg.inv(surface.T_world_surface)
    turn = Rotation.from_matrix(inverse[:3, :3]).as_quat(scalar_first=True)
    return SupportMap(
        height=np.pad(found.ground, more, constant_values=VOID),
        corner=found.origin,
        cell=found.cell,
        ceiling=np.pad(found.ceiling, more, constant_values=np.inf),
        T_map_world=jaxlie.SE3(jnp.append(jnp.asarray(turn), inverse[:3, 3])),
    )


def on_map(support_map: SupportMap | None, pose: Array) -> Array:
    """f32[7]: a world pose in the frame of a surface that is not level; else as it is."""
    if support_map is None or support_map.T_map_world is None:
        return pose
    return to_pose(support_map.place(from_pose(pose)))


def most_beyond(overhang: str) -> float:
    """The share of an object's footprint that may be beyond the edge.

    With "half" it is a quarter: an even body tips where half of it is beyond.
    """
    return {"any": 1.0, "half": _HALF, "none": 0.0}[overhang]


def share_beyond(support_map: SupportMap, xy: Array, is_point: Array) -> Array:
    """f32[...]: the share of some points of the map, f32[..., P, 2], that the support is not below.

    Args:
      is_point: bool[..., P], those that count.
    """
    is_beyond = is_point & ~support_map.is_under(xy)
    return is_beyond.sum(-1) / jnp.maximum(is_point.sum(-1), 1)


def shares_beyond(support_map: SupportMap, geometry: Geometry, poses: Array) -> Array:
    """f32[K]: the share of each object's footprint beyond the edge, at world poses f32[K, 7].

    The footprint is a sample: its columns, twice as dense along its outline, as in the object's own frame.
    The edge is known to half a cell of `SupportMap`.
    """
    points, is_point = _footprints(geometry, poses)
    T_map_object = support_map.place(from_pose(poses))
    turn = T_map_object.rotation().as_matrix()[:, :2]
    shift = T_map_object.translation()[:, None, :2]
    xy = jnp.einsum("kab,kpb->kpa", turn, points) + shift
    return share_beyond(support_map, xy, is_point)


def _footprints(geometry: Geometry, poses: Array) -> tuple[Array, Array]:
    """f32[K, C, 3], object frames, and bool[K, C]: the under-sides of objects as they lie at world poses."""
    found = geometry.orientations
    if found is None:
        points = jnp.concatenate([geometry.column_xy, geometry.column_bottom[..., None]], axis=-1)
        return points, geometry.is_column
    rows = jnp.arange(geometry.num_objects)
    which = geometry.orientations_at(poses)
    points = jnp.concatenate(
        [found.column_xy[rows, which], found.column_bottom[rows, which][..., None]], axis=-1
    )
    turn = jaxlie.SO3(found.quaternion[rows, which]).as_matrix()
    return jnp.einsum("kpa,kab->kpb", points, turn), found.is_column[rows, which]


def top_boxes_of(geometry: Geometry) -> np.ndarray:
    """f64[B, 7]: the support's boxes that reach up to its top; one around all of the map of a surface."""
    if (found := geometry.support_map) is not None:
        found = found.first
        half = np.array(found.height.shape) * found.cell / 2
        return np.array([[*(np.asarray(found.corner, np.float64) + half), 0.0, *half, 0.0, 0.0]])
    return top_boxes(np.asarray(geometry.boxes, np.float64), float(geometry.top))
