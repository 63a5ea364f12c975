"""Features of clutter: what a scene has of each, and what an object would add at each candidate."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import jaxlie
from flax import struct

from cluttergen_jax.placement.boxes import Boxes, Views, gaps, hidden_shares, nearest_gaps, seen_shares
from cluttergen_jax.placement.clutter import Clutter
from cluttergen_jax.placement.containers import contained, pairs_in
from cluttergen_jax.placement.region import Region
from cluttergen_jax.placement.scenes import num_touching
from cluttergen_jax.placement.search.fit import Candidates
from cluttergen_jax.placement.search.support_graph import Supporters
from cluttergen_jax.placement.types import Episode, Geometry, Hollows
from cluttergen_jax.types import Array

_EARLY = 0.5
"""The share of the objects that are left among which counted features are sought."""


class Placing(struct.PyTreeNode):
    """A scene and N candidates for its current object. K objects.

    Attributes:
      episode: before the attempt.
      placed: the boxes of all objects.
      proposed: those of the current object at the candidates.
      supporters: what would carry it there.
      openings: of all objects (`containers.openings_of`); hollows: which are hollow, and what fits into them;
        None where nothing is asked of it.
    """

    episode: Episode
    placed: Boxes
    proposed: Boxes
    supporters: Supporters
    openings: Boxes | None = None
    hollows: Hollows | None = None

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
        poses, hollows = safe_poses(episode.poses, episode.is_placed), geometry.hollows
        return Placing(
            episode=episode,
            placed=Boxes.of(geometry.half_extents, poses),
            proposed=proposed_boxes(
                episode.region, geometry.half_extents[focus], quaternion, candidates, rest
            ),
            supporters=supporters,
            openings=None if hollows is None else hollows.boxes(poses),
            hollows=hollows,
        )


def proposed_boxes(
    region: Region, half_extents: Array, quaternion: Array | None, candidates: Candidates, rest: Array
) -> Boxes:
    """The boxes of an object at N candidates.

    Args:
      half_extents: f32[3], metres; quaternion: the object's orientation (`Body`).
      rest: f32[N], from `lower_onto`, metres.
    """
    T_world_region = region.T_world_region
    turn, shift = T_world_region.rotation().as_matrix(), T_world_region.translation()
    cos, sin = jnp.cos(candidates.yaw), jnp.sin(candidates.yaw)
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
      num_able: of the objects that are left those that can add to it, f32; None for all.
    """

    total: Callable[[Placing], Array]
    added: Callable[[Placing], Array]
    is_mean: bool = False
    num_able: Callable[[Placing], Array] | None = None


def _num_on(at: Placing) -> Array:
    return jnp.sum(_levels(at) > 0).astype(jnp.float32)


def _depth(at: Placing) -> Array:
    return jnp.sum(_levels(at)).astype(jnp.float32)


def _levels(at: Placing) -> Array:
    return jnp.where(at.episode.is_placed, at.episode.support_graph.level, 0)


def _num_touching(at: Placing) -> Array:
    return num_touching(at.episode.support_graph.leans_on, at.episode.is_placed).astype(jnp.float32)


def _num_contained(at: Placing) -> Array:
    hollows, openings = _hollows(at)
    inside = contained(at.placed, openings, at.episode.is_placed, hollows.is_container)
    return inside.sum().astype(jnp.float32)


def _contained_added(at: Placing) -> Array:
    hollows, openings = _hollows(at)
    holds = hollows.is_container & at.episode.is_placed
    return jnp.any(pairs_in(at.proposed, openings) & holds, axis=1).astype(jnp.float32)


def _num_able_to_be_contained(at: Placing) -> Array:
    hollows, _ = _hollows(at)
    index = at.episode.object_index
    is_left = (index >= 0) & (jnp.arange(len(index)) >= at.episode.slot)
    fits = jnp.any(hollows.fits & at.episode.is_placed, axis=1)
    return jnp.sum(fits[jnp.maximum(index, 0)] & is_left).astype(jnp.float32)


def _hollows(at: Placing) -> tuple[Hollows, Boxes]:
    assert at.hollows is not None and at.openings is not None
    return at.hollows, at.openings


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
    placed, proposed = Views.of(at.placed), Views.of(at.proposed)
    seen = seen_shares(placed, at.episode.is_placed)
    own = 1.0 - jnp.prod(1.0 - jnp.where(is_placed, hidden_shares(proposed, placed), 0.0), axis=1)
    by_it = jnp.moveaxis(hidden_shares(placed, proposed), 0, 1) * seen
    return (own + by_it.sum(1)).mean(-1)


FEATURES: dict[str, Feature] = {
    "stack": Feature(_num_on, lambda at: at.supporters.is_on.astype(jnp.float32)),
    "contained": Feature(_num_contained, _contained_added, num_able=_num_able_to_be_contained),
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
    remaining, added = [], []
    for name, target in clutter.targets.items():
        feature = FEATURES[name]
        asked = target * episode.num_slots if feature.is_mean else target
        # Not every object finds something to lie on: what is counted is asked of the first to come.
        able = left if feature.num_able is None else feature.num_able(at)
        share = left if feature.is_mean else jnp.maximum(_EARLY * able, 1.0)
        remaining.append((asked - feature.total(at)) / share)
        added.append(feature.added(at))
    return jnp.stack(remaining), jnp.stack(added, axis=1)


def safe_poses(poses: Array, is_placed: Array) -> Array:
    """Poses of objects that are not placed may be anything."""
    return jnp.where(is_placed[:, None], poses, jnp.eye(7, dtype=jnp.float32)[3])
