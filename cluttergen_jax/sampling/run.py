"""Blocks sampled one after another, with progress, and an ear for Ctrl-C between steps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import jax
import numpy as np

from cluttergen_jax.placement.scenes import BLOCK_SIZE, Scenes
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.progress import COMPILING, Progress, interruptible
from cluttergen_jax.sampling.blocks import BlockSampler


def blocks_of(num_scenes: int) -> list[tuple[int, int]]:
    """(block number, scenes in it) for scenes 0 to num_scenes - 1."""
    return [
        (block, min(BLOCK_SIZE, num_scenes - block * BLOCK_SIZE))
        for block in range(-(-num_scenes // BLOCK_SIZE))
    ]


def sample_blocks(
    sampler: BlockSampler, blocks: Sequence[tuple[int, int]], seed: int, title: str = "placing"
) -> Iterator[tuple[int, np.ndarray, Scenes]]:
    """Samples blocks, compiling once.

    Every block is computed at full width, so that a scene does not depend on how many were asked for.

    Yields:
      The block's number, its scene indices i32[n], and its scenes as NumPy arrays with leading axis n.
    """
    begin, step = jax.jit(sampler.begin), jax.jit(sampler.step, donate_argnums=0)
    finish = jax.jit(sampler.finish)
    place = np.arange(BLOCK_SIZE)

    def attempted(episodes: Episode, rows: int) -> tuple[Episode, int]:
        after = step(episodes)
        return after, int(after.is_over[:rows].sum())

    with Progress("compiling", sum(rows for _, rows in blocks), "scene") as progress:
        progress.say(COMPILING)
        for block, rows in blocks:
            indices = block * BLOCK_SIZE + place
            episodes = interruptible(begin, jax.random.key(seed), indices, place < rows)
            done = 0
            while done < rows:
                episodes, now_done = interruptible(attempted, episodes, rows)
                progress.rename(title)
                progress.update(now_done - done)
                done = now_done
            scenes = interruptible(lambda last=episodes: jax.device_get(finish(last)))
            yield block, indices[:rows], jax.tree.map(lambda array, rows=rows: array[:rows], scenes)
