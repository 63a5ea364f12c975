"""From names to an environment that other trainers can learn in: Brax's, Gymnasium's, Stable-Baselines3's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import jax
import jax.numpy as jnp

from cluttergen_jax.config import Change, check_range, check_whole
from cluttergen_jax.errors import ConfigError, MissingExtraError
from cluttergen_jax.generation.wrappers import ActionRange, FlatObservation, OnSurface
from cluttergen_jax.learning.methods import Method, choose_method, proposer_of, with_history_of
from cluttergen_jax.numerics import with_own_settings
from cluttergen_jax.placement.brax_env import Env
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.methods.table import TARGETS, entry_of
from cluttergen_jax.placement.observation import ObservationConfig
from cluttergen_jax.placement.problem import make_setup
from cluttergen_jax.scene.bank.scene import read_start
from cluttergen_jax.spec import SceneOptions, SceneSpec, spec_of, takes_spec

if TYPE_CHECKING:
    from gymnasium.vector import AutoresetMode

    from cluttergen_jax.generation.gymnasium_envs import GymnasiumEnv, GymnasiumVectorEnv
    from cluttergen_jax.generation.sb3_env import SB3VecEnv

OBSERVATIONS = ("flat", "dict")
ACTIONS = ("pose", "surface")
_OF_METHODS = ("height", *TARGETS, "clearance", "crowd")
"""Fields of a `SceneSpec` that a method brings about."""
_NOT_TAKEN = {
    **dict.fromkeys(
        ("shelf", "weights", "balance"), "by which blocks draw worlds: an environment is one world"
    ),
    "sets": "which scenes of a bank have",
    "poses": "of which observations, clouds of upright objects, show nothing",
}
"""Fields of a `SceneSpec` that an environment does not take, and why."""


@with_own_settings
@takes_spec(_NOT_TAKEN)
def make_env(
    spec: SceneSpec | str | Path | None = None,
    *,
    observation: str = "flat",
    action: str = "pose",
    action_range: tuple[float, float] = (-1.0, 1.0),
    reward: str = "compressed",
    auto_reset: bool = True,
    num_cells: int = 8,
    history_stride: int = 12,
    num_scene_points: int = 0,
    change: Change = "none",
    **options: Unpack[SceneOptions],
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

    With a `method` the environment has `propose(key, state)`, its action where an episode is, to compare with
    or to learn from; rules that are not given are then the method's own.

    The arguments that are not explained here are those of `SceneSpec`; without a method the order is "random"
    and nothing is taken away unless it is asked for.

    Args:
      spec: what is asked for, or a pool's name.
      observation: "flat" for one vector f32[D] (`generation.wrappers.FlatObservation` lists its parts), or
        "dict" for what `placement.observation.observe` describes.
      action: "pose" for those four numbers, or "surface" for f32[3], x, y and turn: the height is that at
        which the object stands on the support, which is much easier to learn but stacks nothing.
      action_range: of all numbers; (0.0, 1.0) is the contract's own.
      reward: of an attempt: "compressed", 1 if the object stays there and less the more it moved; "paper" or
        "code", the published ones, which reach into hundreds and thousands (`placement.rules`).
      auto_reset: begin the next episode in the step that ends one; if not, whoever trains resets.
      num_cells: G, cells along each side of the region whose heights are told, 0 to 256; 0 for none.
      history_stride: rows of a failed attempt's trajectory that are told: each so many, 0 to 240; with 0
        nothing is told of failed attempts.
      num_scene_points: points of the scene's cloud, with "dict" alone; 0 for none.
      change: how the region is changed at random in every episode: "none", "translation", "rotation",
        "shrinkage", "expansion" or "all".
      options: fields of `SceneSpec`, in place of those of `spec`; what only a method brings about needs a
        `method`.

    Raises:
      ConfigError: a setting is out of range or contradicts another.
      PoolError: a pool, an object or a support cannot be found or read.
      BankError: the scene to start from cannot be read, or does not stand.
    """
    asked = spec_of(make_env, spec, options)
    check_whole(
        num_cells=num_cells, history_stride=history_stride, num_scene_points=num_scene_points
    )
    _check_choices(observation, action)
    observed = ObservationConfig(num_scene_points=num_scene_points, num_cells=num_cells)
    method = _method_of(asked, action, history_stride)
    asked.check_sense()
    pool = asked.find_pool()
    config = asked.problem_config(method and method.name, pool)
    placement = replace(config.placement, reward=reward, history_stride=history_stride)
    config = replace(config, placement=placement, change=change)
    setup = make_setup(config, asked.boxes(), read_start(asked.start), pool=pool)
    rules = setup.problem.rules
    env: Env = PlacementEnv(
        rules,
        observed,
        auto_reset=auto_reset,
        start=setup.start,
        keep_out=setup.keep_out,
        method=method and proposer_of(*method, rules),
    )
    if observation == "flat":
        env = FlatObservation(env)
    if action == "surface":
        env = OnSurface(env, rules)
    return ActionRange(env, *action_range)


def _method_of(asked: SceneSpec, action: str, history_stride: int) -> Method | None:
    """Who proposes in an environment beside whoever acts in it; None if nobody was asked for."""
    if asked.method is None and asked.checkpoint is None:
        if given := [name for name in _OF_METHODS if name in asked.overrides()]:
            raise ConfigError(
                f"{given[0]} = {getattr(asked, given[0])!r} in an environment without a method",
                "nothing that methods alone bring about: here someone else acts",
                "method='spread', which then proposes beside who acts, or leaving it out",
            )
        return None
    method = choose_method(asked.method, asked.pool_text, asked.checkpoint)
    asked.check_method(method.name)
    if entry_of(method.name).is_whole or action == "surface":
        raise ConfigError(
            f"method {str(method.name)!r} in an environment with action={action!r}",
            "a method that places one object after another, with action='pose'",
            "method='spread'",
        )
    looks_back = with_history_of(PlacementConfig(), method.checkpoint).history_stride
    if looks_back not in (0, history_stride):
        raise ConfigError(
            f"history_stride = {history_stride} with a method that was trained with {looks_back}",
            f"{looks_back}",
            f"history_stride={looks_back}",
        )
    return method


class EnvSettings(SceneOptions, total=False):
    """Arguments of `make_env` that environments made of it take."""

    observation: str
    action: str
    action_range: tuple[float, float]
    reward: str
    num_cells: int
    history_stride: int
    num_scene_points: int
    change: Change


@with_own_settings
def make_gym_env(
    spec: SceneSpec | str | Path | None = None, **settings: Unpack[EnvSettings]
) -> GymnasiumEnv:
    """A `gymnasium.Env` of one scene; `spec` and `settings` are those of `make_env`. Extra `gym`.

    Slow for training, as each step is a call of its own: see `make_vector_env`.

    Raises:
      MissingExtraError: Gymnasium is not installed; the others are those of `make_env`.
    """
    _need_gymnasium("make_gym_env")
    from cluttergen_jax.generation.gymnasium_envs import GymnasiumEnv

    env = _without_reset("make_gym_env", spec, settings)
    return GymnasiumEnv(env, partial(make_gym_env, spec, **settings))


@with_own_settings
def make_vector_env(
    num_envs: int = 64,
    spec: SceneSpec | str | Path | None = None,
    *,
    autoreset: str = "same_step",
    **settings: Unpack[EnvSettings],
) -> GymnasiumVectorEnv:
    """A `gymnasium.vector.VectorEnv`, all scenes simulated together.

    `spec` and `settings` are those of `make_env`. NumPy arrays in and out. Extra `gym`.

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

    recipe = partial(make_vector_env, num_envs, spec, autoreset=autoreset, **settings)
    mode = _mode_of(autoreset)
    return GymnasiumVectorEnv(
        _without_reset("make_vector_env", spec, settings), num_envs, mode, recipe
    )


def make_sb3_env(
    num_envs: int = 64, spec: SceneSpec | str | Path | None = None, **settings: Unpack[EnvSettings]
) -> SB3VecEnv:
    """`make_vector_env` as a `VecEnv` of Stable-Baselines3, as in `PPO("MlpPolicy", make_sb3_env(64))`.

    Episodes are watched as by its `VecMonitor`; `infos[i]["is_success"]` is there when one ends. Extra `sb3`.

    Raises:
      MissingExtraError: Stable-Baselines3 is not installed; the others are those of `make_vector_env`.
    """
    if "autoreset" in settings:
        raise ConfigError(
            "autoreset in make_sb3_env", "settings of make_env: Stable-Baselines3 has one way"
        )
    if settings.get("observation", "flat") != "flat":
        given = f"observation = {settings['observation']!r} in make_sb3_env"
        raise ConfigError(
            given, "'flat': Stable-Baselines3 knows no nested spaces", "observation='flat'"
        )
    try:
        import stable_baselines3  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("sb3", "make_sb3_env") from error
    from cluttergen_jax.generation.sb3_env import SB3VecEnv

    return SB3VecEnv(make_vector_env(num_envs, spec, **settings))


MAX_ENVS = 65_536


def _check_choices(observation: str, action: str) -> None:
    for name, value, allowed in (
        ("observation", observation, OBSERVATIONS),
        ("action", action, ACTIONS),
    ):
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


def _without_reset(purpose: str, spec: SceneSpec | str | Path | None, settings: EnvSettings) -> Env:
    """The environment that ends its episodes and leaves it at that."""
    if "auto_reset" in settings:
        raise ConfigError(f"auto_reset in {purpose}", "settings of make_env without it")
    return make_env(spec, **settings, auto_reset=False)


class _JaxAsBraxKnowsIt:
    """JAX with the function that Brax 0.14 asks for and JAX 0.10 has no more."""

    def __getattr__(self, name: str) -> Any:
        return getattr(jax, name)

    @staticmethod
    def device_put_replicated(tree: Any, devices: Sequence[Any]) -> Any:
        """The tree with a leading axis, one copy a device."""
        return jax.tree.map(lambda leaf: jnp.stack([leaf] * len(devices)), tree)


def train_brax(env: Env, num_timesteps: int, **settings: Any) -> tuple[Any, Any, dict[str, float]]:
    """`brax.training.agents.ppo.train.train` in an environment of `make_env`.

    Args:
      env: made with `auto_reset=False`: Brax brings resets of its own.
      num_timesteps: attempts in all.
      settings: Brax's own, such as `num_envs`, `learning_rate`, `network_factory` or `progress_fn`; its
        `episode_length` is the environment's unless it is given.

    Returns:
      What Brax returns: a function from parameters to a policy, the parameters, and figures.

    Raises:
      ConfigError: the environment resets itself.
    """
    from brax.training.agents.ppo import train as ppo

    if getattr(env, "auto_reset", False):
        raise ConfigError("an environment that resets itself", "make_env(..., auto_reset=False)")
    length = settings.pop("episode_length", None) or env.episode_length
    with _old_jax_in(ppo):
        return ppo.train(
            environment=env, num_timesteps=num_timesteps, episode_length=length, **settings
        )


@contextmanager
def _old_jax_in(module: Any) -> Iterator[None]:
    """While it is entered, one module sees a JAX with what JAX has no more; nobody else does."""
    module.jax = jax if hasattr(jax, "device_put_replicated") else _JaxAsBraxKnowsIt()
    try:
        yield
    finally:
        module.jax = jax
