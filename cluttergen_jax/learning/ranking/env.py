"""The Brax environment in which an action is the number of a candidate."""

from __future__ import annotations

from dataclasses import KW_ONLY
from typing import Any

from flax import struct

from cluttergen_jax.learning.ranking.candidates import with_candidates
from cluttergen_jax.placement.baselines import LowestFit
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.search.search import Search
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.types import Array


@struct.dataclass(eq=False)
class RankingEnv(PlacementEnv):
    """A `PlacementEnv` whose observation holds candidate poses and whose action picks one.

    Attributes:
      search: finds the poses, bound to the same rules; `LowestFit` if not given.
    """

    _: KW_ONLY
    search: Search | None = None

    def __post_init__(self) -> None:
        if self.search is None:
            object.__setattr__(self, "search", LowestFit(self.rules))

    def observe(self, episode: Episode) -> dict[str, Any]:
        """The observation with the candidates for the next attempt, in place of the history."""
        assert self.search is not None
        return with_candidates(self.search, episode, PlacementEnv.observe(self, episode))

    def pose_of(self, observation: dict[str, Any], action: Array) -> Array:
        """The pose f32[4] of candidate `action`, i32."""
        return observation["menu"]["action"][action]

    @property
    def action_size(self) -> int:
        """One whole number."""
        return 1
