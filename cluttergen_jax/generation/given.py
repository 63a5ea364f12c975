"""A bank of scenes that were made elsewhere and stand: for environments, which begin in those of banks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa

from cluttergen_jax.generation.recipe import recipe_of
from cluttergen_jax.learning.methods import Method
from cluttergen_jax.placement.problem import Problem
from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.scene import Bank, Scene
from cluttergen_jax.scene.bank import BankWriter, read_bank
from cluttergen_jax.scene.bank.table import COUNTED, SCHEMA, count_column
from cluttergen_jax.scene.bank.writer import names_of


def write_scenes(
    path: str | Path, problem: Problem, scenes: Sequence[Scene], method: str, seed: int
) -> Bank:
    """Writes scenes of a problem's objects, on its support, as a bank; one with fewer of them is continued.

    Args:
      method, seed: as what its recipe calls that by which they were made.

    Raises:
      BankError: the folder holds something else.
    """
    objects = problem.world.objects
    number = {name: k for k, name in enumerate(problem.world.names)}
    recipe = recipe_of(problem, Method(method), seed)
    support = problem.world.support
    with BankWriter(path, recipe, len(scenes), names_of(objects), support) as bank:
        for block, first in enumerate(range(0, len(scenes), BLOCK_SIZE)):
            part = scenes[first : first + BLOCK_SIZE]
            if not bank.has_block(block, len(part)):
                rows = [_row(first + k, scene, number) for k, scene in enumerate(part)]
                bank.write_block(block, pa.Table.from_pylist(rows, schema=SCHEMA))
    return read_bank(path)


def _row(index: int, scene: Scene, number: dict[str, int]) -> dict[str, object]:
    num_objects = len(scene.names)
    return {
        "index": index,
        "is_success": True,
        "is_filled": True,
        "verdict": "stable",
        "drift": 0.0,
        "num_placed": num_objects,
        "object_index": [number[name] for name in scene.names],
        "objects": list(scene.names),
        "is_placed": [True] * num_objects,
        "poses": scene.poses.tolist(),
        "attempts": [1] * num_objects,
        "steps": [0] * num_objects,
        "rest_steps": [0] * num_objects,
        "simulated_steps": 0,
        **{count_column(verdict): 0 for verdict in COUNTED},
    }
