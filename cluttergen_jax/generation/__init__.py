"""Scenes as JAX functions, sampled afresh (`make_sampler`) or drawn from a bank (`load_bank`), and as banks.

`generation.environments` makes environments in which scenes are placed an attempt at a time, for any trainer;
it is imported by itself, as Brax takes a second to load.
"""

from cluttergen_jax.generation.bank import BankArrays, load_bank, stream_bank
from cluttergen_jax.generation.sampler import Sampler, make_sampler

__all__ = ["BankArrays", "Sampler", "load_bank", "make_sampler", "stream_bank"]
