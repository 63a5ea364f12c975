"""Environments for other trainers, beside `make_env`: Gymnasium, Stable-Baselines3, Brax."""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import name_space

if TYPE_CHECKING:
    from cluttergen_jax.generation.environments import (
        make_gym_env,
        make_sb3_env,
        make_vector_env,
        train_brax,
    )

__all__ = ["make_gym_env", "make_sb3_env", "make_vector_env", "train_brax"]

__getattr__, __dir__ = name_space(
    __name__,
    {
        "make_gym_env": "generation.environments:make_gym_env",
        "make_sb3_env": "generation.environments:make_sb3_env",
        "make_vector_env": "generation.environments:make_vector_env",
        "train_brax": "generation.environments:train_brax",
    },
)
