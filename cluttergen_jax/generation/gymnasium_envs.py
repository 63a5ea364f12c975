"""The decision process for Gymnasium: one scene at a time, or many, NumPy arrays in and out."""

from __future__ import annotations

from functools import partial
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.generation.arguments import required_recipe
from cluttergen_jax.generation.wrappers import ActionRange
from cluttergen_jax.numerics import new_key
from cluttergen_jax.placement.brax_env import Env, State
from cluttergen_jax.placement.scenes import SceneBatch
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.types import Array

Info = dict[str, Any]
"""What Gymnasium calls info, options and metadata."""


class AttemptOutcome(struct.PyTreeNode):
    """What is told of one attempt.

    Attributes:
      obs: after it, before any reset.
      reward: f32.
      is_over: bool, it was the episode's last.
      info: "verdict" i32, a `types.Verdict`, the last check's where all slots have just been filled;
        "num_placed" i32, objects that this episode has placed; "is_success" bool, all of them stand.
    """

    obs: Any
    reward: Array
    is_over: Array
    info: dict[str, Array]


def attempt(env: Env, state: State, action: Array) -> tuple[State, AttemptOutcome]:
    """One attempt, and the state to go on from: that of a new episode if this one is over.

    The latest finished scene is kept over the reset.
    """
    after = env.step(state, action)
    is_over = after.pipeline_state.episode.is_over
    outcome = AttemptOutcome(after.obs, after.reward, is_over, _info(after))
    return _begin_where(is_over, env.reset(after.pipeline_state.key), after), outcome


def attempt_or_begin(env: Env, state: State, action: Array) -> tuple[State, AttemptOutcome]:
    """One attempt; or, if the episode was over before, a new one in its place, and the reward 0.

    The latest finished scene is kept over the reset.
    """
    was_over = state.done > 0
    after = env.step(state, action)
    now = _begin_where(was_over, env.reset(state.pipeline_state.key), after)
    reward = jnp.where(was_over, 0.0, after.reward)
    return now, AttemptOutcome(now.obs, reward, now.done > 0, _info(after))


def _info(state: State) -> dict[str, Array]:
    episode: Episode = state.pipeline_state.episode
    return {
        "verdict": episode.verdict,
        "num_placed": episode.slot - episode.first_slot,
        "is_success": episode.is_success,
    }


def _begin_where(condition: Array, fresh: State, state: State) -> State:
    """The fresh state in place of the other one, with what that has finished."""
    ongoing, obs, done = jax.tree.map(
        lambda new, old: jnp.where(condition, new, old),
        (fresh.pipeline_state, fresh.obs, fresh.done),
        (state.pipeline_state, state.obs, state.done),
    )
    kept = {name: getattr(state.pipeline_state, name) for name in ("finished", "num_finished")}
    return state.replace(pipeline_state=ongoing.replace(**kept), obs=obs, done=done)


def space_of(observation: Any) -> spaces.Space:
    """The space of one observation, from its arrays' shapes and types; nested as it is."""
    if isinstance(observation, dict):
        return spaces.Dict({name: space_of(part) for name, part in observation.items()})
    shape = observation.shape
    dtype = np.dtype(observation.dtype)
    if np.issubdtype(dtype, np.bool_):
        return spaces.Box(0, 1, shape, np.int8)
    if np.issubdtype(dtype, np.integer):
        return spaces.Box(0, np.iinfo(dtype).max, shape, dtype.type)
    return spaces.Box(-np.inf, np.inf, shape, np.float32)


def to_numpy(tree: Any) -> Any:
    """Arrays that may be written to, booleans as 0 and 1."""
    return jax.tree.map(_writable, jax.device_get(tree))


def _writable(array: np.ndarray) -> np.ndarray:
    return np.array(array, np.int8 if np.issubdtype(array.dtype, np.bool_) else None)


def spaces_of(env: ActionRange) -> tuple[spaces.Space, spaces.Box]:
    """The spaces of one scene: observations, then actions."""
    seen = jax.eval_shape(env.reset, new_key(0)).obs
    return space_of(seen), spaces.Box(env.low, env.high, (env.action_size,), np.float32)


class _Remade:
    """What is pickled and copied as the call that made it, with where it stands: its episodes, its generator.

    Attributes:
      recipe: that call; None if it was made by hand.
    """

    recipe: partial[Any] | None
    _kept: tuple[str, ...] = ("_state", "_np_random", "_np_random_seed")

    def __reduce__(self) -> tuple[Any, ...]:
        held = {name: getattr(self, name) for name in self._kept if hasattr(self, name)}
        return required_recipe(self.recipe, "make_gym_env or make_vector_env"), (), held


class GymnasiumEnv(_Remade, gymnasium.Env):
    """One scene; see `make_gym_env`.

    `info` has, after each step, "verdict", "num_placed" and "is_success" (`AttemptOutcome`). Nothing is
    truncated.

    Attributes:
      scene: the latest finished scene, arrays of NumPy; None before there is one.
    """

    metadata: Info = {"render_modes": []}  # noqa: RUF012  Gymnasium looks for it on the class.

    _kept = (*_Remade._kept, "scene")

    def __init__(self, env: ActionRange, recipe: partial[Any] | None = None) -> None:
        self.recipe = recipe
        self.observation_space, self.action_space = spaces_of(env)
        self._reset = jax.jit(env.reset)
        self._attempt = jax.jit(partial(attempt, env))
        self._state: State | None = None
        self.scene: SceneBatch | None = None

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Any, Info]:
        """A new episode; `options` has no entries."""
        super().reset(seed=seed)
        _check_options(options)
        self._state = self._reset(_key(self.np_random))
        return to_numpy(self._state.obs), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, Info]:
        """One attempt with `action`, f32[4]. After the episode's last one, `reset` has to follow."""
        before = _check_step(self._state, action, self.action_space)
        self._state, outcome = self._attempt(before, np.asarray(action, np.float32))
        obs = to_numpy(outcome.obs)
        outcome = jax.device_get(outcome.replace(obs=None))
        if is_over := bool(outcome.is_over):
            self.scene = jax.device_get(self._state.pipeline_state.finished)
            self._state = None
        info = {name: value.item() for name, value in outcome.info.items()}
        return obs, float(outcome.reward), is_over, False, info


class GymnasiumVectorEnv(_Remade, VectorEnv):
    """N scenes, simulated together; see `make_vector_env`.

    `infos` is as that of `gymnasium.vector.SyncVectorEnv`: "verdict", "num_placed" and "is_success"
    (`AttemptOutcome`), [N] each, with their masks "_verdict" and so on. With `AutoresetMode.SAME_STEP`, where
    an episode has ended they are in `infos["final_info"]`, and its last observation in
    `infos["final_obs"][i]`; with `NEXT_STEP` they are masked where an episode has just begun. Nothing is
    truncated.
    """

    def __init__(
        self,
        env: ActionRange,
        num_envs: int,
        autoreset: AutoresetMode = AutoresetMode.SAME_STEP,
        recipe: partial[Any] | None = None,
    ) -> None:
        self.metadata = {"render_modes": [], "autoreset_mode": autoreset}
        self.num_envs = num_envs
        self.recipe = recipe
        self._is_same_step = autoreset == AutoresetMode.SAME_STEP
        step = attempt if self._is_same_step else attempt_or_begin
        self.single_observation_space, self.single_action_space = spaces_of(env)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._reset = jax.jit(jax.vmap(env.reset))
        self._attempt = jax.jit(jax.vmap(partial(step, env)))
        self._state: State | None = None

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Any, Info]:
        """New episodes of all scenes, each with a key of its own; `options` has no entries."""
        super().reset(seed=seed)
        _check_options(options)
        self._state = self._reset(jax.random.split(_key(self.np_random), self.num_envs))
        return to_numpy(self._state.obs), {}

    def step(self, actions: Any) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, Info]:
        """One attempt of each scene with `actions`, f32[N, 4]."""
        before = _check_step(self._state, actions, self.action_space)
        was_over = np.asarray(before.done) > 0
        self._state, outcome = self._attempt(before, np.asarray(actions, np.float32))
        reward, is_over, info = jax.device_get((outcome.reward, outcome.is_over, outcome.info))
        infos = _with_masks(info, ~is_over if self._is_same_step else ~was_over)
        if self._is_same_step and is_over.any():
            infos |= self._final(outcome, is_over, info)
        return (
            to_numpy(self._state.obs),
            np.array(reward),
            np.array(is_over),
            np.zeros_like(is_over),
            infos,
        )

    def _final(
        self, outcome: AttemptOutcome, is_over: np.ndarray, info: dict[str, np.ndarray]
    ) -> Info:
        """The last observations and infos of episodes that have ended."""
        last = np.full(self.num_envs, None, dtype=object)
        seen = to_numpy(outcome.obs)
        for index in np.flatnonzero(is_over):
            last[index] = jax.tree.map(lambda leaf, i=index: leaf[i], seen)
        final = {"final_obs": last, "final_info": _with_masks(info, is_over)}
        return final | {f"_{name}": is_over.copy() for name in final}

    @property
    def scenes(self) -> SceneBatch:
        """Each environment's latest finished scene, arrays [N, ...] of NumPy; zeros before there is one."""
        if self._state is None:
            raise gymnasium.error.ResetNeeded("there are no scenes before reset() has been called")
        return jax.device_get(self._state.pipeline_state.finished)


def _with_masks(info: dict[str, np.ndarray], mask: np.ndarray) -> dict[str, np.ndarray]:
    """Gymnasium's way to say which of the values count; none if no value does."""
    if not mask.any():
        return {}
    return {name: np.where(mask, value, np.zeros_like(value)) for name, value in info.items()} | {
        f"_{name}": mask.copy() for name in info
    }


def _key(random: np.random.Generator) -> Array:
    return new_key(random.integers(2**32, dtype=np.uint32))


def _check_options(options: Info | None) -> None:
    if options:
        raise ConfigError(f"options = {options!r} in reset", "none", "the settings of make_env")


def _check_step(state: State | None, action: Any, space: spaces.Box) -> State:
    """The state, which is there, and which an action of its space meets."""
    if state is None:
        raise gymnasium.error.ResetNeeded(
            "reset() has to be called before the first step of an episode"
        )
    if np.shape(action) != space.shape:
        raise ConfigError(f"an action of shape {np.shape(action)}", f"shape {space.shape}")
    is_nan = np.isnan(np.asarray(action, np.float32)).reshape(-1, space.shape[-1]).any(1)
    if is_nan.any():
        where = "" if len(space.shape) == 1 else f" of environment {int(is_nan.argmax())}"
        raise ConfigError(
            f"an action{where} with NaN",
            f"numbers from {space.low.min():g} to {space.high.max():g}; beyond they are clipped",
            "a smaller learning rate, if a network gave it",
        )
    return state
