"""How many saved scenes of a bank stand for ten seconds in PyBullet and in Drake (extra `peers`).

    python -m studies.benchmarks.other_engines BANK ... --num-scenes 200

The settings are those of the export guide; what counts as standing is 5 mm and 5 degrees, but for what all
objects of a scene sink together. A scene of ten objects takes Drake about eight CPU-seconds.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from cluttergen_jax.judging.scene_models import SceneModels, by_object
from cluttergen_jax.placement.world import base_name, make_world
from cluttergen_jax.scene.bank import read_bank
from studies.measures.survival import PEERS, movement_elsewhere


@dataclass(frozen=True)
class OtherEngines:
    """What is simulated.

    Attributes:
      banks: folders that `cluttergen generate` wrote, without a shelf.
      num_scenes: the first so many successes of each.
      engines: pybullet, drake.
    """

    banks: Annotated[tuple[Path, ...], tyro.conf.Positional]
    num_scenes: int = 200
    engines: tuple[str, ...] = PEERS


def scenes_of(path: Path, count: int) -> tuple[SceneModels, np.ndarray, np.ndarray]:
    """Models, and f64[N, K, 7] and bool[N, K]: poses by object, and which objects are there."""
    bank = read_bank(path)
    objects = [bank.object(base_name(name)) for name in bank.recipe["names"]]
    stability = bank.stability
    contact = bank.contact
    models = SceneModels(make_world(objects, bank.support, stability, contact), stability, contact)
    rows = bank.table.select(["is_success", "object_index", "is_placed", "poses"]).to_pylist()
    good = [row for row in rows if row["is_success"]][:count]
    arrays = (np.array([row[name] for row in good]) for name in ("object_index", "is_placed"))
    poses = np.array([row["poses"] for row in good]).reshape(len(good), -1, 7)
    placed, is_placed, _ = by_object(*arrays, poses, len(objects))
    return models, placed, is_placed


def main(args: OtherEngines) -> None:
    """Prints a line for each bank and engine."""
    for path in args.banks:
        models, poses, is_placed = scenes_of(path, args.num_scenes)
        for engine in args.engines:
            began = time.process_time()
            stands = movement_elsewhere(engine, models, poses, is_placed).survives()[:, 0]
            seconds = time.process_time() - began
            print(
                f"{path}: {stands.sum()} of {len(stands)} stand 10 s in {engine}, {seconds:.0f} CPU-s"
            )


if __name__ == "__main__":
    main(tyro.cli(OtherEngines))
