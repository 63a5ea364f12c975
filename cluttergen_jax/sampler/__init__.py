"""Scenes as JAX functions, sampled afresh (`make_sampler`) or drawn from a saved bank (`load_bank`); and the
environments in which scenes are placed an attempt at a time, for any trainer (`make_env`).
"""

from cluttergen_jax.sampler.environments import make_env, make_gym_env, make_sb3_env, make_vector_env
from cluttergen_jax.sampler.make import make_sampler
from cluttergen_jax.sampler.sampled import SampledScene
from cluttergen_jax.sampler.sampler import Sampler
from cluttergen_jax.sampler.stored import SceneBank, StoredArrays, StoredScene, load_bank

__all__ = [
    "SampledScene",
    "Sampler",
    "SceneBank",
    "StoredArrays",
    "StoredScene",
    "load_bank",
    "make_env",
    "make_gym_env",
    "make_sampler",
    "make_sb3_env",
    "make_vector_env",
]
