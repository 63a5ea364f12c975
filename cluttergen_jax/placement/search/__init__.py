"""Where an object could go: candidate poses lowered to first contact, by geometry alone."""

from cluttergen_jax.placement.search.search import Search, SearchConfig, TopCandidates

__all__ = ["Search", "SearchConfig", "TopCandidates"]
