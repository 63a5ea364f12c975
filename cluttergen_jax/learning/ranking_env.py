"""The Brax environment in which an action is the number of a candidate pose; features of candidates."""

from __future__ import annotations

from dataclasses import KW_ONLY
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.placement.baselines import LowestFit
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.heightmap import HeightMap
from cluttergen_jax.placement.region import action_scale
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.search.fit import Candidates
from cluttergen_jax.placement.search.search import FORBIDDEN, Search, TopCandidates
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.types import Array


@struct.dataclass(eq=False)
class RankingEnv(PlacementEnv):
    """A `PlacementEnv` whose observation holds candidate poses and whose action picks one.

    Attributes:
      search: finds the poses, bound to the same rules; `LowestFit` if not given.
    """

    _: KW_ONLY
    search: Search | None = None

    def __post_init__(self) -> None:
        if self.search is None:
            object.__setattr__(self, "search", LowestFit(self.rules))

    def observe(self, episode: Episode) -> dict[str, Any]:
        """The observation with the candidates for the next attempt, in place of the history."""
        assert self.search is not None
        return with_candidates(self.search, episode, PlacementEnv.observe(self, episode))

    def pose_of(self, observation: dict[str, Any], action: Array) -> Array:
        """The pose f32[4] of candidate `action`, i32."""
        return observation["menu"]["action"][action]

    @property
    def action_size(self) -> int:
        """One whole number."""
        return 1


PATCH_SIDE = 8
"""Heights around a candidate are read on a grid of this many points a side."""

_PATCH_STEP = 0.03
_DEEPEST, _HIGHEST = -0.05, 0.3
_FAR = 0.2


def with_candidates(search: Search, episode: Episode, observation: dict[str, Any]) -> dict[str, Any]:
    """An observation with the candidates for the next attempt, drawn with the episode's own key.

    They stand under "menu", a name that stored training states count on. The history is left out: each
    candidate says how far it is from the failed attempts.
    """
    key = jax.random.fold_in(episode.key, jnp.sum(episode.counts.attempts))
    seen = {name: value for name, value in observation.items() if name != "history"}
    return seen | {"menu": candidate_features(search.rules, episode, search.shortlist(key, episode))}


def candidate_features(rules: Rules, episode: Episode, found: TopCandidates) -> dict[str, Array]:
    """A shortlist of M poses as a network reads it; lengths in decimetres, so that they are about 1.

    Returns:
      features: f32[M, 16 + PATCH_SIDE**2]: how it would lie, where it is, how far from the failed attempts,
        and the heights of the scene around it in the object's frame, relative to the support's top.
      cost: f32[M], the search's own, metres; is_allowed: bool[M].
      action: f32[M, 4].
    """
    region, scores, at = episode.region, found.scores, found.candidates
    half = region.half_extents
    reach = half - jnp.abs(at.xy)
    features = jnp.concatenate(
        [
            jnp.stack(
                [
                    10 * jnp.clip(scores.lift, _DEEPEST, _HIGHEST),
                    jnp.clip(scores.support, -1, 1),
                    100 * jnp.clip(scores.fit.gap, 0, 0.05),
                    scores.fit.blocked,
                    scores.fit.hanging,
                    scores.crowd,
                    10 * jnp.clip(scores.fit.rest, _DEEPEST, _HIGHEST),
                    10 * jnp.clip(found.cost, -0.2, 0.5),
                    jnp.cos(at.yaw),
                    jnp.sin(at.yaw),
                    10 * _distance_to_failed(rules, episode, at),
                    jnp.broadcast_to(episode.attempt / rules.config.max_attempts, at.yaw.shape),
                ],
                axis=1,
            ),
            at.xy / half,
            10 * jnp.clip(reach, 0, _FAR),
            10 * _patches(found.heights, at),
        ],
        axis=1,
    )
    return {
        "features": features,
        "cost": found.cost,
        "is_allowed": found.cost < FORBIDDEN / 2,
        "action": found.action,
    }


def _distance_to_failed(rules: Rules, episode: Episode, at: Candidates) -> Array:
    """f32[M], metres in plan, at most _FAR: to the nearest pose already tried in vain for this object."""
    history = episode.history
    lower, size = action_scale(episode.region, rules.height_range(episode))
    tried = lower[:2] + history.action[:, :2] * size[:2]
    distance = jnp.linalg.norm(at.xy[:, None] - tried, axis=-1)
    return jnp.min(jnp.where(history.is_tried, distance, _FAR), axis=1, initial=_FAR)


def _patches(heights: HeightMap, at: Candidates) -> Array:
    """f32[M, PATCH_SIDE**2], metres."""
    line = (np.arange(PATCH_SIDE) - (PATCH_SIDE - 1) / 2) * _PATCH_STEP
    x, y = (axis.reshape(-1) for axis in np.meshgrid(line, line, indexing="ij"))
    cos, sin = jnp.cos(at.yaw)[:, None], jnp.sin(at.yaw)[:, None]
    index = heights.index_of(cos * x - sin * y + at.xy[:, :1], sin * x + cos * y + at.xy[:, 1:])
    return jnp.clip(heights.at(index), _DEEPEST, _HIGHEST)
