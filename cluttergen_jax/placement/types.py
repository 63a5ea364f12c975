"""State of the decision process: frozen pytrees, one episode each."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import jaxlie
from flax import struct

from cluttergen_jax.assets.support_map import VOID
from cluttergen_jax.placement.boxes import Boxes
from cluttergen_jax.placement.region import KeepOut, Region, safe_poses
from cluttergen_jax.types import Array, Closing, Settling

T = TypeVar("T")


def take(tree: T, index: Any) -> T:
    """A pytree of the entries of its arrays at `index`."""
    return jax.tree.map(lambda leaf: leaf[index], tree)


def choose(condition: Array, yes: T, no: T) -> T:
    """One pytree or another that is like it, by a condition without axes."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


class Orientations(struct.PyTreeNode):
    """K objects in P orientations each; a turn about z follows. The first one is upright.

    The frame of an orientation has the object's origin, and its z axis points up.

    Attributes:
      is_one: bool[K, P], False for those that fill the arrays up.
      log_weight: f32[K, P], with which one is drawn; -inf for those in which nothing is released.
      quaternion: f32[K, P, 4], wxyz, from the object frame to the orientation's.
      half_extents: f32[K, P, 3], of the box around the object along the orientation's axes, metres.
      height: f32[K, P], metres, of the origin above the lowest point.
      center_of_mass: f32[K, P, 3], the orientation's frame, metres.
      own_margin: f32[K, P], metres, see `Geometry`.
      column_xy: f32[K, P, C, 2]; column_bottom: f32[K, P, C]; is_column: bool[K, P, C]: the under-side in the
        orientation's frame, see `Geometry`.
      surface: f32[M, P, 64, 3]; surface_owner: i32[M]: the upper surface in each orientation, in the object
        frame, see `Geometry`.
      in_row: i32[K], the orientation in which an object stands in a row, the first for those that never do;
        None where there are no rows.
    """

    is_one: Array
    log_weight: Array
    quaternion: Array
    half_extents: Array
    height: Array
    center_of_mass: Array
    own_margin: Array
    column_xy: Array
    column_bottom: Array
    is_column: Array
    surface: Array
    surface_owner: Array
    in_row: Array | None = None

    def draw(self, key: Array, index: Array) -> Array:
        """i32: an orientation of object `index`, i32."""
        return jax.random.categorical(key, self.log_weight[index]).astype(jnp.int32)

    def nearest(self, quaternions: Array) -> Array:
        """i32[K]: the orientation that is nearest to how each object lies, world wxyz f32[K, 4]."""
        up = _up_in_object(quaternions)
        likeness = jnp.sum(_up_in_object(self.quaternion) * up[:, None], axis=-1)
        return jnp.argmax(jnp.where(self.is_one, likeness, -2.0), axis=1).astype(jnp.int32)


def _up_in_object(quaternion: Array) -> Array:
    """f32[..., 3]: which direction of the object points up."""
    w = quaternion[..., 0]
    x = quaternion[..., 1]
    y = quaternion[..., 2]
    z = quaternion[..., 3]
    up = [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
    return jnp.stack(up, axis=-1)


class SupportMap(struct.PyTreeNode):
    """The support alone, in the world frame, or in that of one of its surfaces; a leading axis for several.

    Attributes:
      height: f32[W, H], metres above the top, VOID where there is nothing; its border is VOID.
      corner: f32[2], metres; cell: metres.
      ceiling: f32[W, H], metres above the surface up to which it is free, inf under the open sky; None where
        nothing hangs over it.
      T_map_world: from the world to the surface's frame; None where its x and y are the world's.
    """

    height: Array
    corner: Array
    cell: float = struct.field(pytree_node=False)
    ceiling: Array | None = None
    T_map_world: jaxlie.SE3 | None = None

    @property
    def first(self) -> SupportMap:
        """The first of several, or the one that it is."""
        return take(self, 0) if self.height.ndim > 2 else self

    def place(self, T_world_x: jaxlie.SE3) -> jaxlie.SE3:
        """T_map_x; its z may be another where the map has the world's x and y."""
        return T_world_x if self.T_map_world is None else self.T_map_world @ T_world_x

    def is_under(self, xy: Array) -> Array:
        """bool[...]: whether the support is below points f32[..., 2] of the map, to half a cell."""
        index = self.index_of(xy[..., 0], xy[..., 1])
        return look_up(self.height, index) > VOID

    def index_of(self, x: Array, y: Array) -> Array:
        """i32[...]: the cells of points f32[...] of the map, in the flattened map."""
        offset = (x - self.corner[0], y - self.corner[1])
        return cell_index(offset, (self.cell, self.cell), self.height.shape)


def look_up(grid: Array, index: Array) -> Array:
    """[...]: the entries of [W, H] at cells i32[...] of the flattened map."""
    return grid.reshape(-1).at[index].get(mode="clip")


def cell_index(
    offset: tuple[Array, Array], cell: tuple[float, float], shape: tuple[int, ...]
) -> Array:
    """i32[...]: cells of a flattened map; off the map, one of its border.

    Args:
      offset: x and y from the map's corner, f32[...] each, metres.
      cell: the sides of a cell, metres; shape: the number of cells along each.
    """
    # Clipped before it is cut to whole numbers, so that nothing negative is rounded towards zero.
    i = jnp.clip(offset[0] * (1 / cell[0]), 0.0, shape[0] - 1.0).astype(jnp.int32)
    j = jnp.clip(offset[1] * (1 / cell[1]), 0.0, shape[1] - 1.0).astype(jnp.int32)
    return i * shape[1] + j


class Hollows(struct.PyTreeNode):
    """The hollows of K objects, in which other objects can be.

    Attributes:
      center, half_extents: f32[K, 3], of a box around each object's hollow, object frame, metres; of one
        without, the inner part of its own box.
      is_container: bool[K], whether it is hollow.
      fits: bool[K, K], row: an object, column: the container into which it fits.
    """

    center: Array
    half_extents: Array
    is_container: Array
    fits: Array

    def take(self, index: Array) -> Hollows:
        """Those of objects i32[...]."""
        return take(self, index)

    def boxes(self, poses: Array) -> Boxes:
        """The hollows of the objects at world poses f32[K, 7]."""
        found = Boxes.of(self.half_extents, poses)
        turned = jnp.einsum("kax,ka->kx", found.sides / self.half_extents[..., None], self.center)
        return found.replace(center=found.center + turned)


class Geometry(struct.PyTreeNode):
    """What the decision process knows of the compiled world's K objects; constants under `jit`.

    Attributes:
      half_extents: f32[K, 3], of each object's box, object frame, metres.
      center_of_mass: f32[K, 3], object frame, metres.
      own_margin: f32[K], metres, each object's support margin as it is released, on a flat table.
      cloud: f32[K, P, 3], surface points, object frame, farthest-point ordered.
      column_xy: f32[K, C, 2]; column_bottom: f32[K, C]; is_column: bool[K, C]: each object's under-side, a
        sample of its columns (`assets.height_profile`), farthest-point ordered, padded.
      surface: f32[M, 64, 3]; surface_owner: i32[M]: the grown upper surfaces of all objects, points in the
        object frame, metres, in runs of one object each; a run that is not full repeats a point.
      boxes: f32[B, 7]: the support's boxes: centre, half extents, yaw; world, metres, radians.
      top: f32, height of the support's top, metres.
      orientations: in which the objects are released; None where all are released upright.
      support_map: of a surface of the support; None for a flat top, whose map the boxes tell.
      hollows: of the objects; None where no object is asked to be inside of another.
    """

    half_extents: Array
    center_of_mass: Array
    own_margin: Array
    cloud: Array
    column_xy: Array
    column_bottom: Array
    is_column: Array
    surface: Array
    surface_owner: Array
    boxes: Array
    top: Array
    orientations: Orientations | None = None
    support_map: SupportMap | None = None
    hollows: Hollows | None = None

    @property
    def num_objects(self) -> int:
        """K."""
        return self.half_extents.shape[0]

    def orientations_at(self, poses: Array) -> Array:
        """i32[K]: the orientation that is nearest to how each object lies at world poses f32[K, 7]."""
        assert self.orientations is not None
        return self.orientations.nearest(poses[:, 3:])

    def own_margins_at(self, poses: Array) -> Array:
        """f32[K], metres: `own_margin` of the objects as they lie at world poses f32[K, 7]."""
        if self.orientations is None:
            return self.own_margin
        rows = jnp.arange(self.num_objects)
        return self.orientations.own_margin[rows, self.orientations_at(poses)]

    def surfaces_at(self, poses: Array) -> tuple[Array, Array]:
        """`surface` and `surface_owner` of the objects as they lie at world poses f32[K, 7]."""
        found = self.orientations
        if found is None:
            return self.surface, self.surface_owner
        which = self.orientations_at(poses)[found.surface_owner]
        return found.surface[jnp.arange(len(which)), which], found.surface_owner


class Body(struct.PyTreeNode):
    """One object as it is released, but for its turn about z: in the frame of its orientation.

    Attributes:
      quaternion: f32[4], wxyz, from the object frame; None where it is upright.
      half_extents: f32[3], of its box, metres.
      height: f32, metres, of its origin above its lowest point.
      center_of_mass: f32[3], metres.
      own_margin: f32, metres.
      column_xy: f32[C, 2]; column_bottom: f32[C]; is_column: bool[C]: its under-side.
    """

    quaternion: Array | None
    half_extents: Array
    height: Array
    center_of_mass: Array
    own_margin: Array
    column_xy: Array
    column_bottom: Array
    is_column: Array

    @staticmethod
    def of(geometry: Geometry, index: Array, orientation: Array | None) -> Body:
        """Object `index`, i32, in an orientation, i32; None where all are upright."""
        found = geometry.orientations
        if found is not None:
            names = [field.name for field in fields(Body)]
            return Body(**{name: getattr(found, name)[index, orientation] for name in names})
        half = geometry.half_extents[index]
        return Body(
            quaternion=None,
            half_extents=half,
            height=half[2],
            center_of_mass=geometry.center_of_mass[index],
            own_margin=geometry.own_margin[index],
            column_xy=geometry.column_xy[index],
            column_bottom=geometry.column_bottom[index],
            is_column=geometry.is_column[index],
        )


class Start(struct.PyTreeNode):
    """What stands on the support when an episode begins.

    Attributes:
      poses: f32[K, 7], world poses, metres, wxyz; identity where nothing stands.
      is_placed: bool[K].
    """

    poses: Array
    is_placed: Array

    @staticmethod
    def empty(num_objects: int) -> Start:
        """Nothing stands there."""
        poses = jnp.zeros((num_objects, 7), jnp.float32).at[:, 3].set(1.0)
        return Start(poses, jnp.zeros(num_objects, bool))


class History(struct.PyTreeNode):
    """The failed attempts of the current object, oldest first: A attempts, H kept trajectory rows.

    Attributes:
      action: f32[A, 4].
      region: f32[A, 3], the region's half extents and the height range, metres.
      trajectory: f32[A, H, 13], world frame (`types.Settling`), every `history_stride`-th row from release.
      num_steps: i32[A].
      is_tried: bool[A], the attempts that count; all others are zero.
    """

    action: Array
    region: Array
    trajectory: Array
    num_steps: Array
    is_tried: Array


class Counts(struct.PyTreeNode):
    """Figures of one episode so far. S slots.

    Attributes:
      attempts: i32[S], attempts used by each slot's object, those at a place that was taken away included.
      steps: i32[S], steps of all those attempts added up. The paper's stable steps, if attempts run
        to their end (`StabilityConfig.stop_when_decided` off).
      rest_steps: i32[S], steps of the attempt that succeeded; 0 where the object does not stand.
      verdicts: i32[V], attempts by `Verdict` code: STABLE to NON_FINITE, to UNSUPPORTED where a margin is
        asked for, to FRAGILE where it is asked that what stands is robust, or to UNRELATED where relations
        are asked for.
      simulated_steps: i32, steps simulated, all checks included.
      reward: f32, sum of rewards.
    """

    attempts: Array
    steps: Array
    rest_steps: Array
    verdicts: Array
    simulated_steps: Array
    reward: Array


class SupportGraph(struct.PyTreeNode):
    """What carries what among the placed objects of an episode, known from contacts at rest.

    Attributes:
      leans_on: bool[K, K], row k: the objects that touched object k when it came to rest, and those that
        came to touch it later and moved it.
      level: i32[K], 0 on the support alone, else one more than the highest of what bears the object.
      margin: f32[K], metres, the support margin (`physics.margin`) when it was last measured, at least
        -`MAX_MARGIN`; on a flat table for what is not placed, or stood there from the beginning.
    """

    leans_on: Array
    level: Array
    margin: Array

    def num_touching(self, is_placed: Array) -> Array:
        """i32: the pairs of placed objects, bool[K], that touch."""
        touch = (self.leans_on | self.leans_on.T) & is_placed & is_placed[:, None]
        return jnp.sum(jnp.triu(touch, 1)).astype(jnp.int32)


class DoorRecord(struct.PyTreeNode):
    """What closing the doors of an episode came to. D doors that close.

    Attributes:
      travel: f32[D], by which each has moved from where it stands open, radians or metres.
      num_hits: i32, how often one hit an object or did not close.
      door, hit: i32, the door and the object (-1 for none) of the last time; -1 if there was none.
    """

    travel: Array
    num_hits: Array
    door: Array
    hit: Array

    @staticmethod
    def empty(num_doors: int) -> DoorRecord:
        """Doors that stand open."""
        none = jnp.int32(-1)
        return DoorRecord(jnp.zeros(num_doors, jnp.float32), jnp.int32(0), none, none)

    def with_closing(self, closing: Closing) -> DoorRecord:
        """The record with one more closing."""
        is_hit = closing.door >= 0
        return DoorRecord(
            travel=closing.travel,
            num_hits=self.num_hits + is_hit,
            door=jnp.where(is_hit, closing.door, self.door),
            hit=jnp.where(is_hit, closing.hit, self.hit),
        )


class Episode(struct.PyTreeNode):
    """Filling one support. K objects in the world, S slots.

    Attributes:
      key: for whoever draws next in this episode.
      region: where objects are to go.
      keep_out: where they must not.
      object_index: i32[S], the object of each slot, padded with -1.
      first_slot: i32, slots that were filled when the episode began.
      slot: i32, the current slot; S or the first padded one when all are filled.
      attempt: i32, attempts of the current object that failed since its turn began.
      poses: f32[K, 7], world poses of the placed objects, zero elsewhere.
      is_placed: bool[K].
      history: failed attempts of the current object.
      counts: figures so far.
      is_over: bool, every slot is filled, or the attempts of a slot or of the scene are used up.
      is_success: bool, every slot is filled and the finished scene stands.
      verdict: i32, the latest attempt's verdict; once all slots are filled, the last check's.
      drift: f32, metres, the largest movement in the last check.
      support_graph: what carries what.
      surface: i32[K], on which of several surfaces each object is placed, the current one to be; -1 for what
        stood there when the episode began; None where there is one.
      orientation: i32, of `Geometry.orientations`, that in which the current object is released next; None
        where all are released upright.
      roles: i32[Q], the objects of `Rules.related`'s roles; None where nothing is related.
      num_beside: i32, pairs of objects that touch from the side, and num_leaning: i32, objects that lean, at
        the end; None where neither is counted.
      doors: what closing them came to; None where none are closed.
    """

    key: Array
    region: Region
    keep_out: KeepOut
    object_index: Array
    first_slot: Array
    slot: Array
    attempt: Array
    poses: Array
    is_placed: Array
    history: History
    counts: Counts
    is_over: Array
    is_success: Array
    verdict: Array
    drift: Array
    support_graph: SupportGraph
    orientation: Array | None = None
    roles: Array | None = None
    surface: Array | None = None
    num_beside: Array | None = None
    num_leaning: Array | None = None
    doors: DoorRecord | None = None

    @property
    def safe_poses(self) -> Array:
        """f32[K, 7]: `poses`, the identity for what is not placed."""
        return safe_poses(self.poses, self.is_placed)

    @property
    def num_slots(self) -> Array:
        """i32: slots that have an object, those that stood there at the beginning included."""
        return (self.object_index >= 0).sum(-1)

    @property
    def is_started(self) -> Array:
        """bool[K]: the objects that stood there when the episode began."""
        is_started = jnp.arange(len(self.object_index))[:, None] < self.first_slot
        return jnp.any(
            is_started & (self.object_index[:, None] == jnp.arange(len(self.is_placed))), axis=0
        )


class Transition(struct.PyTreeNode):
    """What one attempt was and what came of it. What nobody reads of it, XLA leaves out.

    Attributes:
      slot: i32, the slot that was to be filled; object_index: i32, the current object.
      ordinal: i32, the object's attempt in a row since its turn began, from 1; a turn begins anew where
        objects are taken away.
      action: f32[4], what was proposed.
      settling: what the simulator saw.
      verdict: i32, the attempt's verdict by the rules.
      reward: f32; 0 where no attempt was made.
      is_made: bool, False for an episode that was over.
    """

    slot: Array
    object_index: Array
    ordinal: Array
    action: Array
    settling: Settling
    verdict: Array
    reward: Array
    is_made: Array
