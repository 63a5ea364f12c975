"""Geometric placers that a learned policy has to beat: `random`, `clear` and `drop`."""

from cluttergen_jax.baselines.clear import Clear
from cluttergen_jax.baselines.methods import METHODS, make_proposer

__all__ = ["METHODS", "Clear", "make_proposer"]
