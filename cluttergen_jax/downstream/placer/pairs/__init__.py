"""Pairs to learn stable placement from: how they are made, stored and read."""

from cluttergen_jax.downstream.placer.pairs.store import PairSet, load_queries, read_pairs

__all__ = ["PairSet", "load_queries", "read_pairs"]
