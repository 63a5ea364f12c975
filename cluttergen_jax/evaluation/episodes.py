"""Episodes run with every attempt written down."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import jax
import numpy as np
from flax import struct

from cluttergen_jax.placement.rollout import BLOCK_SIZE, BlockSampler, Rollout
from cluttergen_jax.placement.scenes import SceneBatch
from cluttergen_jax.placement.types import Episode, Transition
from cluttergen_jax.types import Array, Verdict

_WIDTHS = (16, 64, BLOCK_SIZE)
"""Few, so that programs are shared; wide enough for what is asked."""


class Attempts(struct.PyTreeNode):
    """Attempts in the order in which they were made. M attempts.

    Attributes:
      scene, slot, object_index, ordinal: i32[M]; a slot's first attempt is 1.
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
    key = jax.random.key(seed)
    rollout.compile(sampler, key, np.arange(width))
    compiled, cpu = time.perf_counter(), time.process_time()
    made: list[Attempts] = []

    def note(indices: np.ndarray, number: int, attempts: Attempts) -> None:
        made.append(_kept(attempts.replace(scene=indices.astype(np.int32))))
        on_done(number)

    scenes = rollout.run_all(sampler, key, num_scenes, width, note)
    return Outcome(
        scenes=scenes,
        attempts=jax.tree.map(lambda *leaves: np.concatenate(leaves), *made),
        seconds=time.perf_counter() - compiled,
        cpu_seconds=time.process_time() - cpu,
        compile_seconds=compiled - started,
    )


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


def _kept(attempts: Attempts) -> Attempts:
    return jax.tree.map(lambda leaf: leaf[attempts.is_made], attempts)
