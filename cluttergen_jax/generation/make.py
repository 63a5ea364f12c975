"""From names to a sampler."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Unpack

from cluttergen_jax.config import check_range, check_whole
from cluttergen_jax.generation.sampler import Sampler
from cluttergen_jax.learning.methods import Method, choose_method, sampler_of, suited
from cluttergen_jax.numerics import with_own_settings
from cluttergen_jax.placement.observation import ObservationConfig
from cluttergen_jax.placement.setup import Setup, make_setup
from cluttergen_jax.scene.bank.reference import read_start
from cluttergen_jax.spec import SceneOptions, SceneSpec, spec_of, takes_spec

MAX_RETRIES = 10_000


@with_own_settings
@takes_spec(SceneOptions)
def make_sampler(
    spec: SceneSpec | str | Path | None = None,
    *,
    max_retries: int = 0,
    num_scene_points: int = 0,
    **options: Unpack[SceneOptions],
) -> Sampler:
    """A function `sample(key) -> SceneBatch` that may be compiled, mapped, scanned and sharded.

    Nothing random is decided here: equal keys give equal scenes, within the limits that docs/contract.md
    names. The arguments that are not explained here are those of `SceneSpec`.

    Args:
      spec: what is asked for, or a pool's name.
      max_retries: a scene that fails is drawn again up to so often, inside the compiled code, until one
        passes; 0 to 10,000.
      num_scene_points: points of each scene's cloud, up to 200,000; 0 for none.
      options: fields of `SceneSpec`, in place of those of `spec`.

    Raises:
      ConfigError: a setting is unknown, out of range, or contradicts another.
      PoolError: a pool, an object, a support or a checkpoint cannot be found or read.
      BankError: the scene to start from cannot be read, or does not stand.
    """
    asked = spec_of(make_sampler, spec, options)
    check_range("max_retries", max_retries, 0, MAX_RETRIES, 5)
    check_whole(num_scene_points=num_scene_points)
    ObservationConfig(num_scene_points=num_scene_points)
    method, setup = set_up(asked)
    return Sampler(
        problem=setup.problem,
        steps=sampler_of(setup, method),
        keep_out=setup.keep_out,
        start=setup.start,
        max_retries=max_retries,
        num_scene_points=num_scene_points,
        recipe=partial(
            make_sampler,
            **asked.overrides(),
            max_retries=max_retries,
            num_scene_points=num_scene_points,
        ),
    )


def set_up(spec: SceneSpec) -> tuple[Method, Setup]:
    """A method, and the problem compiled for it: with its rules, and the history that it looks back on.

    Raises:
      ConfigError, PoolError, BankError: see `make_sampler`.
    """
    method = choose_method(spec.method, spec.pool_text, spec.checkpoint)
    spec.check_method(method.name)
    config = spec.problem_config(method.name)
    config = replace(config, placement=suited(config.placement, method.checkpoint))
    return method, make_setup(config, spec.boxes(), read_start(spec.start))
