"""The placement problem: world, region, decision process, observation, environment, baselines, rollouts."""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import offer

if TYPE_CHECKING:
    from cluttergen_jax.placement.boxes import gaps_in_plan
    from cluttergen_jax.placement.config import MIN_MARGIN, PlacementConfig
    from cluttergen_jax.placement.heightmap import VOID, HeightMap, HeightMapper
    from cluttergen_jax.placement.methods.baselines import LowestFit, cost_of_lowest_fit
    from cluttergen_jax.placement.methods.table import entry_of
    from cluttergen_jax.placement.problem import Problem, ProblemConfig, Setup, compose
    from cluttergen_jax.placement.region import (
        KeepOut,
        Region,
        from_pose,
        make_region,
        pose_of_action,
        to_pose,
    )
    from cluttergen_jax.placement.relations import (
        KINDS,
        Relation,
        can_be_filled,
        candidates_of,
        conditions_of,
        parse_relations,
    )
    from cluttergen_jax.placement.replay import Replay
    from cluttergen_jax.placement.rules import Proposer, Rules
    from cluttergen_jax.placement.search import (
        CLEARANCE,
        Candidates,
        CandidateScores,
        SearchConfig,
        UnderSide,
        base_share,
        cells_under,
        crowding,
        draw_candidates,
        lower_onto,
        mean_under,
        support_share,
        touching,
        under_side,
    )
    from cluttergen_jax.placement.types import Episode, Start

__getattr__, __all__ = offer(
    __name__,
    {
        "boxes": ("gaps_in_plan",),
        "config": ("MIN_MARGIN", "PlacementConfig"),
        "heightmap": ("HeightMap", "HeightMapper", "VOID"),
        "methods.baselines": ("LowestFit", "cost_of_lowest_fit"),
        "methods.table": ("entry_of",),
        "problem": ("Problem", "ProblemConfig", "Setup", "compose"),
        "region": ("KeepOut", "Region", "from_pose", "make_region", "pose_of_action", "to_pose"),
        "relations": (
            "KINDS",
            "Relation",
            "can_be_filled",
            "candidates_of",
            "conditions_of",
            "parse_relations",
        ),
        "replay": ("Replay",),
        "rules": ("Proposer", "Rules"),
        "search": (
            "CLEARANCE",
            "CandidateScores",
            "Candidates",
            "SearchConfig",
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
        ),
        "types": ("Episode", "Start"),
    },
)
