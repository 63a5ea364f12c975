"""The figures of a placer: shares of good proposals with their intervals, and of what went wrong."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from cluttergen_jax.downstream.placer.evaluation.bench import Outcome
from cluttergen_jax.downstream.placer.pairs.stored import PairLabels
from cluttergen_jax.statistics import finite, proportion
from cluttergen_jax.types import Verdict

UNSEEN = (0.0, 0.1, 0.2, 0.3, 1.0)
"""Bounds of classes by the share of the region that the camera did not see."""
MANY = 7
"""So many standing objects or more."""
_BINS = 10


def figures_of(outcome: Outcome, labels: PairLabels, names: Sequence[str]) -> dict[str, Any]:
    """Everything that a table tells of one row; shares are of all queries unless it is said of which.

    Args:
      names: the world's objects.
    """
    first = outcome.verdict[:, 0]
    is_good = first == int(Verdict.STABLE)
    standing, unseen = labels.num_standing, labels.unseen
    error = np.abs(outcome.z_error[np.isfinite(outcome.z_error)])
    return {
        "success": proportion(is_good),
        "best_of_all": proportion((outcome.verdict == int(Verdict.STABLE)).any(1)),
        "with_margin": proportion(outcome.has_margin),
        "paper": proportion(outcome.is_quiet),
        "verdicts": {v.label: float((first == int(v)).mean()) for v in Verdict if v >= 0},
        "z_error": {
            "median": finite(float(np.median(error))) if len(error) else None,
            "p90": finite(float(np.percentile(error, 90))) if len(error) else None,
        },
        "many": _share(is_good, standing >= MANY),
        "by_standing": [{"standing": int(k)} | _share(is_good, standing == k) for k in np.unique(standing)],
        "by_object": [
            {"object": names[k]} | _share(is_good, labels.object_index == k)
            for k in np.unique(labels.object_index)
        ],
        "by_unseen": [
            {"from": low, "to": high} | _share(is_good, np.digitize(unseen, UNSEEN[1:-1]) == place)
            for place, (low, high) in enumerate(pairwise(UNSEEN))
        ],
        "unseen": float(unseen.mean()),
        "calibration": _calibration(outcome.score[:, 0], is_good),
    }


def _share(is_good: np.ndarray, which: np.ndarray) -> dict[str, Any]:
    """The share among some queries, and how many these are; None of none."""
    number = int(which.sum())
    empty = {"share": None, "low95": None, "high95": None}
    return (proportion(is_good[which]) if number else empty) | {"queries": number}


def _calibration(score: np.ndarray, is_good: np.ndarray) -> dict[str, Any] | None:
    """How far the scores are the chances that they say: the mean squared error, and the mean gap by tenths.

    None of placers that tell no chances.
    """
    if not np.isfinite(score).all():
        return None
    place = np.clip((score * _BINS).astype(int), 0, _BINS - 1)
    bins, gap = [], 0.0
    for each in np.unique(place):
        which = place == each
        told, found = float(score[which].mean()), float(is_good[which].mean())
        bins.append({"told": told, "found": found, "queries": int(which.sum())})
        gap += which.mean() * abs(told - found)
    return {"brier": float(((score - is_good) ** 2).mean()), "gap": float(gap), "bins": bins}
