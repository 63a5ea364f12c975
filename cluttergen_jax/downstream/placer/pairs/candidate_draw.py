"""Candidate poses of a pair, whose verdicts a placer learns from: found on two maps, and at random."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.downstream.placer.map_search import draw, finalists, look
from cluttergen_jax.downstream.placer.query import PlacementQuery
from cluttergen_jax.numerics import new_key
from cluttergen_jax.placement import (
    CLEARANCE,
    Candidates,
    Episode,
    HeightMap,
    LowestFit,
    Rules,
    SearchConfig,
    draw_candidates,
)
from cluttergen_jax.types import Array

# Sources: a search on the true map, one on what the camera saw, and poses drawn uniformly.
TRUE_MAP = 0
PARTIAL_MAP = 1
RANDOM = 2

_NUM_TRUE = 12
_NUM_SEEN = 6
_NUM_CEILING = 6
_NUM_RANDOM_SEEN = 5
_NUM_RANDOM_CEILING = 3
_SEARCH = SearchConfig(num_candidates=192, num_finalists=6)
_NUM_UNIFORM = 24
_HIGHEST_COST = 0.5
"""Metres: candidates that cost so much or more are drawn a third as often as those that cost nothing."""

SOURCES = np.repeat(
    np.array([TRUE_MAP, PARTIAL_MAP, RANDOM], np.uint8),
    [_NUM_TRUE, _NUM_SEEN + _NUM_CEILING, _NUM_RANDOM_SEEN + _NUM_RANDOM_CEILING],
)
"""u8[32]: the source of each candidate of a pair."""


class CandidateDraw:
    """Draws the candidates of many pairs at once.

    Twelve are of a search on the true map and twelve of one on the partial maps, half of these as if what is
    hidden were free, half as if it were taken. A search draws among uniform poses that are lowered to first
    contact, and the finalists of many such, with chances that fall with the cost of `drop`: few of its best
    ever fail. Eight are uniform over region and turn, lowered onto a partial map. All are let go `CLEARANCE`
    above first contact.

    Args:
      rules: of the world.
    """

    def __init__(self, rules: Rules) -> None:
        # Nothing is simulated here: worlds of equal sizes share what is compiled.
        self._search = LowestFit(replace(rules, physics=None), _SEARCH)  # type: ignore[arg-type]

    def __call__(self, seeds: np.ndarray, episodes: Episode, queries: PlacementQuery) -> np.ndarray:
        """f32[Q, 32, 4]: x, y, z and yaw of T_region_object; seeds: u32[Q]."""
        keys = jax.vmap(new_key)(seeds)
        return np.asarray(_draw_many(self._search, keys, episodes, queries))


def _draw_candidates(true: LowestFit, key: Array, episode: Episode, query: PlacementQuery) -> Array:
    keys = jax.random.split(key, 4)
    parts = [
        _by_search(keys[0], true, episode),
        _by_map(keys[1], query, query.heights, _NUM_SEEN),
        _by_map(keys[2], query, query.ceilings, _NUM_CEILING),
        _random(keys[3], query),
    ]
    return jnp.concatenate(parts)


_draw_many: Any = jax.jit(jax.vmap(_draw_candidates, in_axes=(None, 0, 0, 0)))


def _by_search(key: Array, true: LowestFit, episode: Episode) -> Array:
    key_many, key_few, key_choice = jax.random.split(key, 3)
    scene = true.scene(episode)
    many = draw_candidates(key_many, episode.region, _SEARCH.num_candidates)
    few = draw_candidates(key_few, episode.region, _NUM_UNIFORM)
    found = true.closely(scene, _concatenate(true.best(scene, many, _SEARCH.num_finalists), few))
    height = found.scores.fit.rest + CLEARANCE
    pose = jnp.column_stack([found.candidates.xy, height, found.candidates.yaw])
    return pose[_choose(key_choice, found.cost, _NUM_TRUE)]


def _by_map(key: Array, query: PlacementQuery, heights: HeightMap, number: int) -> Array:
    key_many, key_few, key_choice = jax.random.split(key, 3)
    best = finalists(key_many, query, heights, _SEARCH)
    found = look(query, heights, _concatenate(best, draw(key_few, query, _NUM_UNIFORM)))
    return found.pose[_choose(key_choice, found.cost, number)]


def _concatenate(first: Candidates, second: Candidates) -> Candidates:
    return jax.tree.map(lambda *parts: jnp.concatenate(parts), first, second)


def _random(key: Array, query: PlacementQuery) -> Array:
    candidates = draw(key, query, _NUM_RANDOM_SEEN + _NUM_RANDOM_CEILING)
    parts = (slice(0, _NUM_RANDOM_SEEN), slice(_NUM_RANDOM_SEEN, None))
    maps = (query.heights, query.ceilings)
    return jnp.concatenate(
        [
            look(query, heights, candidates.take(jnp.arange(len(candidates.yaw))[part])).pose
            for heights, part in zip(maps, parts, strict=True)
        ]
    )


def _choose(key: Array, cost: Array, number: int) -> Array:
    """i32[number]: a draw without repetition, the cheaper the likelier (Gumbel's trick)."""
    cost = jnp.clip(cost, 0.0, _HIGHEST_COST)
    noise = jax.random.gumbel(key, cost.shape)
    return jax.lax.top_k(noise - cost / _HIGHEST_COST, number)[1]
