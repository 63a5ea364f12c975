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
from cluttergen_jax.generation.wrappers import ActionRange
from cluttergen_jax.numerics import new_key
from cluttergen_jax.placement.brax_env import Env, State
from cluttergen_jax.placement.scenes import SceneBatch
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.types import Array


class Outcome(struct.PyTreeNode):
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


def attempt(env: Env, state: State, action: Array) -> tuple[State, Outcome]:
    """One attempt, and the state to go on from: that of a new episode if this one is over.

    The latest finished scene is kept over the reset.
    """
    after = env.step(state, action)
    episode: Episode = after.pipeline_state.episode
    info = {
        "verdict": episode.verdict,
        "num_placed": episode.slot - episode.first_slot,
        "is_success": episode.is_success,
    }
    fresh = env.reset(after.pipeline_state.key)
    ongoing, obs = jax.tree.map(
        lambda new, old: jnp.where(episode.is_over, new, old),
        (fresh.pipeline_state, fresh.obs),
        (after.pipeline_state, after.obs),
    )
    kept = {name: getattr(after.pipeline_state, name) for name in ("finished", "num_finished")}
    state = after.replace(pipeline_state=ongoing.replace(**kept), obs=obs)
    return state, Outcome(after.obs, after.reward, episode.is_over, info)


def space_of(observation: Any) -> spaces.Space:
    """The space of one observation, from its arrays' shapes and types; nested as it is."""
    if isinstance(observation, dict):
        return spaces.Dict({name: space_of(part) for name, part in observation.items()})
    shape, dtype = observation.shape, np.dtype(observation.dtype)
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


class GymnasiumEnv(gymnasium.Env):
    """One scene; see `make_gym_env`.

    `info` has, after each step, "verdict", "num_placed" and "is_success" (`Outcome`). Nothing is truncated.

    Attributes:
      scene: the latest finished scene, arrays of NumPy; None before there is one.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  Gymnasium looks for it on the class.

    def __init__(self, env: ActionRange) -> None:
        self.observation_space, self.action_space = spaces_of(env)
        self._reset, self._attempt = jax.jit(env.reset), jax.jit(partial(attempt, env))
        self._state: State | None = None
        self.scene: SceneBatch | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """A new episode; `options` has no entries."""
        super().reset(seed=seed)
        _check_options(options)
        self._state = self._reset(_key(self.np_random))
        return to_numpy(self._state.obs), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One attempt with `action`, f32[4]. After the episode's last one, `reset` has to follow."""
        _check_action(action, self.action_space, self._state)
        self._state, outcome = self._attempt(self._state, np.asarray(action, np.float32))
        obs, outcome = to_numpy(outcome.obs), jax.device_get(outcome.replace(obs=None))
        if is_over := bool(outcome.is_over):
            self.scene, self._state = jax.device_get(self._state.pipeline_state.finished), None
        info = {name: value.item() for name, value in outcome.info.items()}
        return obs, float(outcome.reward), is_over, False, info


class GymnasiumVectorEnv(VectorEnv):
    """N scenes, simulated together; see `make_vector_env`.

    `infos` is as that of `gymnasium.vector.SyncVectorEnv`: "verdict", "num_placed" and "is_success"
    (`Outcome`), [N] each, with their masks "_verdict" and so on; where an episode has ended they are in
    `infos["final_info"]`, and its last observation in `infos["final_obs"][i]`. Nothing is truncated.
    """

    def __init__(self, env: ActionRange, num_envs: int) -> None:
        self.metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = spaces_of(env)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._reset, self._attempt = jax.jit(jax.vmap(env.reset)), jax.jit(jax.vmap(partial(attempt, env)))
        self._state: State | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """New episodes of all scenes, each with a key of its own; `options` has no entries."""
        super().reset(seed=seed)
        _check_options(options)
        self._state = self._reset(jax.random.split(_key(self.np_random), self.num_envs))
        return to_numpy(self._state.obs), {}

    def step(self, actions: Any) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One attempt of each scene with `actions`, f32[N, 4]."""
        _check_action(actions, self.action_space, self._state)
        self._state, outcome = self._attempt(self._state, np.asarray(actions, np.float32))
        reward, is_over, info = jax.device_get((outcome.reward, outcome.is_over, outcome.info))
        infos = _masked(info, ~is_over)
        if is_over.any():
            infos |= self._final(outcome, is_over, info)
        return to_numpy(self._state.obs), np.array(reward), np.array(is_over), np.zeros_like(is_over), infos

    def _final(self, outcome: Outcome, is_over: np.ndarray, info: dict[str, np.ndarray]) -> dict[str, Any]:
        """The last observations and infos of episodes that have ended."""
        last = np.full(self.num_envs, None, dtype=object)
        seen = to_numpy(outcome.obs)
        for index in np.flatnonzero(is_over):
            last[index] = jax.tree.map(lambda leaf, i=index: leaf[i], seen)
        final = {"final_obs": last, "final_info": _masked(info, is_over)}
        return final | {f"_{name}": is_over.copy() for name in final}

    @property
    def scenes(self) -> SceneBatch:
        """Each environment's latest finished scene, arrays [N, ...] of NumPy; zeros before there is one."""
        if self._state is None:
            raise gymnasium.error.ResetNeeded("there are no scenes before reset() has been called")
        return jax.device_get(self._state.pipeline_state.finished)


def _masked(info: dict[str, np.ndarray], mask: np.ndarray) -> dict[str, np.ndarray]:
    """Gymnasium's way to say which of the values count; none if no value does."""
    if not mask.any():
        return {}
    return {name: np.where(mask, value, np.zeros_like(value)) for name, value in info.items()} | {
        f"_{name}": mask.copy() for name in info
    }


def _key(random: np.random.Generator) -> Array:
    return new_key(random.integers(2**32, dtype=np.uint32))


def _check_options(options: dict[str, Any] | None) -> None:
    if options:
        raise ConfigError(f"options = {options!r} in reset", "none", "the settings of make_env")


def _check_action(action: Any, space: spaces.Space, state: State | None) -> None:
    if state is None:
        raise gymnasium.error.ResetNeeded("reset() has to be called before the first step of an episode")
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
