"""Where an object could go: candidate poses lowered to first contact, by geometry alone."""

from cluttergen_jax.search.lowest import LowestFit
from cluttergen_jax.search.search import Search, SearchConfig, Shortlist

__all__ = ["LowestFit", "Search", "SearchConfig", "Shortlist"]
