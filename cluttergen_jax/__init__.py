"""Cluttered, physically stable, diverse tabletop scenes on JAX and MuJoCo.

    sample = cluttergen_jax.make_sampler(pool="dining", num_objects=10)    # sample(key) -> SampledScene
    bank = cluttergen_jax.load_bank("out")                                 # bank.reset(key) -> StoredScene
    env = cluttergen_jax.make_env(pool="dining", num_objects=5)            # a Brax environment, to train in
    envs = cluttergen_jax.make_vector_env(64, pool="dining")               # a VectorEnv of Gymnasium
    bank = cluttergen_jax.load_bank("owner/name")                          # pulled from a hub

`Rectangle` tells `make_sampler` of a region or a keep-out box; `make_region` and `KeepOut` are for those of
`sample(key, region=..., keep_out=...)`, which may be traced. CONTRIBUTING.md says what the packages are.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cluttergen_jax.assets.support import Rectangle
    from cluttergen_jax.bank.hub import pull_bank, push_bank
    from cluttergen_jax.certification import certify
    from cluttergen_jax.evaluation.comparison import evaluate
    from cluttergen_jax.evaluation.running import evaluate_suite
    from cluttergen_jax.placement.region import KeepOut, make_region
    from cluttergen_jax.sampler import (
        SampledScene,
        Sampler,
        SceneBank,
        StoredArrays,
        StoredScene,
        load_bank,
        make_sampler,
    )
    from cluttergen_jax.sampler.environments import make_env, make_gym_env, make_sb3_env, make_vector_env

__all__ = [
    "KeepOut",
    "Rectangle",
    "SampledScene",
    "Sampler",
    "SceneBank",
    "StoredArrays",
    "StoredScene",
    "certify",
    "evaluate",
    "evaluate_suite",
    "load_bank",
    "make_env",
    "make_gym_env",
    "make_region",
    "make_sampler",
    "make_sb3_env",
    "make_vector_env",
    "pull_bank",
    "push_bank",
]

_ELSEWHERE = {
    "Rectangle": "assets.support",
    "KeepOut": "placement.region",
    "make_region": "placement.region",
    "certify": "certification",
    "evaluate": "evaluation.comparison",
    "evaluate_suite": "evaluation.running",
    "make_env": "sampler.environments",
    "make_gym_env": "sampler.environments",
    "make_sb3_env": "sampler.environments",
    "make_vector_env": "sampler.environments",
    "pull_bank": "bank.hub",
    "push_bank": "bank.hub",
}


def __getattr__(name: str) -> Any:
    """The names of `__all__`, imported when first asked for: JAX and MuJoCo take a second to load."""
    if name in __all__:
        return getattr(import_module(f"cluttergen_jax.{_ELSEWHERE.get(name, 'sampler')}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
