"""Baselines by name."""

from __future__ import annotations

from cluttergen_jax.baselines.clear import Clear
from cluttergen_jax.baselines.random import Random
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.proposer import Proposer
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.search.lowest import LowestFit

METHODS = {"random": Random, "clear": Clear, "drop": LowestFit}


def make_proposer(method: str, rules: Rules) -> Proposer:
    """The baseline called `method`, for the world behind `rules`.

    Raises:
      ConfigError: there is no such method.
    """
    if method not in METHODS:
        raise ConfigError(f"method {method!r}", ", ".join(METHODS), "method='clear'")
    return METHODS[method](rules)
