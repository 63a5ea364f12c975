"""What the contacts of a batch of scenes tell, in JAX: overlaps, who bears whom, support margins."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.geometry import norm, rotate
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.margin import MIN_LIFT
from cluttergen_jax.types import Array


class ContactRows(struct.PyTreeNode):
    """All contacts of a batch as one list. Functions of N scenes pass over those of scenes from N on.

    Attributes:
      scene: i32[C]; geom: i32[C, 2]; depth: f32[C], overlap in metres, zero for a free place in the list.
      position: f32[C, 3], world, metres; lift: f32[C], vertical part of the unit normal, which points from
        the first geom to the second.
    """

    scene: Array
    geom: Array
    depth: Array
    position: Array
    lift: Array


def overlaps(contacts: ContactRows, layout: Layout, num_scenes: int) -> Array:
    """f32[N, K + 1, K + 1]: overlap of every pair, metres, index K for the support."""
    size = layout.num_objects + 1
    pair = jnp.asarray(layout.geom_object)[contacts.geom]
    depths = jnp.zeros((num_scenes, size, size))
    depths = depths.at[contacts.scene, pair[:, 0], pair[:, 1]].max(contacts.depth, mode="drop")
    return jnp.maximum(depths, depths.swapaxes(1, 2))


def bearers(contacts: ContactRows, layout: Layout, focus: Array) -> Array:
    """bool[N, K]: who presses each scene's focus object, i32[N], upwards."""
    carried, carrier = _carried_and_carrier(contacts, layout)
    num_objects = layout.num_objects
    num_scenes = len(focus)
    presses = _presses(contacts) & (carried == focus[jnp.minimum(contacts.scene, num_scenes - 1)])
    bears = jnp.zeros((num_scenes, num_objects + 1), bool)
    return bears.at[contacts.scene, carrier].max(presses, mode="drop")[:, :-1]


def margins(contacts: ContactRows, layout: Layout, poses: Array) -> Array:
    """f32[N, K]: every object's support margin, metres.

    Args:
      poses: f32[N, K, 7], those at which the contacts were found.
    """
    num_scenes, num_objects = poses.shape[:2]
    carried, _ = _carried_and_carrier(contacts, layout)
    carries = _presses(contacts) & (carried < num_objects) & (contacts.scene < num_scenes)
    body = jnp.where(carries, contacts.scene * num_objects + carried, num_scenes * num_objects)
    center = rotate(jnp, poses[..., 3:], jnp.asarray(layout.center_of_mass, jnp.float32))
    plan = (poses[..., :3] + center)[..., :2].reshape(-1, 2)
    found = support_margins(contacts.position[:, :2], body, plan)
    return found.reshape(num_scenes, num_objects)


def _carried_and_carrier(contacts: ContactRows, layout: Layout) -> tuple[Array, Array]:
    """Objects i32[C] each: who is pressed upwards by the contact, and by whom; K for the support."""
    pair = jnp.asarray(layout.geom_object)[contacts.geom]
    is_up = contacts.lift > 0
    return jnp.where(is_up, pair[:, 1], pair[:, 0]), jnp.where(is_up, pair[:, 0], pair[:, 1])


def _presses(contacts: ContactRows) -> Array:
    """bool[C]: the contact carries, and does not merely touch a side."""
    return (contacts.depth > 0) & (jnp.abs(contacts.lift) >= MIN_LIFT)


MAX_POINTS = 64
"""Contacts of a body that are looked at. More are left out, which makes its support smaller, never larger."""

_BLOCK = 1024
_SAME_POINT = 1e-7
_FIRST, _SECOND = np.triu_indices(MAX_POINTS, 1)


def support_margins(position: Array, body: Array, center: Array) -> Array:
    """The signed distance of each body's centre of mass to the edge of its contacts' convex hull, in plan.

    Args:
      position: f32[C, 2], metres, contacts of all bodies in any order.
      body: i32[C], whom each carries; B or more for one that carries nobody.
      center: f32[B, 2], metres, centres of mass.

    Returns:
      f32[B], metres: positive within, negative outside; -inf for what nothing carries.
    """
    order = jnp.argsort(body)
    body = body[order]
    rank = jnp.arange(len(body)) - jnp.searchsorted(body, body)
    # The last row takes what carries nobody; a rank beyond the last column is dropped.
    row = jnp.minimum(body, len(center))
    shape = (len(center) + 1, MAX_POINTS)
    points = jnp.zeros((*shape, 2)).at[row, rank].set(position[order], mode="drop")[:-1]
    is_there = jnp.zeros(shape, bool).at[row, rank].set(True, mode="drop")[:-1]
    points = jnp.where(is_there[..., None], points - center[:, None], 0.0)
    return jax.lax.map(lambda each: support_margin(*each), (points, is_there), batch_size=_BLOCK)


def support_margin(points: Array, is_there: Array) -> Array:
    """`margin.support_margin` of the points f32[64, 2] that are there, bool[64].

    The distance is the least value, over all unit directions d, of the largest d.p. It is taken at a normal
    of one of the hull's sides or, where the origin is outside, towards it from a corner: those of all pairs
    of points and of all points are tried.
    """
    side = points[_SECOND] - points[_FIRST]
    length = norm(jnp, side)
    is_side = is_there[_FIRST] & is_there[_SECOND] & (length > _SAME_POINT)
    side = side / jnp.where(is_side, length, 1.0)[:, None]
    lowest, highest = _extent(jnp.stack([-side[:, 1], side[:, 0]], axis=-1), points, is_there)
    by_side = jnp.where(is_side, jnp.minimum(highest, -lowest), jnp.inf)
    distance = norm(jnp, points)
    inwards = -points / jnp.where(distance > 0, distance, 1.0)[:, None]
    by_corner = jnp.where(is_there, _extent(inwards, points, is_there)[1], jnp.inf)
    least = jnp.minimum(by_side.min(), by_corner.min())
    return jnp.where(is_there.any(), least, -jnp.inf)


def _extent(direction: Array, points: Array, is_there: Array) -> tuple[Array, Array]:
    """The least and the largest d.p over the points, for each of the directions f32[D, 2]: f32[D] each."""
    along = direction[:, None, 0] * points[:, 0] + direction[:, None, 1] * points[:, 1]
    return (
        jnp.where(is_there, along, jnp.inf).min(axis=1),
        jnp.where(is_there, along, -jnp.inf).max(axis=1),
    )
