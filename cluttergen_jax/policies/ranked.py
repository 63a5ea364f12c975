"""A trained ranking of the poses that geometry has found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax

from cluttergen_jax.placement.observation import ObservationConfig, observe
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.ranking.agent import RankingLearner
from cluttergen_jax.ranking.menu import with_menu
from cluttergen_jax.search import Search
from cluttergen_jax.types import Array


@dataclass(frozen=True, eq=False)
class Ranked:
    """A proposer that takes the pose of a shortlist which the ranker likes best, or draws one.

    Attributes:
      search: makes the shortlists.
      learner, params: the ranker.
      is_sampled: draw; else take the likeliest.
    """

    search: Search
    learner: RankingLearner
    params: Any
    is_sampled: bool = False

    def __call__(self, key: Array, episode: Episode) -> Array:
        """See `placement.proposer.Proposer`."""
        seen = self.look(episode)
        dist, _ = self.learner.apply(self.params, jax.tree.map(lambda leaf: leaf[None], seen))
        chosen = (dist.sample(key) if self.is_sampled else dist.mean())[0]
        return seen["menu"]["action"][chosen]

    def look(self, episode: Episode) -> dict[str, Any]:
        """What it sees of an episode, the menu included."""
        seen = observe(self.search.rules, episode, ObservationConfig())
        return with_menu(self.search, episode, seen)
