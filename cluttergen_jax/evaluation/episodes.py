"""Episodes run with every attempt written down."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.evaluation.programs import Programs
from cluttergen_jax.placement.scenes import Scenes
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.progress import interruptible
from cluttergen_jax.sampling import BLOCK_SIZE, BlockSampler
from cluttergen_jax.types import Array

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
      compile_seconds: wall time of tracing and compilation.
    """

    scenes: Scenes
    attempts: Attempts
    seconds: float
    cpu_seconds: float
    compile_seconds: float


def width_of(num_scenes: int) -> int:
    """How many episodes are run side by side."""
    return next(each for each in _WIDTHS if each >= min(num_scenes, BLOCK_SIZE))


def run_episodes(
    programs: Programs,
    sampler: BlockSampler,
    num_scenes: int,
    seed: int,
    on_done: Callable[[int], None] = lambda number: None,
) -> Outcome:
    """Scenes 0 to num_scenes - 1 of `seed`: those of `sampling.sample_blocks`, with a log of attempts.

    Args:
      on_done: told how many more episodes are over.
    """
    width = width_of(num_scenes)
    started = time.perf_counter()
    key, place = jax.random.key(seed), np.arange(width)
    example = (key, place, place < 0)
    begin = programs.compile(sampler.begin, *example)
    episodes = begin(*example)
    step = programs.compile(lambda each: logged_step(sampler, each), episodes)
    finish = programs.compile(sampler.finish, episodes)

    def attempted(episodes: Episode, rows: int) -> tuple[Episode, np.ndarray, Attempts]:
        after, attempts = step(episodes)
        return after, *jax.device_get((after.is_over[:rows], attempts))

    compiled = time.perf_counter()
    cpu = time.process_time()
    scenes: list[Scenes] = []
    made: list[Attempts] = []
    for first in range(0, num_scenes, width):
        indices, rows = first + place, min(width, num_scenes - first)
        episodes = begin(key, indices, place < rows)
        done = 0
        while done < rows:
            episodes, over, attempts = interruptible(attempted, episodes, rows)
            made.append(_kept(attempts.replace(scene=indices.astype(np.int32))))
            on_done(int(over.sum()) - done)
            done = int(over.sum())
        scenes.append(jax.tree.map(lambda leaf, rows=rows: leaf[:rows], jax.device_get(finish(episodes))))
    return Outcome(
        scenes=_joined(scenes),
        attempts=_joined(made),
        seconds=time.perf_counter() - compiled,
        cpu_seconds=time.process_time() - cpu,
        compile_seconds=compiled - started,
    )


def logged_step(sampler: BlockSampler, episodes: Episode) -> tuple[Episode, Attempts]:
    """`BlockSampler.step`, and the attempts that it made."""

    def one(episode: Episode) -> tuple[Episode, Attempts]:
        key_propose, key_next = jax.random.split(episode.key)
        action = sampler.propose(key_propose, episode)
        after, _ = sampler.rules.attempt(episode.replace(key=key_next), action)
        slot = jnp.minimum(episode.slot, sampler.rules.num_slots - 1)
        return after, Attempts(
            scene=jnp.int32(0),
            slot=slot,
            object_index=sampler.rules.focus(episode),
            ordinal=episode.attempt + 1,
            steps=after.counts.steps[slot] - episode.counts.steps[slot],
            is_stable=after.slot > episode.slot,
            action=action,
            is_made=~episode.is_over,
        )

    return jax.vmap(one)(episodes)


def _kept(attempts: Attempts) -> Attempts:
    return jax.tree.map(lambda leaf: leaf[attempts.is_made], attempts)


def _joined(parts: list) -> Any:
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
