"""Scenes as JAX functions: sampled afresh (`make_sampler`), or drawn from a saved bank (`load_bank`).

`sampler.environments` makes environments in which scenes are placed an attempt at a time, for any trainer;
it is imported by itself, as Brax takes a second to load.
"""

from cluttergen_jax.sampler.make import make_sampler
from cluttergen_jax.sampler.sampled import SampledScene
from cluttergen_jax.sampler.sampler import Sampler
from cluttergen_jax.sampler.stored import SceneBank, StoredArrays, StoredScene, load_bank

__all__ = ["SampledScene", "Sampler", "SceneBank", "StoredArrays", "StoredScene", "load_bank", "make_sampler"]
