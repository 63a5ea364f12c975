"""A random position that keeps clear of the placed objects by their true footprints."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from cluttergen_jax.baselines.fit import draw_candidates, fit_candidates, widened
from cluttergen_jax.baselines.random import CLEARANCE
from cluttergen_jax.placement.heightmap import grid_shape, make_height_map
from cluttergen_jax.placement.region import action_of_pose
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.types import Array

_COARSE, _COARSE_COLUMNS = 128, 48
_FINE, _FINE_COLUMNS = 16, 1024


class Clear:
    """Many cheap geometric tries per attempt; the first on bare, whole ground is taken.

    Candidates are uniform, so those that pass are uniform over the free poses. If none passes, the one that
    is blocked the least is let down onto whatever lies below.
    """

    def __init__(self, rules: Rules) -> None:
        self.rules = rules
        self._shape = grid_shape(tuple(float(side) for side in rules.region.half_extents))

    def __call__(self, key: Array, episode: Episode) -> Array:
        """See `placement.proposer.Proposer`."""
        rules, geometry = self.rules, self.rules.geometry
        focus = rules.focus(episode)
        heights = make_height_map(geometry, episode.region, episode.poses, episode.is_placed, self._shape)
        heights = widened(heights, 1)
        candidates = draw_candidates(key, episode.region, _COARSE)
        coarse = fit_candidates(geometry, heights, focus, candidates, _COARSE_COLUMNS)
        _, best = jax.lax.top_k(-(coarse.blocked + coarse.hanging), _FINE)
        candidates = candidates.take(best)
        fine = fit_candidates(geometry, heights, focus, candidates, _FINE_COLUMNS)
        chosen = jnp.argmin(fine.blocked + fine.hanging)
        position = jnp.append(candidates.xy[chosen], fine.rest[chosen] + CLEARANCE)
        return action_of_pose(position, candidates.yaw[chosen], episode.region, rules.height_range(episode))
