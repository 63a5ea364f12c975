"""What would bear an object at a candidate pose, and how safely that stands itself."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

from cluttergen_jax.placement.region import from_pose
from cluttergen_jax.placement.search.fit import Candidates, base_share, cells_under, touching
from cluttergen_jax.placement.search.search import SearchScene
from cluttergen_jax.placement.types import Geometry
from cluttergen_jax.types import Array

_SAFE = 0.1
_WORD = 32
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
    words = [
        jax.lax.reduce(
            jnp.where(
                place // _WORD == word, jnp.uint32(1) << (place % _WORD).astype(jnp.uint32), 0
            ),
            jnp.uint32(0),
            jax.lax.bitwise_or,
            (1,),
        )
        for word in range(-(-number // _WORD))
    ]
    bits = jnp.stack(words, axis=1)[:, :, None] >> jnp.arange(_WORD, dtype=jnp.uint32) & 1
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
