"""Candidates where relations hold: on, in, beside or along what is placed already."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from cluttergen_jax.placement.boxes import Boxes
from cluttergen_jax.placement.containers import openings_of
from cluttergen_jax.placement.related import (
    ALIGNED,
    CONE,
    IN,
    ON,
    RelatedObjects,
    allowed_at,
    heading_of,
    leaves_room,
)
from cluttergen_jax.placement.relations import KINDS
from cluttergen_jax.placement.search.features import proposed_boxes, safe_poses
from cluttergen_jax.placement.search.fit import Candidates
from cluttergen_jax.placement.search.search import SearchScene
from cluttergen_jax.placement.types import Geometry
from cluttergen_jax.types import Array

_SPREAD = 0.09
"""Radians by which what is to be aligned is turned from it at most: half of what is allowed."""
_WITHIN = {"on": 0.9, "in": 0.5}
"""Of half the diagonal of a box: over so much of it things are tried that lie on it or in it."""


def related_candidates(
    key: Array, scene: SearchScene, related: RelatedObjects, geometry: Geometry, number: int
) -> Candidates:
    """Candidates around what the current object is related to, each for one relation; region frame.

    They are uniform over the region where it has none with what is placed, and fit one relation, not all.
    """
    episode = scene.episode
    region = scene.episode.region
    key_which, key_xy, key_angle, key_far, key_yaw = jax.random.split(key, 5)
    is_subject, is_reference, other, is_table = related.pairs(_roles(scene), scene.focus)
    is_there = (is_subject | is_reference) & episode.is_placed[other] & ~is_table
    is_place = is_there & jnp.isin(related.kind, jnp.array(_PLACES))
    which = jax.random.categorical(key_which, jnp.where(is_place, 0.0, -jnp.inf), shape=(number,))
    kind = related.kind[which]
    placed = _placed_boxes(scene, geometry)
    openings = openings_of(geometry, safe_poses(episode.poses, episode.is_placed))
    T_region_world = region.T_world_region.inverse()

    def of_other(boxes: Boxes) -> tuple[Array, Array]:
        middle = jax.vmap(T_region_world.apply)(boxes.center)[other[which], :2]
        return middle, jnp.sort(jnp.linalg.norm(boxes.sides[..., :2], axis=-1), axis=-1)[
            other[which]
        ]

    center, plan = (
        jnp.where((kind == IN)[:, None], inside, whole)
        for inside, whole in zip(of_other(openings), of_other(placed), strict=True)
    )
    own = scene.body.half_extents[:2]
    diagonal = jnp.linalg.norm(plan[:, 1:], axis=1)
    unit = jax.random.uniform(key_xy, (number, 2), minval=-1.0)
    # Beside it, in the direction of the relation, from touching to as far away as is allowed.
    angle = jnp.array(_DIRECTION)[kind] + jnp.where(is_subject[which], 0.0, jnp.pi)
    angle += jnp.array(_CONES)[kind] * jax.random.uniform(key_angle, (number,), minval=-1.0)
    nearest = plan[:, 1] + jnp.min(own)
    farthest = diagonal + jnp.linalg.norm(own) + jnp.nan_to_num(related.gap[which])
    far = nearest + (farthest - nearest) * jax.random.uniform(key_far, (number,))
    beside = far[:, None] * jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=1)
    over = unit * (jnp.array(_OVER)[kind] * diagonal / jnp.sqrt(2.0))[:, None]
    is_over = (kind == ON) | (kind == IN)
    xy = center + jnp.where(is_over[:, None], over, beside)
    xy = jnp.where(jnp.any(is_place), xy, unit * region.half_extents)
    yaw = _yaws(
        key_yaw, scene, related, placed, (is_subject | is_reference, other, is_table), number
    )
    return Candidates(jnp.clip(xy, -region.half_extents, region.half_extents), yaw)


_PLACES = [place for place, kind in enumerate(KINDS) if kind not in ("far_from", "aligned")]
_ANGLES = {"right_of": 0.0, "behind": jnp.pi / 2, "left_of": jnp.pi, "in_front_of": -jnp.pi / 2}
_DIRECTION = [_ANGLES.get(kind, 0.0) for kind in KINDS]
_CONES = [CONE if kind in _ANGLES else jnp.pi for kind in KINDS]
_OVER = [_WITHIN.get(kind, 0.0) for kind in KINDS]


def _yaws(
    key: Array,
    scene: SearchScene,
    related: RelatedObjects,
    placed: Boxes,
    pairs: tuple[Array, Array, Array],
    number: int,
) -> Array:
    """f32[N]: turns; along what the object is to be aligned to, if there is anything."""
    is_mine, other, is_table = pairs
    key_turn, key_side, key_spread = jax.random.split(key, 3)
    counts = is_mine & (related.kind == ALIGNED) & (scene.episode.is_placed[other] | is_table)
    first = jnp.argmax(counts)
    turn = scene.episode.region.T_world_region.inverse().rotation().as_matrix()
    along = jnp.where(is_table[first], 0.0, heading_of(placed, turn)[other[first]])
    half = scene.body.half_extents
    along -= jnp.where(half[1] > half[0], jnp.pi / 2, 0.0)
    period = jnp.where(is_table[first], jnp.pi / 2, jnp.pi)
    aligned = along + period * jax.random.randint(key_side, (number,), 0, 4)
    aligned += _SPREAD * jax.random.uniform(key_spread, (number,), minval=-1.0)
    any_turn = jax.random.uniform(key_turn, (number,), maxval=2 * jnp.pi)
    return jnp.where(jnp.any(counts), aligned, any_turn)


def is_related(
    scene: SearchScene,
    related: RelatedObjects,
    geometry: Geometry,
    candidates: Candidates,
    rest: Array,
) -> Array:
    """bool[N]: where the relations of the current object with what is placed would hold, but for contacts.

    Args:
      rest: f32[N], from `lower_onto`, metres.
    """
    episode = scene.episode
    half = geometry.half_extents[scene.focus]
    quaternion = scene.body.quaternion
    proposed = proposed_boxes(episode.region, half, quaternion, candidates, rest)
    placed = _placed_boxes(scene, geometry)
    roles = _roles(scene)
    focus = scene.focus
    openings = openings_of(geometry, safe_poses(episode.poses, episode.is_placed))
    has_room = leaves_room(
        related, roles, focus, candidates.xy, geometry.half_extents, episode.region
    )
    is_well = allowed_at(
        related, roles, focus, proposed, placed, openings, episode.is_placed, episode.region
    )
    return has_room & is_well


def _placed_boxes(scene: SearchScene, geometry: Geometry) -> Boxes:
    episode = scene.episode
    return Boxes.of(geometry.half_extents, safe_poses(episode.poses, episode.is_placed))


def _roles(scene: SearchScene) -> Array:
    assert scene.episode.roles is not None
    return scene.episode.roles
