"""The Brax environment in which an action is the number of a candidate."""

from __future__ import annotations

from typing import Any

from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.observation import ObservationConfig
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.ranking.candidates import with_candidates
from cluttergen_jax.search import LowestFit
from cluttergen_jax.search.search import Search
from cluttergen_jax.types import Array


class RankingEnv(PlacementEnv):
    """A `PlacementEnv` whose observation holds candidate poses and whose action picks one.

    Args:
      rules, observation: see `PlacementEnv`.
      search: finds the poses, bound to the same rules; `LowestFit` if None.
    """

    def __init__(
        self, rules: Rules, observation: ObservationConfig | None = None, search: Search | None = None
    ) -> None:
        super().__init__(rules, observation)
        self.search = search or LowestFit(rules)

    def observe(self, episode: Episode) -> dict[str, Any]:
        """The observation with the candidates for the next attempt, in place of the history."""
        return with_candidates(self.search, episode, super().observe(episode))

    def pose_of(self, observation: dict[str, Any], action: Array) -> Array:
        """The pose f32[4] of candidate `action`, i32."""
        return observation["menu"]["action"][action]

    @property
    def action_size(self) -> int:
        """One whole number."""
        return 1
