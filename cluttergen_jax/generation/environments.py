"""From names to an environment that other trainers can learn in: Brax's, Gymnasium's, Stable-Baselines3's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Never

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.errors import ConfigError, MissingExtraError
from cluttergen_jax.generation.arguments import check_known
from cluttergen_jax.generation.wrappers import ActionRange, FlatObservation, OnSurface
from cluttergen_jax.learning.methods import rules_asked
from cluttergen_jax.numerics import with_own_settings
from cluttergen_jax.placement.brax_env import Env
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.observation import ObservationConfig
from cluttergen_jax.placement.setup import check_range, check_whole, make_setup, problem_config
from cluttergen_jax.scene.bank.reference import read_start

if TYPE_CHECKING:
    from gymnasium.vector import AutoresetMode

    from cluttergen_jax.generation.gymnasium_envs import GymnasiumEnv, GymnasiumVectorEnv
    from cluttergen_jax.generation.sb3_env import SB3VecEnv

OBSERVATIONS = ("flat", "dict")
ACTIONS = ("pose", "surface")


@with_own_settings
def make_env(
    pool: str | Path = "dining",
    support: str | Path = "table",
    num_objects: int | None = None,
    *,
    observation: str = "flat",
    action: str = "pose",
    action_range: tuple[float, float] = (-1.0, 1.0),
    reward: str = "compressed",
    auto_reset: bool = True,
    num_cells: int = 8,
    history_stride: int = 12,
    num_scene_points: int = 0,
    objects: Sequence[str] = (),
    exclude: Sequence[str] = (),
    repeat: bool = False,
    region: Rectangle | None = None,
    keep_out: Sequence[Rectangle] = (),
    start: str | None = None,
    change: str = "none",
    containment: str = "center",
    order: str | None = None,
    max_attempts: int = 5,
    ruin_after: int | None = None,
    budget: int | None = None,
    min_margin: float | None = None,
    robust: bool = False,
    setting: str = "default",
    overhang: str = "any",
    engine: str = "auto",
    num_threads: int = 0,
    **unknown: Never,
) -> Env:
    """A `brax.envs.Env` of the placement problem: one attempt a step, an episode a scene.

    `reset(key)` and `step(state, action)` are of one scene and may be compiled, mapped and scanned:
    `brax.envs.training.VmapWrapper(env)` is all that a trainer needs, as episodes end by themselves and begin
    anew, each with another order of objects. `brax.envs.training.wrap(env, env.episode_length)` works too;
    its own reset repeats the first episode of each of its environments, and it wants keys of
    `jax.random.PRNGKey`.

    Actions run from `action_range[0]` to `action_range[1]` and are clipped to them. They are f32[4]: x, y and
    z of the object's centre in a box over the queried region, and its turn (docs/contract.md, "Region and
    action").

    Args:
      pool, support, num_objects, objects, exclude, repeat, region, keep_out, start, containment, order,
        max_attempts, ruin_after, budget, min_margin, robust, setting, overhang, engine, num_threads:
        as in `make_sampler`; the order is "random" and nothing is taken away unless it is asked for.
      observation: "flat" for one vector f32[D] (`generation.wrappers.FlatObservation` lists its parts), or
        "dict" for what `placement.observation.observe` describes.
      action: "pose" for those four numbers, or "surface" for f32[3], x, y and turn: the height is that at
        which the object stands on the support, which is much easier to learn but stacks nothing.
      action_range: of all numbers; (0.0, 1.0) is the contract's own.
      reward: of an attempt: "compressed", 1 if the object stays there and less the more it moved; "paper" or
        "code", the published ones, which reach into hundreds and thousands (`placement.reward`).
      auto_reset: begin the next episode in the step that ends one; if not, whoever trains resets.
      num_cells: G, cells along each side of the region whose heights are told, 0 to 256; 0 for none.
      history_stride: rows of a failed attempt's trajectory that are told: each so many, 0 to 240; with 0
        nothing is told of failed attempts.
      num_scene_points: points of the scene's cloud, with "dict" alone; 0 for none.
      change: how the region is changed at random in every episode: "none", "translation", "rotation",
        "shrinkage", "expansion" or "all".

    Raises:
      ConfigError: a setting is out of range or contradicts another.
      PoolError: a pool, an object or a support cannot be found or read.
      BankError: the scene to start from cannot be read, or does not stand.
    """
    check_known(unknown, make_env)
    check_whole(num_cells=num_cells, history_stride=history_stride, num_scene_points=num_scene_points)
    _check_choices(observation, action)
    observed = ObservationConfig(num_scene_points=num_scene_points, num_cells=num_cells)
    given = locals()
    config = problem_config(given)
    config = replace(config, placement=replace(config.placement, **rules_asked(None, max_attempts, given)))
    setup = make_setup(config, keep_out, read_start(start))
    env: Env = PlacementEnv(
        setup.problem.rules,
        observed,
        auto_reset=auto_reset,
        start=setup.start,
        keep_out=setup.keep_out,
    )
    if observation == "flat":
        env = FlatObservation(env)
    if action == "surface":
        env = OnSurface(env, setup.problem.rules)
    return ActionRange(env, *action_range)


@with_own_settings
def make_gym_env(**settings: Any) -> GymnasiumEnv:
    """A `gymnasium.Env` of one scene; `settings` are those of `make_env`. Extra `gym`.

    Slow for training, as each step is a call of its own: see `make_vector_env`.

    Raises:
      MissingExtraError: Gymnasium is not installed; the others are those of `make_env`.
    """
    _need_gymnasium("make_gym_env")
    from cluttergen_jax.generation.gymnasium_envs import GymnasiumEnv

    return GymnasiumEnv(_without_reset("make_gym_env", settings), partial(make_gym_env, **settings))


@with_own_settings
def make_vector_env(
    num_envs: int = 64, *, autoreset: str = "same_step", **settings: Any
) -> GymnasiumVectorEnv:
    """A `gymnasium.vector.VectorEnv`, all scenes simulated together; `settings` are those of `make_env`.

    NumPy arrays in and out. Extra `gym`.

    Args:
      num_envs: scenes at a time, 1 to 65,536.
      autoreset: "same_step", where the step that ends an episode returns the next one's first observation,
        and the last one in `infos["final_obs"]`; or "next_step", where it returns the last one, and the step
        after it begins the next episode: its action counts for nothing, and its reward is 0.

    Raises:
      ConfigError: an argument is out of range; the others are those of `make_env`.
      MissingExtraError: Gymnasium is not installed.
    """
    check_range("num_envs", num_envs, 1, MAX_ENVS, 64)
    _need_gymnasium("make_vector_env")
    from cluttergen_jax.generation.gymnasium_envs import GymnasiumVectorEnv

    recipe = partial(make_vector_env, num_envs, autoreset=autoreset, **settings)
    mode = _mode_of(autoreset)
    return GymnasiumVectorEnv(_without_reset("make_vector_env", settings), num_envs, mode, recipe)


def make_sb3_env(num_envs: int = 64, **settings: Any) -> SB3VecEnv:
    """`make_vector_env` as a `VecEnv` of Stable-Baselines3, as in `PPO("MlpPolicy", make_sb3_env(64))`.

    Episodes are watched as by its `VecMonitor`; `infos[i]["is_success"]` is there when one ends. Extra `sb3`.

    Raises:
      MissingExtraError: Stable-Baselines3 is not installed; the others are those of `make_vector_env`.
    """
    if "autoreset" in settings:
        raise ConfigError("autoreset in make_sb3_env", "settings of make_env: Stable-Baselines3 has one way")
    try:
        import stable_baselines3  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("sb3", "make_sb3_env") from error
    from cluttergen_jax.generation.sb3_env import SB3VecEnv

    return SB3VecEnv(make_vector_env(num_envs, **settings))


MAX_ENVS = 65_536


def _check_choices(observation: str, action: str) -> None:
    for name, value, allowed in (("observation", observation, OBSERVATIONS), ("action", action, ACTIONS)):
        if value not in allowed:
            raise ConfigError(f"{name} = {value!r}", ", ".join(allowed), f"{name}={allowed[0]!r}")


def _mode_of(autoreset: str) -> AutoresetMode:
    """Gymnasium's word for it."""
    from gymnasium.vector import AutoresetMode

    modes = {"same_step": AutoresetMode.SAME_STEP, "next_step": AutoresetMode.NEXT_STEP}
    if autoreset not in modes:
        raise ConfigError(f"autoreset = {autoreset!r}", ", ".join(modes), 'autoreset="same_step"')
    return modes[autoreset]


def _need_gymnasium(purpose: str) -> None:
    try:
        import gymnasium  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("gym", purpose) from error


def _without_reset(purpose: str, settings: dict[str, Any]) -> Env:
    """The environment that ends its episodes and leaves it at that."""
    if "auto_reset" in settings:
        raise ConfigError(f"auto_reset in {purpose}", "settings of make_env without it")
    return make_env(**settings, auto_reset=False)
