"""Scenes to measure on: made by a method under the rules, as `Physics` takes them."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.placement.methods.table import make_proposer
from cluttergen_jax.placement.rollout import BLOCK_SIZE, BlockSampler
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.scenes import SceneBatch

Sampler = Callable[[int, int], SceneBatch]
"""Makes scenes 0 .. N - 1 from a seed, on the host, failures included: `sample(num_scenes, seed)`."""


def make_block_sampler(rules: Rules, method: str, block_size: int = BLOCK_SIZE) -> Sampler:
    """A sampler that is compiled at its first call."""
    compiled = jax.jit(BlockSampler(rules, make_proposer(method, rules)).sample)

    def sample(num_scenes: int, seed: int) -> SceneBatch:
        blocks = []
        for start in range(0, num_scenes, block_size):
            indices = start + np.arange(block_size)
            scenes = jax.device_get(
                compiled(jax.random.key(seed), jnp.asarray(indices), indices < num_scenes)
            )
            rows = min(block_size, num_scenes - start)
            blocks.append(jax.tree.map(lambda array, rows=rows: array[:rows], scenes))
        return jax.tree.map(lambda *parts: np.concatenate(parts), *blocks)

    return sample


def placed_poses(
    scenes: SceneBatch, rows: np.ndarray, num_objects: int
) -> tuple[np.ndarray, np.ndarray]:
    """The scenes `rows` as the physics interface takes them: poses f32[N, K, 7] and is_placed bool[N, K]."""
    poses = np.zeros((len(rows), num_objects, 7), np.float32)
    poses[..., 3] = 1.0
    is_placed = np.zeros((len(rows), num_objects), bool)
    row, slot = np.nonzero(scenes.is_placed[rows])
    index = scenes.object_index[rows][row, slot]
    poses[row, index] = scenes.poses[rows][row, slot]
    is_placed[row, index] = True
    return poses, is_placed
