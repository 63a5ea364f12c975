"""Geometric placers that a learned policy has to beat: `random`, `clear`, `drop` and `spread`."""

from __future__ import annotations

from collections.abc import Callable

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.baselines.clear import Clear
from cluttergen_jax.placement.baselines.lowest import LowestFit, cost_of_lowest_fit
from cluttergen_jax.placement.baselines.random import Random
from cluttergen_jax.placement.baselines.spread import Spread
from cluttergen_jax.placement.rules import Proposer, Rules

__all__ = ["BASELINES", "Clear", "LowestFit", "Spread", "cost_of_lowest_fit", "make_proposer"]

BASELINES: dict[str, Callable[[Rules], Proposer]] = {
    "random": Random,
    "clear": Clear,
    "drop": LowestFit,
    "spread": Spread.of,
}


def make_proposer(method: str, rules: Rules) -> Proposer:
    """The baseline called `method`, for the world behind `rules`.

    Raises:
      ConfigError: there is no such method.
    """
    if method not in BASELINES:
        raise ConfigError(f"method {method!r}", ", ".join(BASELINES), "method='clear'")
    return BASELINES[method](rules)
