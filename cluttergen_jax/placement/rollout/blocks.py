"""Blocks of episodes: scene i's key is fold_in(key, i), whatever else is sampled beside it."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

from cluttergen_jax.placement.region import KeepOut
from cluttergen_jax.placement.rules import Proposer, Rules
from cluttergen_jax.placement.scenes import SceneBatch, scene_of
from cluttergen_jax.placement.sharded import varying_alike
from cluttergen_jax.placement.types import Episode, Start, Transition
from cluttergen_jax.types import Array


class BlockSampler(struct.PyTreeNode, eq=False):
    """Episodes side by side until the last one is over; those that are over cost no physics.

    `sample` is the whole as one function to compile; `begin`, `step` and `finish` are its pieces, for drivers
    that do something between steps (`placement.rollout.run.Rollout`).

    Attributes:
      rules: the decision process.
      propose: who chooses the poses; a pytree, where `Rollout` runs it. One whose attribute `in_parts` is
        false is asked for all episodes together.
      keep_out, start: how every episode begins; None for nothing.
    """

    rules: Rules
    propose: Proposer
    keep_out: KeepOut | None = None
    start: Start | None = None

    @property
    def in_parts(self) -> bool:
        """`Rollout` asks the proposer for some episodes at a time, and for none that are over."""
        return getattr(self.propose, "in_parts", True)

    def begin(self, key: Array, indices: Array, is_wanted: Array) -> Episode:
        """Episodes for scene indices i32[N]; those not wanted (bool[N]) are over before they start."""
        keys = jax.vmap(lambda index: jax.random.fold_in(key, index))(indices)
        episodes = jax.vmap(lambda key: self.rules.begin(key, None, self.keep_out, self.start))(keys)
        return episodes.replace(is_over=~is_wanted)

    def step(self, episodes: Episode) -> tuple[Episode, Transition]:
        """One attempt in every episode that is not over."""
        return jax.vmap(self.step_one)(episodes)

    def step_one(self, episode: Episode) -> tuple[Episode, Transition]:
        """One attempt, unless the episode is over."""
        return self.rules.attempt(*self.proposed(episode))

    def proposed(self, episode: Episode) -> tuple[Episode, Array]:
        """The episode with its next key, and the action that is proposed."""
        key_propose, key_next = jax.random.split(episode.key)
        action = self.propose(key_propose, episode)
        return episode.replace(key=key_next), action

    def finish(self, episodes: Episode) -> SceneBatch:
        """The scenes of finished episodes."""
        return jax.vmap(scene_of)(episodes)

    def sample(self, key: Array, indices: Array, is_wanted: Array) -> SceneBatch:
        """All three: a SceneBatch with leading axis N."""
        episodes = varying_alike(self.begin(key, indices, is_wanted))
        episodes = jax.lax.while_loop(
            lambda e: ~jnp.all(e.is_over), lambda e: varying_alike(self.step(e)[0]), episodes
        )
        return self.finish(episodes)
