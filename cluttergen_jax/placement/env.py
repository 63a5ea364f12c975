"""The decision process as a Brax environment: one attempt per step, reset by itself, figures kept."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from cluttergen_jax.physics.brax_env import Env, State
from cluttergen_jax.placement.observation import ObservationConfig, observe
from cluttergen_jax.placement.region import KeepOut
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.scenes import Scenes, scenes_of
from cluttergen_jax.placement.types import Episode, Start
from cluttergen_jax.types import Array


class Ongoing(struct.PyTreeNode):
    """What the environment carries beside the observation.

    Attributes:
      episode: the one in progress.
      start, keep_out: how every episode of this environment begins.
      key: for the next reset.
      finished: the latest finished episode.
      num_finished: i32, episodes finished so far.
    """

    episode: Episode
    start: Start
    keep_out: KeepOut
    key: Array
    finished: Scenes
    num_finished: Array


class PlacementEnv(Env):
    """`brax.envs.Env`: place objects one after another, an attempt a step.

    `step` on a finished episode's last attempt returns its reward with done = 1 and the first observation
    of a new episode, drawn with a key carried in the state; `info["truncation"]` is always 0.
    `pipeline_state` is an `Ongoing`; metrics are of the latest attempt and the latest finished episode.
    """

    def __init__(self, rules: Rules, observation: ObservationConfig | None = None) -> None:
        self.rules = rules
        self.observation = observation or ObservationConfig()

    def reset(self, rng: Array, scene: Start | None = None, keep_out: KeepOut | None = None) -> State:
        """A new episode on an empty support, or around `scene`, outside `keep_out` (both optional)."""
        key_episode, key_next = jax.random.split(rng)
        episode = self.rules.begin(key_episode, keep_out=keep_out, start=scene)
        ongoing = Ongoing(
            episode=episode,
            start=Start(episode.poses, episode.is_placed),
            keep_out=episode.keep_out,
            key=key_next,
            finished=jax.tree.map(jnp.zeros_like, scenes_of(episode)),
            num_finished=jnp.int32(0),
        )
        return self._state(ongoing, jnp.float32(0), jnp.bool_(False))

    def step(self, state: State, action: Array) -> State:
        """One attempt with `action`, f32[4] in (0, 1)."""
        before: Ongoing = state.pipeline_state
        after, reward = self.rules.attempt(before.episode, action)
        is_over = after.is_over
        key_episode, key_next = jax.random.split(before.key)
        fresh = self.rules.begin(key_episode, keep_out=before.keep_out, start=before.start)
        ongoing = before.replace(
            episode=_where(is_over, fresh, after),
            key=jnp.where(is_over, key_next, before.key),
            finished=_where(is_over, scenes_of(after), before.finished),
            num_finished=before.num_finished + is_over.astype(jnp.int32),
        )
        return self._state(ongoing, reward, is_over)

    def _state(self, ongoing: Ongoing, reward: Array, is_over: Array) -> State:
        finished = ongoing.finished
        metrics = {
            "reward": reward,
            "success": finished.is_success.astype(jnp.float32),
            "num_placed": finished.is_placed.sum().astype(jnp.float32),
            "attempts_used": finished.counts.attempts.sum().astype(jnp.float32),
            "stable_steps": finished.counts.steps.sum().astype(jnp.float32),
            "num_finished": ongoing.num_finished.astype(jnp.float32),
        }
        return State(
            pipeline_state=ongoing,
            obs=observe(self.rules, ongoing.episode, self.observation),
            reward=reward,
            done=is_over.astype(jnp.float32),
            metrics=metrics,
            info={"truncation": jnp.float32(0)},
        )

    @property
    def observation_size(self) -> dict[str, Any]:
        """The shape of each observation; nested as the observation is."""
        state = jax.eval_shape(self.reset, jax.random.key(0))
        return jax.tree.map(lambda leaf: leaf.shape, state.obs)

    @property
    def action_size(self) -> int:
        """x, y, z and turn."""
        return 4

    @property
    def backend(self) -> str:
        """The engine's class."""
        return type(self.rules.physics).__name__


def _where(condition: Array, yes: Any, no: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)
