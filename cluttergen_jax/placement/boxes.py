"""Objects as their boxes: gaps between them in plan, and what they hide of each other."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.placement.region import from_pose, safe_poses
from cluttergen_jax.types import Array

NUM_CAMERAS = 8
CAMERA_ELEVATION = np.radians(30.0)
ASKEW = (0.004, 0.015)
"""Radians by which what lies along something is turned from it at least, and at most."""
_FILL = 0.6
"""Of the rectangle that bounds its box in a picture, so much an object fills and hides."""


class Boxes(struct.PyTreeNode):
    """N boxes in the world, metres.

    Attributes:
      center: f32[N, 3].
      sides: f32[N, 3, 3], three rows: from the centre to the middle of a face.
    """

    center: Array
    sides: Array

    @staticmethod
    def of(half_extents: Array, poses: Array) -> Boxes:
        """From half extents f32[N, 3] and world poses f32[N, 7]."""
        T_world_object = from_pose(poses)
        turn = T_world_object.rotation().as_matrix()
        sides = jnp.swapaxes(turn, -1, -2) * half_extents[..., None]
        return Boxes(T_world_object.translation(), sides)

    def take(self, index: Array) -> Boxes:
        """Those at `index`, i32[M]."""
        return Boxes(self.center[index], self.sides[index])

    def repeat(self, number: int) -> Boxes:
        """One box, its arrays without the leading axis, so many times."""
        center = jnp.broadcast_to(self.center, (number, 3))
        return Boxes(center, jnp.broadcast_to(self.sides, (number, 3, 3)))

    def reach(self, directions: Array) -> Array:
        """f32[N, D]: how far each box extends from its centre along unit vectors f32[D, 3]."""
        return jnp.abs(jnp.einsum("nax,dx->nda", self.sides, directions)).sum(-1)


def reach_up(boxes: Boxes) -> Array:
    """f32[N], metres: from the centre of each box to its top."""
    return jnp.abs(boxes.sides[:, :, 2]).sum(1)


def askew(key: Array, number: int) -> Array:
    """f32[N], radians: small turns to either side, none of them nothing.

    What lies exactly along a board creeps there, as the engine finds fewer points of contact.
    """
    key_size, key_side = jax.random.split(key)
    size = jax.random.uniform(key_size, (number,), minval=ASKEW[0], maxval=ASKEW[1])
    return jnp.where(jax.random.bernoulli(key_side, shape=(number,)), size, -size)


def is_over(points: Array, boxes: Boxes, share: float) -> Array:
    """bool[N]: the point is over the middle part of the box, in plan; tipped boxes as if they lay flat."""
    offset = (points - boxes.center)[:, :2]
    flat = boxes.sides[:, :, :2]
    # Of the three sides the two that are longest in plan span it.
    length = jnp.linalg.norm(flat, axis=-1)
    order = jnp.argsort(-length, axis=1)[:, :2]
    sides = jnp.take_along_axis(flat, order[..., None], axis=1)
    reach = jnp.maximum(jnp.take_along_axis(length, order, axis=1), 1e-6)
    along = jnp.abs(jnp.einsum("nax,nx->na", sides / reach[..., None], offset))
    return jnp.all(along <= share * reach, axis=1)


class Views(struct.PyTreeNode):
    """The rectangles that bound N boxes in the pictures of C cameras far away, metres.

    Attributes:
      middle: f32[N, C, 2], right and up in the picture; half: f32[N, C, 2].
      depth: f32[N, C], of the centres, towards the camera.
      ahead: f32[N, C], of the centres, horizontally towards the camera; reach: f32[N, C], of the boxes to
        either side of that.
    """

    middle: Array
    half: Array
    depth: Array
    ahead: Array
    reach: Array

    @staticmethod
    def of(boxes: Boxes) -> Views:
        """From the ring of cameras: `NUM_CAMERAS` around, `CAMERA_ELEVATION` up."""
        angle = 2 * np.pi * np.arange(NUM_CAMERAS) / NUM_CAMERAS
        cos = np.cos(angle)
        sin = np.sin(angle)
        up = np.sin(CAMERA_ELEVATION)
        out = np.cos(CAMERA_ELEVATION)
        right = jnp.asarray(np.stack([-sin, cos, 0 * cos], axis=1), jnp.float32)
        above = jnp.asarray(np.stack([-up * cos, -up * sin, out + 0 * cos], axis=1), jnp.float32)
        towards = jnp.asarray(np.stack([out * cos, out * sin, up + 0 * cos], axis=1), jnp.float32)
        ahead = jnp.asarray(np.stack([cos, sin, 0 * cos], axis=1), jnp.float32)
        axes = (right, above)
        return Views(
            middle=jnp.stack([boxes.center @ axis.T for axis in axes], axis=-1),
            half=jnp.stack([boxes.reach(axis) for axis in axes], axis=-1),
            depth=boxes.center @ towards.T,
            ahead=boxes.center @ ahead.T,
            reach=boxes.reach(ahead),
        )


def gaps(ours: Boxes, theirs: Boxes) -> Array:
    """f32[N, K], metres: the gap in plan between each of N boxes and each of K; 0 where they overlap.

    It is the widest strip along a side of either box that holds neither of them: the distance of two
    rectangles, and less only where they are nearest at two corners.
    """
    shape = (ours.center.shape[0], theirs.center.shape[0], 2, 3)
    along_ours = jnp.broadcast_to(_axes(ours)[:, None], shape)
    along_theirs = jnp.broadcast_to(_axes(theirs)[None], shape)
    directions = jnp.concatenate([along_ours, along_theirs], axis=2)
    away = ours.center[:, None] - theirs.center[None]
    offset = jnp.abs(jnp.einsum("nkdx,nkx->nkd", directions, away))
    wide = jnp.abs(jnp.einsum("nkdx,nax->nkda", directions, ours.sides)).sum(-1)
    wide += jnp.abs(jnp.einsum("nkdx,kax->nkda", directions, theirs.sides)).sum(-1)
    return jnp.maximum(jnp.max(offset - wide, axis=-1), 0.0)


def _axes(boxes: Boxes) -> Array:
    """f32[N, 2, 3]: horizontal unit vectors along and across each box."""
    flat = boxes.sides[:, :2, :2]
    length = jnp.linalg.norm(flat, axis=-1)
    # A box that stands on its first side is turned as its second one.
    along = jnp.where((length[:, :1] > 1e-6), flat[:, 0], flat[:, 1])
    along /= jnp.maximum(jnp.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
    x = along[:, 0]
    y = along[:, 1]
    zero = jnp.zeros_like(along[:, 0])
    return jnp.stack([jnp.stack([x, y, zero], -1), jnp.stack([-y, x, zero], -1)], axis=1)


def hidden_shares(ours: Views, theirs: Views) -> Array:
    """f32[N, K, C]: the share of each of N objects that each of K hides, where that one is in front.

    It is the share of the one's bounding rectangle in the other's, times 0.6: so much of it an object fills.

    In front is whose centre is nearer to the camera: horizontally, unless neither is wholly before the other.
    """
    our_low = ours.middle - ours.half
    our_high = ours.middle + ours.half
    low = jnp.maximum(our_low[:, None], (theirs.middle - theirs.half)[None])
    high = jnp.minimum(our_high[:, None], (theirs.middle + theirs.half)[None])
    covered = jnp.prod(jnp.maximum(high - low, 0.0), axis=-1)
    area = jnp.maximum(4 * jnp.prod(ours.half, axis=-1), 1e-9)
    before = theirs.ahead[None] - ours.ahead[:, None]
    is_apart = jnp.abs(before) > theirs.reach[None] + ours.reach[:, None]
    is_in_front = jnp.where(is_apart, before, theirs.depth[None] - ours.depth[:, None]) > 0
    return jnp.where(is_in_front, _FILL * jnp.clip(covered / area[:, None], 0.0, 1.0), 0.0)


def nearest_gaps(boxes: Boxes, is_there: Array) -> Array:
    """f32[K], metres: from each box that is there (bool[K]) to the nearest other; 0 where it is alone."""
    others = is_there & ~jnp.eye(len(is_there), dtype=bool)
    nearest = jnp.min(jnp.where(others, gaps(boxes, boxes), jnp.inf), axis=1)
    return jnp.where(is_there & jnp.isfinite(nearest), nearest, 0.0)


def seen_shares(views: Views, is_there: Array) -> Array:
    """f32[K, C]: the share of each that no other hides, as if they hid it independently; 0 if not there."""
    others = is_there[None] & ~jnp.eye(len(is_there), dtype=bool)
    hidden = jnp.where(others[..., None], hidden_shares(views, views), 0.0)
    return jnp.where(is_there[:, None], jnp.prod(1.0 - hidden, axis=1), 0.0)


def spacing_of(half_extents: Array, poses: Array, is_there: Array) -> tuple[Array, Array]:
    """f32, f32: a scene's mean gap to the nearest other object, metres, and its mean hidden share.

    Args:
      half_extents: f32[K, 3], metres; poses: f32[K, 7], world; is_there: bool[K].
    """
    boxes = Boxes.of(half_extents, safe_poses(poses, is_there))
    number = jnp.maximum(is_there.sum(), 1)
    hidden = jnp.where(is_there, 1.0 - seen_shares(Views.of(boxes), is_there).mean(1), 0.0)
    return nearest_gaps(boxes, is_there).sum() / number, hidden.sum() / number


def footprint_area(half_extents: Array) -> Array:
    """f32[K], square metres: boxes seen from above, of half extents f32[K, 3]."""
    return 4 * half_extents[:, 0] * half_extents[:, 1]


def gaps_in_plan(half_extents: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """f32[N, N], metres: `gaps` of objects as boxes, of half extents f[N, 3] at world poses f[N, 7]."""
    boxes = Boxes.of(jnp.asarray(half_extents, jnp.float32), jnp.asarray(poses, jnp.float32))
    return np.asarray(gaps(boxes, boxes))
