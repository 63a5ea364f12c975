"""The decision process as a Brax environment: one attempt per step, reset by itself, figures kept."""

from __future__ import annotations

from dataclasses import KW_ONLY
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.numerics import as_float32, new_key, with_own_settings
from cluttergen_jax.placement.brax_env import Env, State
from cluttergen_jax.placement.observation import Observation, ObservationConfig, observe
from cluttergen_jax.placement.region import KeepOut
from cluttergen_jax.placement.rules import Proposer, Rules
from cluttergen_jax.placement.scenes import SceneBatch, scene_of
from cluttergen_jax.placement.types import Episode, Start, choose
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
    finished: SceneBatch
    num_finished: Array


@struct.dataclass(eq=False)
class PlacementEnv(Env):
    """`brax.envs.Env`: place objects one after another, an attempt a step.

    With `auto_reset`, `step` on a finished episode's last attempt returns its reward with done = 1 and the
    first observation of a new episode, drawn with a key carried in the state. Without it the episode stays
    finished: done is 1 and the reward 0 for whatever follows, until somebody else resets.

    `pipeline_state` is an `Ongoing`; metrics are of the latest attempt and the latest finished episode.
    `info["truncation"]` is 0 after a reset. `step` hands on `info`, and metrics that are not its own, as it
    finds them, which is what Brax's wrappers build on.

    Attributes:
      rules: of the world.
      observation: how much of an episode is spelled out.
      auto_reset: begin the next episode in the step that ends one.
      start: what stands there when an episode begins; nothing if None.
      keep_out: where no object may come to lie.
      method: who proposes (`propose`), beside whoever acts; None for nobody.
    """

    rules: Rules
    observation: ObservationConfig = struct.field(pytree_node=False, default=ObservationConfig())
    _: KW_ONLY
    auto_reset: bool = struct.field(pytree_node=False, default=True)
    start: Start | None = None
    keep_out: KeepOut | None = None
    method: Proposer | None = None

    @with_own_settings
    def propose(self, key: Array, state: State) -> Array:
        """The action of the environment's method where a state's episode is; ConfigError if it has none."""
        if self.method is None:
            raise ConfigError(
                "an environment without a method",
                "one that was made with a method",
                "make_env(method='spread')",
            )
        return self.method(key, state.pipeline_state.episode)

    @with_own_settings
    def reset(
        self, rng: Array, scene: Start | None = None, keep_out: KeepOut | None = None
    ) -> State:
        """A new episode on an empty support, or around `scene`, outside `keep_out` (both optional).

        Args:
          rng: one key, `jax.random.key` or `jax.random.PRNGKey`; keys in the state are of the same kind.
            Brax's own wrappers take the second kind alone.
          scene, keep_out: instead of the environment's own.
        """
        key_episode, key_next = jax.random.split(rng)
        scene, keep_out = as_float32((scene, keep_out))
        episode = self.rules.begin(
            key_episode,
            keep_out=self.keep_out if keep_out is None else keep_out,
            start=self.start if scene is None else scene,
        )
        ongoing = Ongoing(
            episode=episode,
            start=Start(episode.poses, episode.is_placed),
            keep_out=episode.keep_out,
            key=key_next,
            finished=jax.tree.map(jnp.zeros_like, scene_of(episode)),
            num_finished=jnp.int32(0),
        )
        state = self._state(ongoing, jnp.float32(0), jnp.bool_(False))
        return state.replace(info={"truncation": jnp.float32(0)})

    @with_own_settings
    def step(self, state: State, action: Array) -> State:
        """One attempt with `action`, f32[4] in (0, 1).

        With a number in it that is not finite it fails (`non-finite`), and is told as zeros.
        """
        before: Ongoing = state.pipeline_state
        after, transition = self.rules.attempt(before.episode, as_float32(action))
        after = after.replace(history=jax.tree.map(_finite, after.history))
        ends = after.is_over & ~before.episode.is_over
        ongoing = before.replace(
            episode=after,
            finished=choose(ends, scene_of(after), before.finished),
            num_finished=before.num_finished + ends.astype(jnp.int32),
        )
        if self.auto_reset:
            ongoing = self._begin_next(ongoing, ends)
        new = self._state(ongoing, transition.reward, after.is_over)
        return new.replace(info=state.info, metrics={**state.metrics, **new.metrics})

    def _begin_next(self, ongoing: Ongoing, ends: Array) -> Ongoing:
        """With the next episode in place of one that has ended."""
        key_episode, key_next = jax.random.split(ongoing.key)
        fresh = self.rules.begin(key_episode, keep_out=ongoing.keep_out, start=ongoing.start)
        episode = choose(ends, fresh, ongoing.episode)
        return ongoing.replace(episode=episode, key=jnp.where(ends, key_next, ongoing.key))

    def _state(self, ongoing: Ongoing, reward: Array, is_over: Array) -> State:
        """The state with what is this environment's own."""
        finished = ongoing.finished
        return State(
            pipeline_state=ongoing,
            obs=self.observe(ongoing.episode),
            reward=reward,
            done=is_over.astype(jnp.float32),
            metrics={
                "reward": reward,
                "success": finished.is_success.astype(jnp.float32),
                "num_placed": finished.is_placed.sum().astype(jnp.float32),
                "attempts_used": finished.counts.attempts.sum().astype(jnp.float32),
                "stable_steps": finished.counts.steps.sum().astype(jnp.float32),
                "num_finished": ongoing.num_finished.astype(jnp.float32),
            },
        )

    @with_own_settings
    def observe(self, episode: Episode) -> Observation:
        """The observation of an episode (`placement.observation.observe`)."""
        return observe(self.rules, episode, self.observation)

    @property
    def observation_size(self) -> Any:
        """The shape of each observation; nested as the observation is."""
        state = jax.eval_shape(self.reset, new_key(0))
        return jax.tree.map(lambda leaf: leaf.shape, state.obs)

    @property
    def action_size(self) -> int:
        """x, y, z and turn."""
        return 4

    @property
    def episode_length(self) -> int:
        """The most attempts that an episode can take."""
        return self.rules.config.max_scene_attempts

    @property
    def backend(self) -> str:
        """The engine's class."""
        return type(self.rules.physics).__name__


def _finite(array: Array) -> Array:
    """Numbers as they are, and 0 for what is none."""
    return jnp.where(jnp.isfinite(array), array, jnp.zeros_like(array))
