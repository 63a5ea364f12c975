"""Blocks of episodes: scene i's key is fold_in(key, i), whatever else is sampled beside it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp

from cluttergen_jax.placement.proposer import Proposer
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.scenes import Scenes, scenes_of
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.types import Array


@dataclass(frozen=True, eq=False)
class BlockSampler:
    """Episodes side by side until the last one is over; those that are over cost no physics.

    `sample` is the whole as one function to compile; `begin`, `step` and `finish` are its pieces, for drivers
    that show progress and answer to Ctrl-C between steps.

    Attributes:
      rules: the decision process.
      propose: who chooses the poses.
      begin_one: makes an episode from a key; `rules.begin` unless something stands there already.
    """

    rules: Rules
    propose: Proposer
    begin_one: Callable[[Array], Episode] | None = field(default=None)

    def begin(self, key: Array, indices: Array, is_wanted: Array) -> Episode:
        """Episodes for scene indices i32[N]; those not wanted (bool[N]) are over before they start."""
        keys = jax.vmap(lambda index: jax.random.fold_in(key, index))(indices)
        episodes = jax.vmap(self.begin_one or self.rules.begin)(keys)
        return episodes.replace(is_over=~is_wanted)

    def step(self, episodes: Episode) -> Episode:
        """One attempt in every episode that is not over."""
        return jax.vmap(self.step_one)(episodes)

    def step_one(self, episode: Episode) -> Episode:
        """One attempt, unless the episode is over."""
        key_propose, key_next = jax.random.split(episode.key)
        action = self.propose(key_propose, episode)
        return self.rules.attempt(episode.replace(key=key_next), action)[0]

    def finish(self, episodes: Episode) -> Scenes:
        """The scenes of finished episodes."""
        return jax.vmap(scenes_of)(episodes)

    def sample(self, key: Array, indices: Array, is_wanted: Array) -> Scenes:
        """All three: Scenes with leading axis N."""
        episodes = self.begin(key, indices, is_wanted)
        episodes = jax.lax.while_loop(lambda e: ~jnp.all(e.is_over), self.step, episodes)
        return self.finish(episodes)
