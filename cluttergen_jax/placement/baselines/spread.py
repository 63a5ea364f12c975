"""A uniform draw among candidates that a hand-made rule trusts: `guided` without its network."""

from __future__ import annotations

import jax.numpy as jnp

from cluttergen_jax.placement.baselines.lowest import LowestFit, costs_of_staying
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.search.trusted import CandidateSet, TrustedSearch
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.types import Array


class Spread(TrustedSearch, eq=False):
    """Trusts what rests with little gap and would not tip, by two of the costs of `drop`.

    A trust of 0.9 is a cost of 0.105: a gap of 3 mm under the base, or 0.05 less support than is enough.
    """

    @staticmethod
    def of(rules: Rules) -> Spread:
        """For one world, with `drop`'s finalists."""
        return Spread(LowestFit(rules))

    def trust(self, episode: Episode, candidates: CandidateSet) -> Array:
        """See `TrustedSearch`."""
        gap, tipping = costs_of_staying(candidates.found.scores)
        return jnp.exp(-(gap + tipping))
