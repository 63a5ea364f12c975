"""The search for poses on a map of what a camera saw: `placement.search` without the scene behind it."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

from cluttergen_jax.downstream.placer.query import PlacementQuery
from cluttergen_jax.geometry import Array
from cluttergen_jax.placement import (
    CLEARANCE,
    Candidates,
    CandidateScores,
    HeightMap,
    SearchConfig,
    UnderSide,
    cost_of_lowest_fit,
    crowding,
    draw_candidates,
    lower_onto,
    make_region,
    mean_under,
    support_share,
)

APART = 0.03
"""Metres in plan between two proposals for one query."""


class MapCandidates(struct.PyTreeNode):
    """N candidates on one map, wholly looked at.

    Attributes:
      candidates: positions and turns, region frame.
      scores: what is known of them; cost: f32[N], metres, that of the baseline `drop`.
    """

    candidates: Candidates
    scores: CandidateScores
    cost: Array

    @property
    def pose(self) -> Array:
        """f32[N, 4]: x, y, z and yaw of T_region_object at which the object is let go."""
        height = self.scores.fit.rest + CLEARANCE
        return jnp.column_stack([self.candidates.xy, height, self.candidates.yaw])


def draw(key: Array, query: PlacementQuery, number: int) -> Candidates:
    """Uniform over one turn and over the query's region."""
    zero = jnp.zeros(2)
    return draw_candidates(key, make_region(zero, query.region_half_extents, 0.0, 0.0), number)


def join(*parts: Candidates) -> Candidates:
    """All of them."""
    return jax.tree.map(lambda *arrays: jnp.concatenate(arrays), *parts)


def look(query: PlacementQuery, heights: HeightMap, candidates: Candidates) -> MapCandidates:
    """How the object would lie at each candidate, if `heights` were the scene."""
    scores = _scores(query, heights, candidates, query.under)
    support = support_share(query.under, heights, candidates, scores.fit.rest)
    scores = scores.replace(support=support)
    return MapCandidates(candidates, scores, cost_of_lowest_fit(scores))


def finalists(
    key: Array, query: PlacementQuery, heights: HeightMap, config: SearchConfig
) -> Candidates:
    """The cheapest of many random poses, looked at coarsely, on any map of the query."""
    candidates = draw(key, query, config.num_candidates)
    coarse = _scores(query, heights, candidates, query.under.first(config.num_coarse))
    return candidates.take(jax.lax.top_k(-cost_of_lowest_fit(coarse), config.num_finalists)[1])


def search(
    key: Array, query: PlacementQuery, heights: HeightMap, config: SearchConfig
) -> MapCandidates:
    """The finalists of many random poses, wholly looked at, as the baseline `drop` finds them."""
    return look(query, heights, finalists(key, query, heights, config))


def best_apart(cost: Array, xy: Array, number: int) -> Array:
    """i32[number]: the cheapest candidates, each at least `APART` from those before it.

    Where that leaves none, the cheapest of those that are left.

    Args:
      cost: f32[N]; xy: f32[N, 2], metres; number: N at most.
    """

    cost = jnp.asarray(cost)
    xy = jnp.asarray(xy)

    def step(state: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], Array]:
        is_left, is_apart = state
        usable = jnp.where(jnp.any(is_apart), is_apart, is_left)
        index = jnp.argmin(jnp.where(usable, cost, jnp.inf))
        is_left = is_left.at[index].set(False)
        far = jnp.linalg.norm(xy - xy[index], axis=1) >= APART
        return (is_left, is_apart & is_left & far), index

    everything = jnp.ones(cost.shape, bool)
    return jax.lax.scan(step, (everything, everything), None, number)[1]


def _scores(
    query: PlacementQuery, heights: HeightMap, candidates: Candidates, under: UnderSide
) -> CandidateScores:
    """What is known of candidates without a look at what carries them, from some of the object's columns."""
    fit = lower_onto(under, heights, candidates)
    crowd = mean_under(query.under.first(SearchConfig().num_coarse), crowding(heights), candidates)
    lift = fit.rest - query.half_extents[2]
    return CandidateScores(fit, lift, jnp.ones_like(lift), crowd, jnp.int32(0))
