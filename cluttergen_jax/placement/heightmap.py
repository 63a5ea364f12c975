"""The free space over a queried region: the height of whatever lies under each cell of a grid.

Pure geometry, no physics: the placed objects' upper surfaces and the support's boxes.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.assets.support_map import VOID, map_cells, reach_beyond
from cluttergen_jax.placement.region import Region, from_pose
from cluttergen_jax.placement.support_map import make_support_map, top_boxes_of
from cluttergen_jax.placement.types import Geometry, SupportMap
from cluttergen_jax.types import Array

_FINEST_CELL = 0.0072
_OWNER_BITS = 8
_DEEPEST = 1_000_000


class HeightMap(struct.PyTreeNode):
    """Heights above the support's top, region frame.

    Attributes:
      height: f32[W, H], metres: the highest surface over each cell, 0 on the bare top, VOID off the support.
        Axis 0 runs along the region's x, axis 1 along its y. The cells of the border are VOID.
      corner: f32[2], where cell (0, 0) begins in the region frame, metres.
      cell: the sides of a cell, metres.
      owner: i32[W, H], whose surface that is, K for the support; None unless asked for.
      ceiling: f32[W, H], metres up to which the support leaves room; None where nothing of it hangs over.
    """

    height: Array
    corner: Array
    cell: tuple[float, float] = struct.field(pytree_node=False)
    owner: Array | None = None
    ceiling: Array | None = None

    def index_of(self, x: Array, y: Array) -> Array:
        """i32[...]: the cells of points f32[...] in the flattened map; off the map, one of its border."""
        shape = self.height.shape
        # Clipped before it is cut to whole numbers, so that nothing negative is rounded towards zero.
        i = jnp.clip((x - self.corner[0]) * (1 / self.cell[0]), 0.0, shape[0] - 1.0).astype(
            jnp.int32
        )
        j = jnp.clip((y - self.corner[1]) * (1 / self.cell[1]), 0.0, shape[1] - 1.0).astype(
            jnp.int32
        )
        return i * shape[1] + j

    def at(self, index: Array) -> Array:
        """f32[...]: the heights of cells i32[...] from `index_of`."""
        return self.height.reshape(-1).at[index].get(mode="clip")

    def owner_at(self, index: Array) -> Array:
        """i32[...]: whose surface the cells i32[...] show."""
        assert self.owner is not None
        return self.owner.reshape(-1).at[index].get(mode="clip")


class HeightMapper(struct.PyTreeNode):
    """Makes height maps of scenes on one support.

    Attributes:
      geometry: of the world; support_map: of its support.
      cell: the sides of a map's cell, metres; shape: the number of cells along each.
    """

    geometry: Geometry
    support_map: SupportMap
    cell: tuple[float, float] = struct.field(pytree_node=False)
    shape: tuple[int, int] = struct.field(pytree_node=False)

    @staticmethod
    def of(geometry: Geometry, region: Region, radius: float | None = None) -> HeightMapper:
        """Reads the arrays of `geometry`, outside `jit`.

        Args:
          region: the usual region. Maps are as large as it is, and wider by an object's radius where the
            support goes on; regions up to that size are wholly mapped.
          radius: metres, that of the largest object seen from above; its own if None. Worlds on one support
            that are given the same one have maps of the same size.
        """
        if radius is None:
            found = geometry if geometry.orientations is None else geometry.orientations
            radius = np.linalg.norm(np.asarray(found.half_extents)[..., :2], axis=-1).max()
        half = np.asarray(region.half_extents, np.float64)
        support_map = make_support_map(geometry)
        inverse = np.asarray(support_map.first.place(region.T_world_region).inverse().as_matrix())
        reach = reach_beyond(top_boxes_of(geometry), inverse, half, radius)
        if support_map.height.ndim > 2:
            # One size for the maps of several surfaces.
            reach = np.full(2, radius)
        cell, shape = map_cells(half + reach, _FINEST_CELL)
        return HeightMapper(geometry, support_map, cell, shape)

    def __call__(
        self, region: Region, poses: Array, is_placed: Array, with_owner: bool = False
    ) -> HeightMap:
        """The map of one scene: poses f32[K, 7], world; is_placed bool[K].

        With owners, heights are whole micrometres.
        """
        corner = -jnp.array(self.shape, jnp.float32) / 2 * jnp.array(self.cell)
        bare = self._bare(region, corner)
        # Poses of objects that are not placed may be anything.
        T_world_object = from_pose(jnp.where(is_placed[:, None], poses, jnp.eye(7)[3]))
        T_region_object = region.T_world_region.inverse() @ T_world_object
        surface, owner = self.geometry.surfaces_at(poses)
        turn = T_region_object.rotation().as_matrix()[owner]
        shift = T_region_object.translation()[owner]
        points = jnp.moveaxis(surface, -1, 0)
        x, y, z = (
            sum(turn[:, axis, k, None] * points[k] for k in range(3)) + shift[:, axis, None]
            for axis in range(3)
        )
        index = bare.index_of(x, y)
        height = jnp.where(is_placed[owner][:, None], z, VOID)
        if bare.ceiling is not None:
            # What lies on a board above is none of this surface's obstacles.
            height = jnp.where(
                z > bare.ceiling.reshape(-1).at[index].get(mode="clip"), VOID, height
            )
        if with_owner:
            return self._with_owner(bare, index, height, owner)
        raised = bare.height.reshape(-1).at[index.reshape(-1)].max(height.reshape(-1), mode="drop")
        return bare.replace(height=_with_void_border(raised.reshape(self.shape)))

    def _with_owner(self, bare: HeightMap, index: Array, height: Array, owner: Array) -> HeightMap:
        """Height and owner packed into one whole number, so that one pass finds both."""
        nobody = self.geometry.num_objects
        packed = _pack(bare.height, jnp.int32(nobody)).reshape(-1)
        points = _pack(height, owner[:, None])
        packed = (
            packed.at[index.reshape(-1)].max(points.reshape(-1), mode="drop").reshape(self.shape)
        )
        micrometres = packed >> _OWNER_BITS
        owner = packed & (2**_OWNER_BITS - 1)
        height = jnp.where(micrometres <= -_DEEPEST, VOID, micrometres * 1e-6)
        return bare.replace(height=_with_void_border(height), owner=owner)

    def _bare(self, region: Region, corner: Array) -> HeightMap:
        """The heights of the support itself."""
        support_map = self.support_map
        T = support_map.place(region.T_world_region)
        turn = T.rotation().as_matrix()[:2, :2]
        shift = T.translation()[:2] - support_map.corner
        x, y = (
            corner[axis] + self.cell[axis] * (jnp.arange(self.shape[axis]) + 0.5) for axis in (0, 1)
        )
        i, j = (
            jnp.clip(
                ((turn[axis, 0] * x + shift[axis])[:, None] + turn[axis, 1] * y)
                * (1 / support_map.cell),
                0.0,
                support_map.height.shape[axis] - 1.0,
            ).astype(jnp.int32)
            for axis in (0, 1)
        )
        flat = support_map.height.reshape(-1)
        index = i * support_map.height.shape[1] + j
        height = _with_void_border(flat.at[index].get(mode="clip"))
        ceiling = None
        if support_map.ceiling is not None:
            ceiling = support_map.ceiling.reshape(-1).at[index].get(mode="clip")
        return HeightMap(height, corner, self.cell, ceiling=ceiling)


def _pack(height: Array, owner: Array) -> Array:
    """i32[...]: whole micrometres, at most 4 m up, above an owner's number."""
    micrometres = jnp.clip(jnp.round(height * 1e6), -_DEEPEST, 4e6).astype(jnp.int32)
    return (micrometres << _OWNER_BITS) | owner


def _with_void_border(height: Array) -> Array:
    i, j = (jnp.arange(side) for side in height.shape)
    inner = ((i > 0) & (i < height.shape[0] - 1))[:, None] & ((j > 0) & (j < height.shape[1] - 1))
    return jnp.where(inner, height, VOID)
