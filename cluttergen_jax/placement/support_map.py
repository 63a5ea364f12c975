"""The support seen from above, and how far objects reach beyond its edge."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from flax import struct

from cluttergen_jax.assets.support_map import VOID, ground_heights, top_boxes
from cluttergen_jax.placement.region import from_pose
from cluttergen_jax.placement.types import Geometry
from cluttergen_jax.types import Array

_HALF = 0.25


class SupportMap(struct.PyTreeNode):
    """The support alone, in the world frame.

    Attributes:
      height: f32[W, H], metres above the top, VOID where there is nothing; its border is VOID.
      corner: f32[2], metres; cell: metres.
    """

    height: Array
    corner: Array
    cell: float = struct.field(pytree_node=False)

    @staticmethod
    def of(geometry: Geometry) -> SupportMap:
        """Reads the arrays of `geometry`, outside `jit`."""
        height, corner, cell = ground_heights(top_boxes_of(geometry), float(geometry.top))
        height, corner = jax.device_put((height.astype(np.float32), corner.astype(np.float32)))
        return SupportMap(height, corner, cell)

    def is_under(self, xy: Array) -> Array:
        """bool[...]: whether the support is below world points f32[..., 2], to half a cell."""
        shape = self.height.shape
        i, j = (
            jnp.clip((xy[..., k] - self.corner[k]) * (1 / self.cell), 0.0, shape[k] - 1.0).astype(jnp.int32)
            for k in (0, 1)
        )
        return self.height.reshape(-1).at[i * shape[1] + j].get(mode="clip") > VOID


def most_beyond(overhang: str) -> float:
    """The share of an object's footprint that may be beyond the edge.

    With "half" it is a quarter: an even body tips where half of it is beyond.
    """
    return {"any": 1.0, "half": _HALF, "none": 0.0}[overhang]


def share_beyond(support_map: SupportMap, xy: Array, is_point: Array) -> Array:
    """f32[...]: the share of some points, world f32[..., P, 2], that the support is not below.

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
    T_world_object = from_pose(poses)
    turn, shift = T_world_object.rotation().as_matrix()[:, :2], T_world_object.translation()[:, None, :2]
    xy = jnp.einsum("kab,kpb->kpa", turn, points) + shift
    return share_beyond(support_map, xy, is_point)


def _footprints(geometry: Geometry, poses: Array) -> tuple[Array, Array]:
    """f32[K, C, 3], object frames, and bool[K, C]: the under-sides of objects as they lie at world poses."""
    found = geometry.orientations
    if found is None:
        points = jnp.concatenate([geometry.column_xy, geometry.column_bottom[..., None]], axis=-1)
        return points, geometry.is_column
    rows, which = jnp.arange(geometry.num_objects), geometry.orientations_at(poses)
    points = jnp.concatenate(
        [found.column_xy[rows, which], found.column_bottom[rows, which][..., None]], axis=-1
    )
    turn = jaxlie.SO3(found.quaternion[rows, which]).as_matrix()
    return jnp.einsum("kpa,kab->kpb", points, turn), found.is_column[rows, which]


def top_boxes_of(geometry: Geometry) -> np.ndarray:
    """f64[B, 7]: the support's boxes that reach up to its top."""
    return top_boxes(np.asarray(geometry.boxes, np.float64), float(geometry.top))
