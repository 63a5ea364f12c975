"""A trained policy compared with `random` in the same world, and advice where it is not better."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

_RISE = 0.03
"""How much higher the last quarter's success is than the one before where a curve still rises."""
_EASY = 0.95
_FALLS_LATE, _FEWEST = 0.15, 8


def difference_interval(one: Mapping[str, float], other: Mapping[str, float]) -> tuple[float, float]:
    """The 95 % interval of the difference of two rates (Newcombe, 1998, method 10).

    Args:
      one, other: `success` with its Wilson interval, `low95` and `high95`.
    """
    between = one["success"] - other["success"]
    below = math.hypot(one["success"] - one["low95"], other["high95"] - other["success"])
    above = math.hypot(one["high95"] - one["success"], other["success"] - other["low95"])
    return between - below, between + above


def comparison_lines(evaluation: Mapping[str, Any], rows: Sequence[Mapping[str, float]]) -> list[str]:
    """Lines: the success of `random`, and where the policy is not better, that, and what may be missing.

    Args:
      evaluation: of the policy; its `random` is that of `random`.
      rows: figures of the run's updates.
    """
    random = evaluation["random"]
    rate = f"{random['success']:.3f} [{random['low95']:.3f}, {random['high95']:.3f}]"
    found = f"random     {rate} in the same world ({random['episodes']} episodes): the policy is"
    low, high = difference_interval(evaluation, random)
    if low > 0:
        return [f"{found} better by {low:.3f} to {high:.3f}"]
    verdict = "worse" if high < 0 else "not better"
    return [
        f"{found} {verdict}; the difference lies between {low:.3f} and {high:.3f}",
        f"advice     {_advice(evaluation, rows)}",
    ]


def _advice(evaluation: Mapping[str, Any], rows: Sequence[Mapping[str, float]]) -> str:
    """What the run most likely lacks."""
    if evaluation["random"]["success"] > _EASY:
        return "nothing: `random` fills this world. More objects or a smaller support make it harder"
    number = f"{int(rows[-1]['attempts']):,}"
    if len(rows) < _FEWEST:
        return f"attempts: {number} make {len(rows)} updates, of which nothing can be said"
    success = np.array([row["success"] for row in rows])
    before, last = (float(part.mean()) for part in np.array_split(success, 4)[-2:])
    if last - before > _RISE:
        rise = f"training's success still rises, from {before:.2f} to {last:.2f} in its last quarter"
        return f"attempts: {rise}; give more than {number}"
    passed = evaluation["training_success"]
    if passed - evaluation["success"] > _FALLS_LATE:
        return f"stillness: {passed:.2f} pass training's short check, but move later; try reward 'compressed'"
    return (
        f"an easier start: training's success rises no more ({before:.2f}, then {last:.2f}) after {number} "
        "attempts; fewer objects, a larger support, or variant 'policy' with preset 'cpu' learn sooner, and "
        "method 'guided' needs no training"
    )
