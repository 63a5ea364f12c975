"""What the contacts of a batch of scenes tell, in JAX: overlaps, who bears whom, support margins."""

from __future__ import annotations

import jax.numpy as jnp
from flax import struct

from cluttergen_jax.geometry import rotate
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.margin import MIN_LIFT
from cluttergen_jax.physics.mjx_margin import support_margins
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
    carried, carrier = _carried(contacts, layout)
    num_objects, num_scenes = layout.num_objects, len(focus)
    presses = _presses(contacts) & (carried == focus[jnp.minimum(contacts.scene, num_scenes - 1)])
    bears = jnp.zeros((num_scenes, num_objects + 1), bool)
    return bears.at[contacts.scene, carrier].max(presses, mode="drop")[:, :-1]


def margins(contacts: ContactRows, layout: Layout, poses: Array) -> Array:
    """f32[N, K]: every object's support margin, metres.

    Args:
      poses: f32[N, K, 7], those at which the contacts were found.
    """
    num_scenes, num_objects = poses.shape[:2]
    carried, _ = _carried(contacts, layout)
    carries = _presses(contacts) & (carried < num_objects) & (contacts.scene < num_scenes)
    body = jnp.where(carries, contacts.scene * num_objects + carried, num_scenes * num_objects)
    center = rotate(jnp, poses[..., 3:], jnp.asarray(layout.center_of_mass, jnp.float32))
    plan = (poses[..., :3] + center)[..., :2].reshape(-1, 2)
    found = support_margins(contacts.position[:, :2], body, plan)
    return found.reshape(num_scenes, num_objects)


def _carried(contacts: ContactRows, layout: Layout) -> tuple[Array, Array]:
    """Objects i32[C] each: who is pressed upwards by the contact, and by whom; K for the support."""
    pair = jnp.asarray(layout.geom_object)[contacts.geom]
    is_up = contacts.lift > 0
    return jnp.where(is_up, pair[:, 1], pair[:, 0]), jnp.where(is_up, pair[:, 0], pair[:, 1])


def _presses(contacts: ContactRows) -> Array:
    """bool[C]: the contact carries, and does not merely touch a side."""
    return (contacts.depth > 0) & (jnp.abs(contacts.lift) >= MIN_LIFT)
