"""Where the next object of a row, a stack or a nest goes."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from cluttergen_jax.placement.arranged import is_arranged
from cluttergen_jax.placement.arrangements import ROW
from cluttergen_jax.placement.boxes import Boxes, askew
from cluttergen_jax.placement.region import action_of_pose, from_pose
from cluttergen_jax.placement.related import RelatedObjects, heading_of
from cluttergen_jax.placement.search import CLEARANCE, Search
from cluttergen_jax.placement.types import Body, Episode
from cluttergen_jax.types import Array

# Of a row: metres between one and the next, at an object's first attempt, and behind it; places tried.
_NEAR = (0.0008, 0.002)
_BEHIND = 0.002
_PLACES = 64
_OFF = 0.0005
"""Metres off the middle for each failed attempt, of a stack or a nest."""


class ArrangedPlaces:
    """Where the current object goes that is the next of a row, a stack or a nest.

    Args:
      search: of the world; related: what is arranged in it.
    """

    def __init__(self, search: Search, related: RelatedObjects) -> None:
        self._search = search
        self._related = related

    def __call__(self, key: Array, episode: Episode) -> tuple[Array, Array]:
        """f32[4], an action, and bool, whether the current object is such a one."""
        key_row, key_pile = jax.random.split(key)
        search = self._search
        rules = search.rules
        assert episode.roles is not None
        focus = rules.focus(episode)
        subject, reference, is_table = self._related.ends(episode.roles)
        kind = self._related.kind
        is_mine = is_arranged(kind) & (subject == focus) & (is_table | episode.is_placed[reference])
        which = jnp.argmax(is_mine)
        other = reference[which]
        body = rules.body(episode)
        row = self._row(key_row, episode, body, other, is_table[which])
        if self._related.lift is None:
            return row, jnp.any(is_mine)
        pile = self._pile(key_pile, episode, other)
        return jnp.where(kind[which] == ROW, row, pile), jnp.any(is_mine)

    def _row(
        self, key: Array, episode: Episode, body: Body, other: Array, is_first: Array
    ) -> Array:
        """f32[4]: beside the other, or where a row begins."""
        rules = self._search.rules
        region = episode.region
        assert episode.roles is not None
        key_gap, key_place, key_side, key_turn = jax.random.split(key, 4)
        half = body.half_extents[:2]
        is_along = half[0] <= half[1]
        thin = jnp.min(half)
        deep = jnp.max(half)
        T_region_world = region.T_world_region.inverse()
        boxes = Boxes.of(rules.geometry.half_extents, episode.safe_poses)
        turn = T_region_world.rotation().as_matrix()
        # All of a row face the same way.
        yaw = jnp.where(is_along, 0.0, jnp.pi / 2) + jnp.pi * (episode.roles[0] % 2)
        turned = heading_of(boxes.take(other[None]), turn)[0] - jnp.pi / 2
        yaw += jnp.where(is_first, askew(key_turn, 1)[0], turned)
        room = region.half_extents
        gap = jax.random.uniform(key_gap, minval=_NEAR[0], maxval=_NEAR[1])
        gap *= 1.0 + episode.attempt
        center = jax.vmap(T_region_world.apply)(boxes.center)
        reach = jnp.abs(boxes.sides @ turn.T).sum(1)
        # The next one goes to the right, its back in one line with the other's.
        back = 1.0 if self._related.is_against_back else -1.0
        beside_x = center[other, 0] + reach[other, 0] + gap + thin
        beside_y = center[other, 1] + back * (reach[other, 1] - deep)
        # The first one leaves room for the others, and stands at the left side, or anywhere.
        length = self._length(episode) - 2 * thin
        low = -room[0] + thin + _BEHIND
        high = jnp.maximum(room[0] - thin - length - _BEHIND, low)
        share = jax.random.uniform(key_place, (_PLACES, 2))
        x = low + share[:, 0] * (high - low)
        x = jnp.where(jax.random.bernoulli(key_side), x, x.at[0].set(low))
        widest = room[1] - deep - _BEHIND
        y = jnp.full(_PLACES, widest)
        if not self._related.is_against_back:
            y = (2 * share[:, 1] - 1) * jnp.maximum(widest, 0.0)
        # Where the row would stand is free of what stands there already.
        middle = jnp.stack([x + length / 2, y], axis=1)
        wide = jnp.array([length / 2 + thin, deep])
        overlaps = jnp.all(jnp.abs(middle[:, None] - center[:, :2]) < wide + reach[:, :2], axis=-1)
        is_free = ~jnp.any(overlaps & episode.is_placed, axis=1)
        best = jnp.argmax(is_free)
        xy = jnp.where(is_first, jnp.stack([x[best], y[best]]), jnp.stack([beside_x, beside_y]))
        position = jnp.append(xy, body.height + CLEARANCE)
        return action_of_pose(position, yaw, region, rules.height_range(episode))

    def _length(self, episode: Episode) -> Array:
        """f32, metres: of the rows in which the current object stands, all that is in them."""
        related = self._related
        geometry = self._search.rules.geometry
        assert episode.roles is not None
        subject, _, is_table = related.ends(episode.roles)
        thin = jnp.min(geometry.half_extents, axis=1)
        # A row's roles follow one another from the first: those up to the next first one.
        row = jnp.cumsum((related.kind == ROW) & is_table)
        own = jnp.argmax((related.kind == ROW) & (subject == self._search.rules.focus(episode)))
        is_own = (related.kind == ROW) & (row == row[own])
        return jnp.sum(jnp.where(is_own, 2 * thin[subject] + _NEAR[1], 0.0))

    def _pile(self, key: Array, episode: Episode, other: Array) -> Array:
        """f32[4]: upon the middle of the other, its like, turned alike; after failures a little beside."""
        related = self._related
        rules = self._search.rules
        region = episode.region
        assert related.lift is not None
        pose = region.T_world_region.inverse() @ from_pose(episode.safe_poses[other])
        off = jax.random.uniform(key, (2,), minval=-1.0) * _OFF * episode.attempt
        lift = related.lift[rules.focus(episode)] + CLEARANCE * (1.0 + 0.5 * episode.attempt)
        heading = pose.rotation().as_matrix()[:2, 0]
        yaw = jnp.arctan2(heading[1], heading[0])
        position = pose.translation() + jnp.append(off, lift)
        return action_of_pose(position, yaw, region, rules.height_range(episode))
