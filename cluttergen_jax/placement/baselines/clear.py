"""A random position that keeps clear of the placed objects by their true footprints."""

from __future__ import annotations

import jax.numpy as jnp

from cluttergen_jax.placement.baselines.lowest import cost_of_lying
from cluttergen_jax.placement.search.search import CandidateScores, Search
from cluttergen_jax.types import Array

_CLEAR = -10.0


class Clear(Search, eq=False):
    """Many cheap geometric tries per attempt; the first on bare, whole ground is taken.

    Candidates are uniform, so those that pass are uniform over the free poses. If none passes, the object is
    lowered to where it would lie lowest and best, as by `drop`.
    """

    def cost(self, scores: CandidateScores) -> Array:
        """See `Search`."""
        is_clear = (scores.fit.blocked == 0) & (scores.fit.hanging == 0)
        return jnp.where(is_clear, _CLEAR, cost_of_lying(scores))
