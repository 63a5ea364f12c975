"""Which objects are inside of others, and a draw of objects of which some fit into others."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.placement.boxes import Boxes, footprint_area, is_over, reach_up
from cluttergen_jax.placement.region import safe_poses
from cluttergen_jax.placement.types import Geometry, Hollows
from cluttergen_jax.types import Array

BELOW_RIM = 0.005
"""Metres by which the lowest point of what is in a thing is below that one's rim."""
INNER = 0.8
"""Share of a box, in plan: what is in a thing without a hollow has its centre over this part of it."""
_FULL = 0.35
"""Share of a hollow, in plan, that the objects drawn for it may fill together, where they are several."""
MOST_WIDE = 1.5
"""Factor on an opening's sides: a leaning object's box is wider than what is inside."""
_MOST_TILTED = np.cos(np.radians(45.0)).item()


def openings_of(geometry: Geometry, poses: Array) -> Boxes:
    """The hollows of K objects at world poses f32[K, 7]; the inner part of the box of an object without."""
    if geometry.hollows is None:
        return Boxes.of(geometry.half_extents * jnp.array([INNER, INNER, 1.0]), poses)
    return geometry.hollows.boxes(poses)


def is_in(subjects: Boxes, openings: Boxes) -> Array:
    """bool[N]: the first of each pair is in the other, of which the opening is given (`openings_of`).

    Its middle is over the opening, its lowest point between floor and rim, it is not much wider than the
    opening, as what stands across it is, and the opening faces upwards.
    """
    wide = _two_longest(subjects)
    room = _two_longest(openings)
    is_narrow = jnp.all(wide <= MOST_WIDE * room, axis=1)
    low = subjects.center[:, 2] - reach_up(subjects)
    rim = openings.center[:, 2] + reach_up(openings)
    # Nor is in a thing what stands on a board below it.
    is_above = low > openings.center[:, 2] - reach_up(openings) - BELOW_RIM
    up = openings.sides[:, 2]
    is_upright = up[:, 2] > _MOST_TILTED * jnp.linalg.norm(up, axis=-1)
    is_within = is_over(subjects.center, openings, 1.0) & (low < rim - BELOW_RIM)
    return is_within & is_above & is_narrow & is_upright


def _two_longest(boxes: Boxes) -> Array:
    """f32[N, 2]: how far each box reaches in plan along its two longest sides, ascending."""
    return jnp.sort(jnp.linalg.norm(boxes.sides[..., :2], axis=-1))[:, 1:]


def pairs_in(subjects: Boxes, openings: Boxes) -> Array:
    """bool[N, K]: which of N boxes are in which of K openings; an object is over its own."""
    number = len(openings.center)
    return jax.vmap(lambda box: is_in(box.repeat(number), openings))(subjects)


def is_contained(boxes: Boxes, openings: Boxes, is_there: Array, is_container: Array) -> Array:
    """bool[K]: which of K objects, those that are there (bool[K]), are in another one that is a container."""
    holds = is_there & is_container & ~jnp.eye(len(is_there), dtype=bool)
    return is_there & jnp.any(pairs_in(boxes, openings) & holds, axis=1)


def num_contained(half_extents: Array, hollows: Hollows, poses: Array, is_there: Array) -> Array:
    """i32: how many objects of a scene are in others.

    Args:
      half_extents: f32[K, 3], metres; poses: f32[K, 7], world; is_there: bool[K].
    """
    poses = safe_poses(poses, is_there)
    boxes = Boxes.of(half_extents, poses)
    return is_contained(boxes, hollows.boxes(poses), is_there, hollows.is_container).sum()


def draw_contents(
    key: Array, geometry: Geometry, is_taken: Array, number: int, num_slots: int
) -> tuple[Array, Array]:
    """So many objects and containers into which they fit, one after another, at random: bool[K], bool[K].

    Fewer where no more fit. Containers are what stands there already, too.

    Args:
      is_taken: bool[K], what stands there already; num_slots: objects that are to be placed.
    """
    hollows = geometry.hollows
    area = footprint_area(geometry.half_extents)
    assert hollows is not None
    room = 4 * _FULL * hollows.half_extents[:, 0] * hollows.half_extents[:, 1]

    def add(place: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        is_content, is_container, filled = state
        used = is_content.sum() + (is_container & ~is_taken).sum()
        has_slot = used + 1 + number - place <= num_slots
        allowed = hollows.fits & ~(is_content | is_container | is_taken)[:, None] & ~is_content
        allowed &= is_container | is_taken | has_slot
        allowed &= (filled == 0) | (filled + area[:, None] <= room)
        noise = jax.random.gumbel(jax.random.fold_in(key, place), allowed.shape)
        chosen = jnp.argmax(jnp.where(allowed, noise, -jnp.inf))
        content = chosen // len(area)
        container = chosen % len(area)
        is_any = jnp.any(allowed)
        return (
            is_content.at[content].max(is_any),
            is_container.at[container].max(is_any),
            filled.at[container].add(jnp.where(is_any, area[content], 0.0)),
        )

    nothing = jnp.zeros(len(area), bool)
    is_content, is_container, _ = jax.lax.fori_loop(
        0, number, add, (nothing, nothing, jnp.zeros(len(area)))
    )
    return is_content, is_container
