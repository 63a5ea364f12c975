"""Cluttered, physically stable, diverse tabletop scenes on JAX and MuJoCo.

    sample = cluttergen_jax.make_sampler(pool="dining", num_objects=10)    # sample(key) -> SampledScene
    bank = cluttergen_jax.load_bank("out")                                 # bank.reset(key) -> StoredScene

sampler: both of these. methods: baselines and policies by name.
problem: from names to a compiled world, its physics and its rules (`make_problem`).
placement: the decision process; `placement.env.PlacementEnv` is a Brax environment.
baselines, policies: who proposes poses. sampling: whole episodes in compiled blocks.
bank: scenes on disk. render: pictures. importing: from any mesh to a sound body. training: PPO.
Below them: world, agent; assets, physics, networks; types, config, errors.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cluttergen_jax.sampler import (
        SampledScene,
        Sampler,
        SceneBank,
        StoredScene,
        load_bank,
        make_sampler,
    )

__all__ = ["SampledScene", "Sampler", "SceneBank", "StoredScene", "load_bank", "make_sampler"]


def __getattr__(name: str) -> Any:
    """The names of `__all__`, imported when first asked for: JAX and MuJoCo take a second to load."""
    if name in __all__:
        from cluttergen_jax import sampler

        return getattr(sampler, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
