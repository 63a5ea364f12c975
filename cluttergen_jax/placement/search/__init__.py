"""Where an object could go: candidate poses lowered to first contact, by geometry alone."""

from cluttergen_jax.placement.search.fit import (
    Candidates,
    UnderSide,
    base_share,
    cells_under,
    lower_onto,
    mean_under,
    support_share,
    touching,
)
from cluttergen_jax.placement.search.search import (
    CLEARANCE,
    CandidateScores,
    Search,
    SearchConfig,
    TopCandidates,
    crowding,
    draw_candidates,
    under_side,
)

__all__ = [
    "CLEARANCE",
    "CandidateScores",
    "Candidates",
    "Search",
    "SearchConfig",
    "TopCandidates",
    "UnderSide",
    "base_share",
    "cells_under",
    "crowding",
    "draw_candidates",
    "lower_onto",
    "mean_under",
    "support_share",
    "touching",
    "under_side",
]
