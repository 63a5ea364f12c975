"""Geometric placers that a learned policy has to beat: `random`, `clear` and `drop`."""

from __future__ import annotations

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.baselines.clear import Clear
from cluttergen_jax.placement.baselines.lowest import LowestFit
from cluttergen_jax.placement.baselines.random import Random
from cluttergen_jax.placement.rules import Proposer, Rules

__all__ = ["BASELINES", "Clear", "LowestFit", "make_proposer"]

BASELINES = {"random": Random, "clear": Clear, "drop": LowestFit}


def make_proposer(method: str, rules: Rules) -> Proposer:
    """The baseline called `method`, for the world behind `rules`.

    Raises:
      ConfigError: there is no such method.
    """
    if method not in BASELINES:
        raise ConfigError(f"method {method!r}", ", ".join(BASELINES), "method='clear'")
    return BASELINES[method](rules)
