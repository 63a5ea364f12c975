"""A row's figures, as plain JSON, from what became of its episodes."""

from __future__ import annotations

from typing import Any

import numpy as np

from cluttergen_jax.evaluation.episodes import Attempts, Outcome
from cluttergen_jax.proportions import spread_of, wilson
from cluttergen_jax.types import Verdict

LEAST_ATTEMPTS = 3
"""Placements that needed fewer say nothing about attempts (paper, figure on stable steps)."""


def figures_of(outcome: Outcome, has_last_check: bool = True) -> dict[str, Any]:
    """Success, objects placed, attempts, steps and speed of one run.

    Args:
      has_last_check: success means that the finished scene stands; else that every slot was filled, which is
        all that the paper's looser count asks.
    """
    scenes, counts = outcome.scenes, outcome.scenes.counts
    good = scenes.is_success if has_last_check else scenes.is_filled
    number, valid = len(good), int(good.sum())
    low, high = wilson(valid, number)
    placed = scenes.is_placed.sum(1)
    num_slots = scenes.is_placed.shape[1]
    simulated = int(counts.simulated_steps.sum())
    return {
        "trials": number,
        "num_success": valid,
        "success": valid / number,
        "low95": low,
        "high95": high,
        "filled": float(scenes.is_filled.mean()),
        "placed": float(placed.mean()),
        "placed_histogram": np.bincount(placed, minlength=num_slots + 1).tolist(),
        "attempts": int(counts.attempts.sum()),
        "attempts_per_valid_scene": float(counts.attempts.sum() / max(valid, 1)),
        "attempts_histogram": _attempts_histogram(scenes.is_placed, counts.attempts),
        "simulated_steps": simulated,
        "simulated_steps_per_valid_scene": simulated / max(valid, 1),
        "stable_steps": spread_of(counts.steps[scenes.is_placed]),
        "rest_steps": spread_of(counts.rest_steps[scenes.is_placed]),
        "steps_by_attempt": steps_by_attempt(outcome.attempts),
        "verdicts": _verdicts(counts.verdicts),
        "num_crept": int((scenes.verdict == Verdict.CREPT).sum()),
        "seconds": outcome.seconds,
        "cpu_seconds": outcome.cpu_seconds,
        "compile_seconds": outcome.compile_seconds,
        "valid_scenes_per_second": valid / outcome.seconds,
        "valid_scenes_per_cpu_second": valid / outcome.cpu_seconds if outcome.cpu_seconds else None,
    }


def steps_by_attempt(attempts: Attempts) -> list[dict[str, Any]]:
    """Steps of the first attempt, the second and so on, over placements that took at least three.

    A placement is a slot that was filled in the end.

    Returns:
      One entry per attempt number: `attempt` and the spread of steps.
    """
    if not len(attempts.scene):
        return []
    place = attempts.scene.astype(np.int64) * (int(attempts.slot.max()) + 1) + attempts.slot
    _, slot = np.unique(place, return_inverse=True)
    size = int(slot.max()) + 1
    is_filled = np.zeros(size, bool)
    is_filled[slot[attempts.is_stable]] = True
    is_long = np.bincount(slot, minlength=size) >= LEAST_ATTEMPTS
    chosen = (is_filled & is_long)[slot]
    most = int(attempts.ordinal[chosen].max(initial=0))
    return [
        {"attempt": number, **spread_of(attempts.steps[chosen & (attempts.ordinal == number)])}
        for number in range(1, most + 1)
    ]


def _attempts_histogram(is_placed: np.ndarray, attempts: np.ndarray) -> list[int]:
    """Placed objects by the number of attempts that they took, from 0."""
    return np.bincount(attempts[is_placed], minlength=2).tolist()


def _verdicts(counts: np.ndarray) -> dict[str, int]:
    return {Verdict(code).label: int(number) for code, number in enumerate(counts.sum(0))}


def arrays_of(outcome: Outcome) -> dict[str, np.ndarray]:
    """What measures of scenes need, to be stored beside the figures. N scenes, S slots, M attempts."""
    scenes, attempts = outcome.scenes, outcome.attempts
    return {
        "object_index": scenes.object_index,
        "is_placed": scenes.is_placed,
        "poses": scenes.poses,
        "is_success": scenes.is_success,
        "is_filled": scenes.is_filled,
        "attempt_scene": attempts.scene,
        "attempt_slot": attempts.slot,
        "attempt_object": attempts.object_index,
        "attempt_ordinal": attempts.ordinal,
        "attempt_steps": attempts.steps,
        "attempt_is_stable": attempts.is_stable,
        "attempt_action": attempts.action,
    }
