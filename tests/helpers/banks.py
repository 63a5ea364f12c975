"""Made-up banks for tests: rows without any physics, written by the real writer in no time."""

from __future__ import annotations

import sys

import numpy as np
import pyarrow as pa

from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.generation.files import write_files
from cluttergen_jax.placement.problem import ProblemConfig
from cluttergen_jax.placement.rollout import BLOCK_SIZE
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.blocks import rows_bytes, write_block
from cluttergen_jax.scene.bank.table import COUNTED, SCHEMA
from cluttergen_jax.scene.bank.writer import BankWriter
from tests.helpers.worlds import trio

NAMES = tuple(asset.name for asset in trio())
RECIPE = {
    "seed": 3,
    "method": "made up",
    "pool": "trio",
    "names": list(NAMES),
    "versions": {"cluttergen_jax": "0"},
}


def rows(block: int, num_rows: int = BLOCK_SIZE) -> pa.Table:
    """A block of scenes that depend on nothing but their number; every fourth one fails."""
    return pa.Table.from_pylist(
        [_row(block * BLOCK_SIZE + place) for place in range(num_rows)], schema=SCHEMA
    )


def _row(index: int) -> dict:
    draw = np.random.default_rng(index)
    fails = index % 4 == 3
    placed = [True, True, not fails]
    poses = np.c_[
        draw.uniform(-0.2, 0.2, (3, 2)), np.full(3, 0.75), np.tile([1.0, 0, 0, 0], (3, 1))
    ]
    return {
        "index": index,
        "is_success": not fails,
        "is_filled": not fails,
        "verdict": "displaced" if fails else "stable",
        "drift": float(draw.uniform(0, 1e-4)),
        "num_placed": sum(placed),
        "object_index": [0, 1, 2],
        "objects": list(NAMES),
        "is_placed": placed,
        "poses": poses.astype(np.float32).tolist(),
        "attempts": [1, 2, 5 if fails else 1],
        "steps": [30, 60, 60],
        "rest_steps": [30, 30, 0 if fails else 60],
        "simulated_steps": 150,
        **{f"num_{v.label.replace('-', '_')}": 0 for v in COUNTED},
    }


def writer(path, num_scenes: int, recipe=None, objects=None, **kwargs) -> BankWriter:
    """The real writer of a made-up bank of the trio."""
    objects = {asset.name: asset for asset in trio()} if objects is None else objects
    return BankWriter(path, recipe or RECIPE, num_scenes, objects, cuboid_table(), **kwargs)


def write_rows(path, block: int, table: pa.Table, record: dict) -> None:
    """Puts rows into a bank behind its back: `bank.json` hears nothing of it."""
    write_block(path, block, rows_bytes(table, record))


def write(path, num_blocks: int = 2) -> None:
    """Writes what is missing of a bank of whole blocks."""
    with writer(path, num_blocks * BLOCK_SIZE) as bank:
        for block in range(num_blocks):
            if not bank.has_block(block, BLOCK_SIZE):
                bank.write_block(block, rows(block))


def two_scenes(path) -> None:
    """A bank of two scenes that really stand, and one that failed: the third object has no part in any."""
    table = rows(0, 4).to_pylist()
    scenes = [table[0], table[1] | {"index": 1}, table[3] | {"index": 2}]
    for scene, objects in zip(scenes[:2], ([0, 1], [0, 2]), strict=True):
        half = [trio()[each].half_extents[2] for each in objects]
        scene["poses"] = [
            [x, 0, 0.7 + z, 1, 0, 0, 0] for x, z in zip((-0.1, 0.1), half, strict=True)
        ]
        scene |= {
            "object_index": objects,
            "objects": [NAMES[each] for each in objects],
            "num_placed": 2,
        }
        scene |= {
            "is_placed": [True, True],
            "attempts": [1, 1],
            "steps": [30, 30],
            "rest_steps": [30, 30],
        }
    with writer(path, 3) as bank:
        bank.write_block(0, pa.Table.from_pylist(scenes, schema=SCHEMA))


def with_files(path) -> None:
    """The same bank with the files of its scenes; given again, it mends what was changed."""
    if not path.exists():
        two_scenes(path)
    with writer(path, 3) as bank:
        write_files(read_bank(path), 3, ProblemConfig(), False, bank.keep_digests)


if __name__ == "__main__":
    write(sys.argv[1], int(sys.argv[2]))
