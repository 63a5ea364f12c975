"""A uniform draw among candidates that a hand-made rule trusts: `guided` without its network."""

from __future__ import annotations

import jax.numpy as jnp

from cluttergen_jax.placement.baselines.lowest import LowestFit, costs_of_staying
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.search.trusted import Menu, TrustedSearch
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.types import Array

_SCALE = 1.0
"""Of the cost in the exponent: 0.9 is trusted up to a cost of 0.105, 0.6 up to 0.51."""


class Spread(TrustedSearch, eq=False):
    """Trusts what rests with little gap and would not tip, by the two costs of `drop`."""

    @staticmethod
    def of(rules: Rules) -> Spread:
        """For one world, with `drop`'s finalists."""
        return Spread(LowestFit(rules))

    def trust(self, episode: Episode, menu: Menu) -> Array:
        """See `TrustedSearch`."""
        return jnp.exp(-sum(costs_of_staying(menu.found.scores)) / _SCALE)
