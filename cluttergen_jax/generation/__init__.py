"""Scenes as JAX functions, sampled afresh (`make_sampler`) or drawn from a bank (`load_bank`), and as banks.

`generation.environments` makes environments in which scenes are placed an attempt at a time, for any trainer;
it is imported by itself, as Brax takes a second to load.
"""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import offer

if TYPE_CHECKING:
    from cluttergen_jax.generation.arguments import required_recipe
    from cluttergen_jax.generation.bank import BankArrays, load_bank, stream_bank
    from cluttergen_jax.generation.bank_world import BankAttachment, BankWorld, WorldState
    from cluttergen_jax.generation.sampler import Sampler, make_sampler
    from cluttergen_jax.generation.single import body_of, problem_alone
    from cluttergen_jax.generation.sources.replay import setup_of

__getattr__, __all__ = offer(
    __name__,
    {
        "arguments": ("required_recipe",),
        "bank": ("BankArrays", "load_bank", "stream_bank"),
        "bank_world": ("BankAttachment", "BankWorld", "WorldState"),
        "sampler": ("Sampler", "make_sampler"),
        "single": ("body_of", "problem_alone"),
        "sources.replay": ("setup_of",),
    },
)
