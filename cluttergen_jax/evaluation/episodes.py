"""Episodes run with every attempt logged, and a row's figures, as plain JSON, of what became of them."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import numpy as np
from flax import struct

from cluttergen_jax.evaluation.records import Figures, Share, Spread
from cluttergen_jax.numerics import new_key
from cluttergen_jax.placement.rollout import BLOCK_SIZE, BlockSampler, Rollout, blocks_of
from cluttergen_jax.placement.scenes import SceneBatch
from cluttergen_jax.placement.types import Episode, Transition
from cluttergen_jax.statistics import proportion, spread_of, wilson
from cluttergen_jax.types import Array, Verdict

_WIDTHS = (16, 64, BLOCK_SIZE)
"""Few, so that programs are shared; wide enough for what is asked."""


class Attempts(struct.PyTreeNode):
    """Attempts in the order in which they were made. M attempts.

    Attributes:
      scene, slot, object_index, ordinal: i32[M], as of `Transition`; the first of an object's turn is 1.
      steps: i32[M], simulated; is_stable: bool[M].
      action: f32[M, 4], what was proposed.
      is_made: bool[M]; on the host, all of them.
    """

    scene: Array
    slot: Array
    object_index: Array
    ordinal: Array
    steps: Array
    is_stable: Array
    action: Array
    is_made: Array


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of N episodes.

    Attributes:
      scenes: NumPy arrays with a leading axis N.
      attempts: all of them.
      seconds, cpu_seconds: wall and process time of sampling, compilation left out.
      compile_seconds: wall time of tracing, compilation and a step in which no attempt is made.
    """

    scenes: SceneBatch
    attempts: Attempts
    seconds: float
    cpu_seconds: float
    compile_seconds: float


def width_of(num_scenes: int) -> int:
    """How many episodes are run side by side."""
    return next(each for each in _WIDTHS if each >= min(num_scenes, BLOCK_SIZE))


def run_episodes(
    rollout: Rollout,
    sampler: BlockSampler,
    num_scenes: int,
    seed: int,
    on_done: Callable[[int], None] = lambda number: None,
) -> Outcome:
    """Scenes 0 to num_scenes - 1 of `seed`: those of `rollout.sample_blocks`, with a log of attempts.

    Args:
      rollout: one that sees `attempts_of` each step.
      on_done: told how many more episodes are over.
    """
    width = width_of(num_scenes)
    started = time.perf_counter()
    key = new_key(seed)
    rollout.compile(sampler, key, np.arange(width), is_refilled=num_scenes > width)
    compiled = time.perf_counter()
    cpu = time.process_time()
    made: list[Attempts] = []

    note = partial(_note, made, on_done)
    scenes = rollout.run_all(sampler, key, num_scenes, width, note)
    return Outcome(
        scenes=scenes,
        attempts=jax.tree.map(lambda *leaves: np.concatenate(leaves), *made),
        seconds=time.perf_counter() - compiled,
        cpu_seconds=time.process_time() - cpu,
        compile_seconds=compiled - started,
    )


def run_shelves(
    rollout: Rollout,
    sampler_of: Callable[[int], tuple[BlockSampler, np.ndarray]],
    num_scenes: int,
    seed: int,
    on_done: Callable[[int], None] = lambda number: None,
) -> Outcome:
    """`run_episodes` in worlds of which each block has its own.

    Args:
      sampler_of: gives a block's sampler, and i32[K], the numbers of its objects in the pool: `object_index`
        of what is returned is about the pool.
    """
    outcomes = []
    for block, rows in blocks_of(num_scenes):
        sampler, numbers = sampler_of(block)
        place = np.arange(BLOCK_SIZE)
        indices = block * BLOCK_SIZE + place
        started = time.perf_counter()
        key = new_key(seed)
        rollout.compile(sampler, key, indices, is_refilled=False)
        compiled = time.perf_counter()
        cpu = time.process_time()
        made: list[Attempts] = []
        # A block is run to its end before the next one's world is made.
        note = partial(_note, made, on_done, indices)
        scenes = rollout.run(sampler, key, indices, place < rows, note)
        scenes = jax.tree.map(lambda leaf, rows=rows: leaf[:rows], scenes)
        attempts = jax.tree.map(lambda *leaves: np.concatenate(leaves), *made)
        index = np.asarray(scenes.object_index)
        scenes = scenes.replace(object_index=np.where(index < 0, -1, numbers[index]))
        attempts = attempts.replace(object_index=numbers[attempts.object_index])
        seconds = time.perf_counter() - compiled
        outcomes.append(
            Outcome(scenes, attempts, seconds, time.process_time() - cpu, compiled - started)
        )
    join = partial(jax.tree.map, lambda *leaves: np.concatenate(leaves))
    return Outcome(
        scenes=join(*(each.scenes for each in outcomes)),
        attempts=join(*(each.attempts for each in outcomes)),
        seconds=sum(each.seconds for each in outcomes),
        cpu_seconds=sum(each.cpu_seconds for each in outcomes),
        compile_seconds=sum(each.compile_seconds for each in outcomes),
    )


def _note(
    made: list[Attempts],
    on_done: Callable[[int], None],
    indices: np.ndarray,
    number: int,
    attempts: Attempts,
) -> None:
    """Keeps the attempts of a step, with the scenes in whose episodes they were made."""
    attempts = attempts.replace(scene=indices.astype(np.int32))
    made.append(jax.tree.map(lambda leaf: leaf[attempts.is_made], attempts))
    on_done(number)


def attempts_of(before: Episode, after: Episode, transition: Transition) -> Attempts:
    """What is logged of a step; which scenes its episodes are, is filled in later."""
    return Attempts(
        scene=transition.slot,
        slot=transition.slot,
        object_index=transition.object_index,
        ordinal=transition.ordinal,
        steps=transition.settling.num_steps,
        is_stable=transition.verdict == Verdict.STABLE,
        action=transition.action,
        is_made=transition.is_made,
    )


LEAST_ATTEMPTS = 3
"""Placements that needed fewer say nothing about attempts (paper, figure on stable steps)."""


def figures_of(outcome: Outcome, has_last_check: bool = True) -> Figures:
    """Success, objects placed, attempts, steps and speed of one run.

    Args:
      has_last_check: success means that the finished scene stands; else that every slot was filled, which is
        all that the paper's looser count asks.
    """
    scenes = outcome.scenes
    counts = outcome.scenes.counts
    good = scenes.is_success if has_last_check else scenes.is_filled
    number = len(good)
    valid = int(good.sum())
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
        "within": within(good, counts.attempts.sum(1), num_slots),
        "attempts_per_valid_scene": per_scene(int(counts.attempts.sum()), valid),
        "attempts_histogram": np.bincount(counts.attempts[scenes.is_placed], minlength=2).tolist(),
        "simulated_steps": simulated,
        "simulated_steps_per_valid_scene": per_scene(simulated, valid),
        "stack": spread_of(np.sum(np.asarray(scenes.level) > 0, axis=1)[good]),
        "stable_steps": spread_of(counts.steps[scenes.is_placed]),
        "rest_steps": spread_of(counts.rest_steps[scenes.is_placed]),
        "steps_by_attempt": steps_by_attempt(outcome.attempts),
        "verdicts": {Verdict(code).label: int(n) for code, n in enumerate(counts.verdicts.sum(0))},
        "num_crept": int((scenes.verdict == Verdict.CREPT).sum()),
        "seconds": outcome.seconds,
        "cpu_seconds": outcome.cpu_seconds,
        "compile_seconds": outcome.compile_seconds,
        "valid_scenes_per_second": valid / outcome.seconds,
        "valid_scenes_per_cpu_second": valid / outcome.cpu_seconds if outcome.cpu_seconds else None,
    }


def per_scene(total: int, num_scenes: int) -> float | None:
    """What each scene has cost; None where there is none."""
    return total / num_scenes if num_scenes else None


WITHIN = (1.0, 1.5, 5.0)
"""Attempts in all, in objects of a scene, within which scenes are counted as finished."""


def within(is_good: np.ndarray, attempts: np.ndarray, num_objects: int) -> list[Share]:
    """Scenes that were finished with few attempts, rejected ones included.

    Args:
      is_good: bool[N], scenes that succeeded; attempts: i[N], of each scene in all.

    Returns:
      For each of `WITHIN`: `times`, `share` and its 95 % interval, `low95` and `high95`.
    """
    return [
        {"times": each, **proportion(is_good & (attempts <= each * num_objects))} for each in WITHIN
    ]


def steps_by_attempt(attempts: Attempts) -> list[Spread]:
    """Steps of the first attempt, the second and so on, over placements that took at least three.

    A placement is a turn of an object that ended with it in place.

    Returns:
      One entry per attempt number: `attempt` and the spread of steps.
    """
    if not len(attempts.scene):
        return []
    # Turns of one object after another: a slot may have several, where objects are taken away again.
    order = np.argsort(attempts.scene, kind="stable")
    turn = np.empty(len(order), np.int64)
    turn[order] = np.cumsum(attempts.ordinal[order] == 1)
    size = int(turn.max()) + 1
    is_filled = np.zeros(size, bool)
    is_filled[turn[attempts.is_stable]] = True
    is_long = np.bincount(turn, minlength=size) >= LEAST_ATTEMPTS
    chosen = (is_filled & is_long)[turn]
    most = int(attempts.ordinal[chosen].max(initial=0))
    return [
        {"attempt": number, **spread_of(attempts.steps[chosen & (attempts.ordinal == number)])}
        for number in range(1, most + 1)
    ]


def arrays_of(outcome: Outcome) -> dict[str, np.ndarray]:
    """What measures of scenes need, to be stored beside the figures. N scenes, S slots, M attempts."""
    scenes = outcome.scenes
    attempts = outcome.attempts
    return {
        "object_index": scenes.object_index,
        "is_placed": scenes.is_placed,
        "poses": scenes.poses,
        "level": scenes.level,
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
