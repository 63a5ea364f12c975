"""A trained ranking of the poses that geometry has found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax

from cluttergen_jax.placement.observation import ObservationConfig, observe
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.ranking.env import with_menu
from cluttergen_jax.ranking.learner import RankingLearner
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
        seen = seen_by_ranker(self.search, episode)
        dist, _ = self.learner.apply(self.params, jax.tree.map(lambda leaf: leaf[None], seen))
        chosen = (dist.sample(key) if self.is_sampled else dist.mean())[0]
        return seen["menu"]["action"][chosen]


def seen_by_ranker(search: Search, episode: Episode) -> dict[str, Any]:
    """The observation with a menu of poses."""
    return with_menu(search, episode, observe(search.rules, episode, ObservationConfig()))
