"""The Brax environment in which an action is the number of a candidate."""

from __future__ import annotations

from typing import Any

import jax

from cluttergen_jax.physics.brax_env import Env, State
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.ranking.menu import with_menu
from cluttergen_jax.search.search import Search
from cluttergen_jax.types import Array


class RankingEnv(Env):
    """A `PlacementEnv` whose observation holds a menu of poses and whose action picks one of them.

    Args:
      env: the placement environment.
      search: finds the poses; it is bound to the same rules.
    """

    def __init__(self, env: PlacementEnv, search: Search) -> None:
        self.env, self.search = env, search

    def reset(self, rng: Array) -> State:
        """See `PlacementEnv.reset`."""
        return self._with_menu(self.env.reset(rng))

    def step(self, state: State, action: Array) -> State:
        """One attempt with candidate `action`, i32."""
        return self._with_menu(self.env.step(state, state.obs["menu"]["action"][action]))

    def _with_menu(self, state: State) -> State:
        episode: Episode = state.pipeline_state.episode
        return state.replace(obs=with_menu(self.search, episode, state.obs))

    @property
    def observation_size(self) -> dict[str, Any]:
        """The shape of each observation; nested as the observation is."""
        state = jax.eval_shape(self.reset, jax.random.key(0))
        return jax.tree.map(lambda leaf: leaf.shape, state.obs)

    @property
    def action_size(self) -> int:
        """One whole number."""
        return 1

    @property
    def backend(self) -> str:
        """The engine's class."""
        return self.env.backend
