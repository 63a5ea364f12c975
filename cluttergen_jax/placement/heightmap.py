"""The free space over a queried region: the height of whatever lies under each cell of a grid.

Pure geometry, no physics: the placed objects' upper surfaces and the support's boxes. The support's own map
tells how far objects reach beyond its edge, too.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from flax import struct

from cluttergen_jax.assets.support import SupportAsset, Surface
from cluttergen_jax.assets.support_map import (
    VOID,
    SurfaceHeights,
    ground_heights,
    map_cells,
    reach_beyond,
    surface_heights,
    top_boxes,
)
from cluttergen_jax.placement.region import Region, from_pose, safe_poses, to_pose
from cluttergen_jax.placement.types import Geometry, SupportMap, cell_index, look_up, take
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
    return take(geometry.support_map, jnp.maximum(surface[focus], 0))


def _map_of(surface: Surface, found: SurfaceHeights, shape: np.ndarray) -> SupportMap:
    from scipy.spatial.transform import Rotation

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
        offset = (x - self.corner[0], y - self.corner[1])
        return cell_index(offset, self.cell, self.height.shape)

    def at(self, index: Array) -> Array:
        """f32[...]: the heights of cells i32[...] from `index_of`."""
        return look_up(self.height, index)

    def owner_at(self, index: Array) -> Array:
        """i32[...]: whose surface the cells i32[...] show."""
        assert self.owner is not None
        return look_up(self.owner, index)


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
        T_map_region = support_map.first.place(region.T_world_region)
        inverse = np.asarray(T_map_region.inverse().as_matrix())
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
        T_world_object = from_pose(safe_poses(poses, is_placed))
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
            height = jnp.where(z > look_up(bare.ceiling, index), VOID, height)
        if with_owner:
            return self._with_owner(bare, index, height, owner)
        cells = index.reshape(-1)
        raised = bare.height.reshape(-1).at[cells].max(height.reshape(-1), mode="drop")
        return bare.replace(height=_with_void_border(raised.reshape(self.shape)))

    def _with_owner(self, bare: HeightMap, index: Array, height: Array, owner: Array) -> HeightMap:
        """Height and owner packed into one whole number, so that one pass finds both."""
        nobody = self.geometry.num_objects
        packed = _pack(bare.height, jnp.int32(nobody)).reshape(-1)
        points = _pack(height, owner[:, None])
        packed = packed.at[index.reshape(-1)].max(points.reshape(-1), mode="drop")
        packed = packed.reshape(self.shape)
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
        x = corner[0] + self.cell[0] * (jnp.arange(self.shape[0]) + 0.5)
        y = corner[1] + self.cell[1] * (jnp.arange(self.shape[1]) + 0.5)
        first = (turn[0, 0] * x + shift[0])[:, None] + turn[0, 1] * y
        second = (turn[1, 0] * x + shift[1])[:, None] + turn[1, 1] * y
        cell = (support_map.cell, support_map.cell)
        index = cell_index((first, second), cell, support_map.height.shape)
        height = _with_void_border(look_up(support_map.height, index))
        ceiling = None
        if support_map.ceiling is not None:
            ceiling = look_up(support_map.ceiling, index)
        return HeightMap(height, corner, self.cell, ceiling=ceiling)


def _pack(height: Array, owner: Array) -> Array:
    """i32[...]: whole micrometres, at most 4 m up, above an owner's number."""
    micrometres = jnp.clip(jnp.round(height * 1e6), -_DEEPEST, 4e6).astype(jnp.int32)
    return (micrometres << _OWNER_BITS) | owner


def _with_void_border(height: Array) -> Array:
    i = jnp.arange(height.shape[0])
    j = jnp.arange(height.shape[1])
    is_inner_row = (i > 0) & (i < height.shape[0] - 1)
    is_inner_column = (j > 0) & (j < height.shape[1] - 1)
    return jnp.where(is_inner_row[:, None] & is_inner_column, height, VOID)
