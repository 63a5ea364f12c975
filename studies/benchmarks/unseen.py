"""Scenes of a thousand shapes that nothing was trained on, PyBullet's random objects: crowds, and diversity.

The objects come with the package pybullet (extra `peers`) and are imported first, once: half an hour on two
cores. The rest takes a quarter of an hour.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np
import tyro

import cluttergen_jax as cg
from cluttergen_jax.errors import PoolError
from cluttergen_jax.evaluation.measures.arrangement import by_object
from cluttergen_jax.evaluation.measures.diversity import embed, scene_kernel, vendi_score
from cluttergen_jax.rendering.assets import render_scene
from cluttergen_jax.rendering.sheet import contact_sheet, save_png
from cluttergen_jax.statistics import proportion
from studies.benchmarks.section import IMAGES, prose, report, table

POOL = "urdfs"
CROWDS: dict[tuple[int, str], int] = {(30, "table"): 64, (100, "table-1.20x0.80"): 24}
"""Objects and support, and how many scenes of each shelf."""
_BUDGET = 40
_SHELF = 64
_HEADER = (
    *("objects", "support", "success [95 %]", "attempts of a scene", "within 40 attempts"),
    "scenes per CPU-second",
)


@dataclass(frozen=True)
class Unseen:
    """What is measured.

    Attributes:
      shelves: draws of objects for each crowd; each has the scenes of a bank of its own seed.
      num_alike: scenes of ten objects whose diversity is compared; 0 for none.
      write: put the table into reports/benchmarks.md, and the picture beside it.
    """

    shelves: int = 4
    num_alike: int = 256
    write: bool = False


def num_objects() -> int:
    """How many the pool has; it is imported if there is none."""
    import pybullet_data

    from cluttergen_jax.assets.pool import find_pool

    try:
        return len(find_pool(POOL))
    except PoolError:
        cg.import_pool([Path(pybullet_data.getDataPath()) / "random_urdfs"], pool=POOL)
        return len(find_pool(POOL))


def crowd(number: int, support: str, config: Unseen, pictures: dict[str, np.ndarray]) -> list[str]:
    """A row; pictures of the first successes are put into `pictures`."""
    successes = []
    attempts = []
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(config.shelves):
            bank = cg.generate(
                Path(folder, str(seed)),
                pool=POOL,
                num_objects=number,
                support=support,
                num_scenes=CROWDS[number, support],
                seed=seed,
                max_files=0,
            )
            successes += bank.table["is_success"].to_pylist()
            attempts += [sum(row) for row in bank.table["attempts"].to_pylist()]
            scene = next(cg.read_scenes(bank), None)
            if scene is not None:
                pictures[f"{number} of 1,000, seed {seed}"] = render_scene(
                    scene.objects,
                    scene.poses,
                    scene.support,
                    close=True,
                    width=360,
                    height=270,
                    samples=24,
                )
    rate = sum(successes) / (time.process_time() - began)
    found = proportion(np.array(successes))
    used = np.array(attempts)
    within = np.mean(np.array(successes) & (used <= _BUDGET)) if number <= _BUDGET else None
    return [
        str(number),
        support,
        f"{found['share']:.3f} [{found['low95']:.3f}, {found['high95']:.3f}] of {len(successes)}",
        f"{used.mean():.1f}",
        "-" if within is None else f"{within:.3f}",
        f"{rate:.2f}",
    ]


def diversity(method: str, number: int) -> tuple[float, int]:
    """Vendi score of scenes of the same ten objects, and how many scenes there are."""
    names = tuple(f"{place:03}" for place in range(0, 1000, 100))
    sample = cg.make_sampler(POOL, objects=names, num_objects=10, method=method)
    keys = jax.random.split(jax.random.key(0), 2 * number)
    scenes = jax.device_get(jax.jit(jax.vmap(sample))(keys))
    good = np.flatnonzero(scenes.is_success)[:number]
    world = sample.problem.world
    rows = (scenes.object_index[good], scenes.is_placed[good], scenes.poses[good])
    poses, is_placed, _ = by_object(*rows, len(world.objects))
    region = world.support.region
    vectors = embed(world.objects, poses, is_placed, region, world.support.top)
    return vendi_score(scene_kernel(vectors, region)), len(good)


def rows_of(config: Unseen, pictures: dict[str, np.ndarray]) -> Iterator[list[str]]:
    """A row a crowd."""
    for number, support in CROWDS:
        row = crowd(number, support, config, pictures)
        print(row, file=sys.stderr, flush=True)
        yield row


def main(config: Unseen) -> None:
    """Prints the table."""
    total = num_objects()
    pictures = dict[str, np.ndarray]()
    rows = list(rows_of(config, pictures))
    text = prose(f"""
        `guided` on PyBullet's `random_urdfs`: {total:,} objects, none of them seen in training, imported as
        they are. Each of {config.shelves} seeds draws a shelf of them. CPU-seconds include compiling.
    """)
    told = ""
    if config.num_alike:
        ours, theirs = (diversity(method, config.num_alike) for method in ("guided", "random"))
        number = min(ours[1], theirs[1])
        if ours[1] != theirs[1]:
            ours, theirs = (diversity(method, number) for method in ("guided", "random"))
        told = prose(f"""
            Vendi score of {number} stable scenes of ten of them, the same ones, on 0.60 x 0.70 m:
            `guided` {ours[0]:.1f}, `random` (rejection sampling) {theirs[0]:.1f}:
            {ours[0] / theirs[0]:.2f} of it.
        """)
    sheet = (
        "\n\n![Scenes of a thousand shapes](images/unseen.png)" if config.write and pictures else ""
    )
    if sheet:
        save_png(
            contact_sheet(list(pictures.values()), list(pictures), columns=4), IMAGES / "unseen.png"
        )
    body = f"## A thousand unseen shapes\n\n{text}\n\n{table(_HEADER, rows)}\n\n{told}{sheet}"
    report("unseen", body, write=config.write)


if __name__ == "__main__":
    main(tyro.cli(Unseen))
