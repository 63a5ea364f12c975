"""What an object would lie on at each candidate, and what it would add there to each feature of clutter."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import jaxlie
from flax import struct

from cluttergen_jax.placement.boxes import (
    Boxes,
    Views,
    gaps,
    hidden_shares,
    nearest_gaps,
    seen_shares,
)
from cluttergen_jax.placement.clutter import Clutter
from cluttergen_jax.placement.containers import is_contained, pairs_in
from cluttergen_jax.placement.region import Region, from_pose
from cluttergen_jax.placement.search import (
    Candidates,
    SearchScene,
    base_share,
    cells_under,
    touching,
)
from cluttergen_jax.placement.types import Episode, Geometry
from cluttergen_jax.types import Array

_SAFE = 0.1
_BITS = 32
"""Bits of a whole number."""


class Supporters(struct.PyTreeNode):
    """The placed objects that would carry the current one at N candidates.

    Attributes:
      is_on: bool[N], something other than the support would carry it.
      level: f32[N], how many objects would be below it, one upon the other.
      margin: f32[N], metres, the least support margin of those that carry it; 0.1 for the support.
      offset: f32[N], metres, the most by which its centre of mass would lie beyond the support of one that
        carries it, in plan: that one's own margin around that one's centre of mass; -0.1 for the support.
      touched: bool[N, K], the placed objects that it would touch.
      base: f32[N], the share of its base, the lowest of its columns, that would touch something.
    """

    is_on: Array
    level: Array
    margin: Array
    offset: Array
    touched: Array
    base: Array


def find_supporters(
    scene: SearchScene, geometry: Geometry, candidates: Candidates, rest: Array
) -> Supporters:
    """Who would carry the current object at each candidate.

    Args:
      scene: with owners.
      rest: f32[N], from `lower_onto`, metres.
    """
    support_graph = scene.episode.support_graph
    under = scene.under
    heights = scene.heights
    touches = touching(under, heights, candidates, rest)
    owner = heights.owner_at(cells_under(under, heights, candidates))
    is_by_object = touches & (owner < geometry.num_objects)
    place = jnp.where(is_by_object, owner, geometry.num_objects)
    # By object from here on: there are far more columns.
    touched = _found_among(place, geometry.num_objects + 1)

    def most(of_objects: Array, of_support: float) -> Array:
        """f32[N]: the largest value among those that carry it."""
        return jnp.max(jnp.where(touched, jnp.append(of_objects, of_support), -jnp.inf), axis=1)

    # The lowest margin decides, so their negatives are compared.
    margin = -most(-jnp.minimum(support_graph.margin, _SAFE), -_SAFE)
    center = from_pose(scene.episode.poses).apply(geometry.center_of_mass)[:, :2]
    distance = jnp.linalg.norm(_in_world(scene, candidates)[:, None] - center, axis=-1)
    beyond = jnp.append(distance - support_graph.margin, jnp.full((len(rest), 1), -_SAFE), axis=1)
    offset = jnp.max(jnp.where(touched, beyond, -jnp.inf), axis=1)
    return Supporters(
        is_on=jnp.any(touched[:, :-1], axis=1),
        level=most(support_graph.level + 1.0, 0.0),
        margin=margin,
        offset=jnp.clip(offset, -_SAFE, _SAFE),
        touched=touched[:, :-1],
        base=base_share(under, touches),
    )


def _found_among(place: Array, number: int) -> Array:
    """bool[N, number]: which of the whole numbers from 0 on are among i32[N, C]."""
    words = []
    for word in range(-(-number // _BITS)):
        bit = jnp.uint32(1) << (place % _BITS).astype(jnp.uint32)
        bit = jnp.where(place // _BITS == word, bit, 0)
        words.append(jax.lax.reduce(bit, jnp.uint32(0), jax.lax.bitwise_or, (1,)))
    bits = jnp.stack(words, axis=1)[:, :, None] >> jnp.arange(_BITS, dtype=jnp.uint32) & 1
    return bits.reshape(len(place), -1)[:, :number].astype(bool)


def _in_world(scene: SearchScene, candidates: Candidates) -> Array:
    """f32[N, 2]: the centres of mass at the candidates, world x and y."""
    T_world_region = scene.episode.region.T_world_region
    turn = T_world_region.rotation().as_matrix()[:2, :2]
    cos = jnp.cos(candidates.yaw)
    sin = jnp.sin(candidates.yaw)
    x, y = scene.under.center_of_mass
    local = candidates.xy + jnp.stack([cos * x - sin * y, sin * x + cos * y], axis=1)
    return local @ turn.T + T_world_region.translation()[:2]


_EARLY = 0.5
"""The share of the objects that are left among which counted features are sought."""


class Placing(struct.PyTreeNode):
    """A scene and N candidates for its current object. K objects.

    Attributes:
      episode: before the attempt.
      placed: the boxes of all objects.
      proposed: those of the current object at the candidates.
      supporters: what would carry it there.
      openings: of all objects (`containers.openings_of`); is_container: bool[K], which are hollow; can_hold:
        bool[K], those into which the current object fits. None where nothing is asked of it.
    """

    episode: Episode
    placed: Boxes
    proposed: Boxes
    supporters: Supporters
    openings: Boxes | None = None
    is_container: Array | None = None
    can_hold: Array | None = None

    @staticmethod
    def of(
        episode: Episode,
        geometry: Geometry,
        focus: Array,
        quaternion: Array | None,
        candidates: Candidates,
        rest: Array,
        supporters: Supporters,
    ) -> Placing:
        """See the attributes.

        Args:
          focus: i32, the current object; quaternion: its orientation (`Body`).
          rest: f32[N], from `lower_onto`, metres.
        """
        poses = episode.safe_poses
        hollows = geometry.hollows
        return Placing(
            episode=episode,
            placed=Boxes.of(geometry.half_extents, poses),
            proposed=proposed_boxes(
                episode.region, geometry.half_extents[focus], quaternion, candidates, rest
            ),
            supporters=supporters,
            openings=None if hollows is None else hollows.boxes(poses),
            is_container=None if hollows is None else hollows.is_container,
            can_hold=None if hollows is None else hollows.fits[focus],
        )


def proposed_boxes(
    region: Region,
    half_extents: Array,
    quaternion: Array | None,
    candidates: Candidates,
    rest: Array,
) -> Boxes:
    """The boxes of an object at N candidates.

    Args:
      half_extents: f32[3], metres; quaternion: the object's orientation (`Body`).
      rest: f32[N], from `lower_onto`, metres.
    """
    T_world_region = region.T_world_region
    turn = T_world_region.rotation().as_matrix()
    shift = T_world_region.translation()
    cos = jnp.cos(candidates.yaw)
    sin = jnp.sin(candidates.yaw)
    zero = jnp.zeros_like(cos)
    axes = jnp.stack(
        [
            jnp.stack([cos, sin, zero], -1),
            jnp.stack([-sin, cos, zero], -1),
            zero[:, None] + jnp.eye(3)[2],
        ],
        axis=1,
    )
    if quaternion is not None:
        axes = jaxlie.SO3(quaternion).as_matrix().T @ axes
    center = jnp.concatenate([candidates.xy, rest[:, None]], axis=1)
    return Boxes(center @ turn.T + shift, axes @ turn.T * half_extents[:, None])


class Feature(NamedTuple):
    """One feature of clutter.

    Attributes:
      total: of the placed objects of an episode, f32.
      added: f32[N], by how much each candidate would change it.
      is_mean: its target is a mean over the objects, of which `total` is the sum.
      hinders: bool[N], the candidates that take the room that others need which are to add to it. Where it is
        given, what remains is sought at once.
    """

    total: Callable[[Placing], Array]
    added: Callable[[Placing], Array]
    is_mean: bool = False
    hinders: Callable[[Placing], Array] | None = None


def _num_on(at: Placing) -> Array:
    return jnp.sum(_levels(at) > 0).astype(jnp.float32)


def _depth(at: Placing) -> Array:
    return jnp.sum(_levels(at)).astype(jnp.float32)


def _levels(at: Placing) -> Array:
    return jnp.where(at.episode.is_placed, at.episode.support_graph.level, 0)


def _num_touching(at: Placing) -> Array:
    episode = at.episode
    return episode.support_graph.num_touching(episode.is_placed).astype(jnp.float32)


def _num_contained(at: Placing) -> Array:
    assert at.is_container is not None
    assert at.openings is not None
    inside = is_contained(at.placed, at.openings, at.episode.is_placed, at.is_container)
    return inside.sum().astype(jnp.float32)


def _contained_added(at: Placing) -> Array:
    return jnp.any(_inside(at), axis=1).astype(jnp.float32)


def _inside(at: Placing) -> Array:
    """bool[N, K]: the placed containers in which the current object would be."""
    assert at.is_container is not None
    assert at.openings is not None
    return pairs_in(at.proposed, at.openings) & at.episode.is_placed & at.is_container


def _hinders_containing(at: Placing) -> Array:
    """bool[N]: it would lie upon a container, or in one into which others fit better."""
    touches = at.supporters.touched & at.is_container
    return jnp.any(touches | _inside(at), axis=1) & ~jnp.any(_inside(at) & at.can_hold, axis=1)


def _sum_of_gaps(at: Placing) -> Array:
    return jnp.sum(nearest_gaps(at.placed, at.episode.is_placed))


def _gaps_added(at: Placing) -> Array:
    is_placed = at.episode.is_placed
    own = gaps(at.proposed, at.placed)
    nearest = jnp.min(jnp.where(is_placed, own, jnp.inf), axis=1)
    # Who stands alone has no gap yet, and gets one.
    before = nearest_gaps(at.placed, is_placed)
    is_alone = is_placed.sum() == 1
    after = jnp.where(is_alone, own, jnp.minimum(own, before))
    change = jnp.sum(jnp.where(is_placed, after - before, 0.0), axis=1)
    return jnp.where(jnp.isfinite(nearest), nearest + change, 0.0)


def _sum_of_hidden(at: Placing) -> Array:
    is_placed = at.episode.is_placed
    seen = seen_shares(Views.of(at.placed), is_placed)
    return jnp.sum(jnp.where(is_placed, 1.0 - seen.mean(1), 0.0))


def _hidden_added(at: Placing) -> Array:
    is_placed = at.episode.is_placed[:, None]
    placed = Views.of(at.placed)
    proposed = Views.of(at.proposed)
    seen = seen_shares(placed, at.episode.is_placed)
    own = 1.0 - jnp.prod(1.0 - jnp.where(is_placed, hidden_shares(proposed, placed), 0.0), axis=1)
    by_it = jnp.moveaxis(hidden_shares(placed, proposed), 0, 1) * seen
    return (own + by_it.sum(1)).mean(-1)


FEATURES: dict[str, Feature] = {
    "stack": Feature(_num_on, lambda at: at.supporters.is_on.astype(jnp.float32)),
    "contained": Feature(_num_contained, _contained_added, hinders=_hinders_containing),
    "depth": Feature(_depth, lambda at: at.supporters.level),
    "contacts": Feature(_num_touching, lambda at: at.supporters.touched.sum(1).astype(jnp.float32)),
    "near": Feature(_sum_of_gaps, _gaps_added, is_mean=True),
    "occlusion": Feature(_sum_of_hidden, _hidden_added, is_mean=True),
}
"""By name, as in `Clutter`; near is summed in metres, occlusion in shares."""


def remaining_and_added(clutter: Clutter, at: Placing) -> tuple[Array, Array]:
    """What the current object should add of each asked feature, f32[F], and would, f32[N, F].

    What remains is shared equally among the objects that are left.
    """
    episode = at.episode
    left = jnp.maximum(episode.num_slots - episode.slot, 1)
    remaining = []
    added = []
    for name, target in clutter.targets.items():
        feature = FEATURES[name]
        asked = target * episode.num_slots if feature.is_mean else target
        # Not every object finds something to lie on: what is counted is asked of the first to come.
        share = left if feature.is_mean else jnp.maximum(_EARLY * left, 1.0)
        missing = asked - feature.total(at)
        change = feature.added(at)
        if feature.hinders is not None:
            share = jnp.float32(1.0)
            change = jnp.where((missing > 0) & feature.hinders(at), -1.0, change)
        remaining.append(missing / share)
        added.append(change)
    return jnp.stack(remaining), jnp.stack(added, axis=1)
