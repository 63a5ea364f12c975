"""A bank of scenes from names and numbers: sampled, summed up, and written with files to look at."""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.assets.rectangle_text import parse_keep_out, parse_region
from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import writing
from cluttergen_jax.generation.files import write_files
from cluttergen_jax.generation.make import set_up
from cluttergen_jax.learning.methods import FILTERED, Method, sampler_of
from cluttergen_jax.placement.config import MIN_MARGIN, placement_record
from cluttergen_jax.placement.problem import Problem, crowding
from cluttergen_jax.placement.rollout import BLOCK_SIZE, BlockSampler, blocks_of, sample_blocks
from cluttergen_jax.placement.setup import check_range, problem_config
from cluttergen_jax.scene.bank import Bank, BankWriter, read_bank
from cluttergen_jax.scene.bank.card import write_card
from cluttergen_jax.scene.bank.stats import summary_of
from cluttergen_jax.scene.bank.table import table_of
from cluttergen_jax.scene.bank.writer import names_of

MAX_SCENES = 10_000_000
_MOST = 2**32 - 1
_FEW = 0.5
_BETTER = {
    "random": "method='clear'",
    "clear": "method='drop'",
    "drop": "fewer objects",
    "ranked": "fewer objects",
    FILTERED: "method='drop'",
}


@dataclass(frozen=True, eq=False)
class GeneratedBank(Bank):
    """A bank as `generate` leaves it; printed, it tells how well it went.

    Attributes:
      notes: flagged objects, and a crowded region: said (stderr) before the first scene is made.
      summary: successes, attempts and rejections.
      advice: what to try where few scenes succeed, else "".
      files_written: what was written beside the table, "" if nothing was.
    """

    notes: tuple[str, ...] = ()
    summary: str = ""
    advice: str = ""
    files_written: str = ""

    def __str__(self) -> str:
        return "\n".join(filter(None, (self.summary, self.advice, self.files_written)))


def generate(
    out: str | Path = "out",
    *,
    pool: str | Path = "dining",
    num_scenes: int = 20,
    method: str | None = None,
    checkpoint: str | Path | None = None,
    num_objects: int | None = None,
    objects: Sequence[str] = (),
    exclude: Sequence[str] = (),
    support: str | Path = "table",
    region: Rectangle | str | None = None,
    containment: str = "center",
    order: str = "random",
    max_attempts: int = 5,
    min_margin: float = MIN_MARGIN,
    repeat: bool = False,
    start: str | None = None,
    keep_out: Sequence[Rectangle | str] = (),
    seed: int = 0,
    engine: str = "auto",
    num_threads: int = 0,
    render: bool = True,
    max_files: int = 1000,
    overwrite: bool = False,
) -> GeneratedBank:
    """Samples scenes and saves them as a bank, failures included; `cluttergen generate`.

    The same call continues an interrupted one, and mends what is damaged. Scene i of it is what
    `make_sampler` makes of the key `jax.random.fold_in(jax.random.key(seed), i)`.

    Args:
      out: the bank's folder.
      pool, method, checkpoint, num_objects, objects, exclude, support, containment, order, max_attempts,
        min_margin, repeat, start, engine, num_threads: as in `make_sampler`.
      num_scenes: scenes to make, failures counted.
      region, keep_out: as in `make_sampler`, or as the command line takes them: "WxD" or "X,Y,W,D[,YAW]" in
        metres and degrees.
      seed: the same seed makes the same scenes, 0 to 4294967295.
      render: draw a picture of each scene that gets a file.
      max_files: the first so many scenes get an MJCF file each (and a picture) if they succeed.
      overwrite: begin anew if the folder holds another bank.

    Returns:
      The bank; printed, it tells how well it went.

    Raises:
      ConfigError, PoolError: as `make_sampler`.
      BankError: the folder holds something else, cannot be written, or is being written by another process;
        or the scene to start from cannot be read.
    """
    check_range("num_scenes", num_scenes, 1, MAX_SCENES, 20)
    check_range("seed", seed, 0, _MOST, 0)
    if max_files < 0:
        raise ConfigError(f"max_files = {max_files}", "0 or more", "max_files=0 for none")
    boxes = [parse_keep_out(box) if isinstance(box, str) else box for box in keep_out]
    if isinstance(region, str):
        region = parse_region(region, find_support(support).region)
    config = problem_config(locals() | {"keep_out": boxes})
    chosen, setup = set_up(config, method, checkpoint, boxes, start)
    problem = setup.problem
    recipe = recipe_of(problem, chosen) | {
        "start": start,
        "keep_out": [box if isinstance(box, str) else dataclasses.asdict(box) for box in keep_out],
        "checkpoint": None if checkpoint is None else str(checkpoint),
        "seed": seed,
    }
    names = names_of(problem.world.objects)
    sampler, notes = sampler_of(setup, chosen), tuple(_notes(problem))
    with BankWriter(out, recipe, num_scenes, names, problem.world.support, overwrite) as writer:
        for note in notes:
            print(note, file=sys.stderr, flush=True)
        started = time.perf_counter()
        num_new = run_blocks(sampler, problem, writer, num_scenes, seed)
        bank = read_bank(out)
        summary = summary_of(bank.table, num_scenes, num_new, time.perf_counter() - started)
        with writing(bank.path):
            write_card(bank)
            num_files, written = min(num_scenes, max_files), ""
            if num_files > 0:
                written = write_files(bank, num_files, problem.config, render, writer.keep_digests)
    return GeneratedBank(
        bank.path,
        read_bank(out).record,
        notes=notes,
        summary=summary,
        advice=_advice(chosen.name, float(np.mean(bank.table["is_success"]))),
        files_written=written,
    )


def recipe_of(problem: Problem, method: Method) -> dict[str, Any]:
    """What decides the scenes of a bank; two equal recipes make equal scenes on one machine."""
    config = dataclasses.asdict(problem.config)
    # Neither decides a scene: threads do not, and every scene of a bank has the same region.
    for name in ("num_threads", "change"):
        config.pop(name)
    return {
        **config,
        "placement": placement_record(problem.config.placement),
        "region": dataclasses.asdict(problem.region),
        "method": method.name,
        "checkpoint_hash": method.checkpoint and method.checkpoint.hash,
        "block_size": BLOCK_SIZE,
        "names": problem.world.names,
        "versions": {name: version(name) for name in ("cluttergen_jax", "mujoco", "jax")},
    }


def run_blocks(
    sampler: BlockSampler, problem: Problem, writer: BankWriter, num_scenes: int, seed: int
) -> int:
    """Makes every block that the bank lacks; returns the number of new scenes."""
    missing = [(block, rows) for block, rows in blocks_of(num_scenes) if not writer.has_block(block, rows)]
    for block, indices, scenes in sample_blocks(sampler, missing, seed) if missing else ():
        writer.write_block(block, table_of(indices, scenes, problem.world.names))
    return sum(rows for _, rows in missing)


def _advice(method: str, success: float) -> str:
    """What to try where few scenes succeed; nothing where most do."""
    if success >= _FEW:
        return ""
    better = _BETTER.get(method, f"method={FILTERED!r}")
    return f"advice     few scenes succeed with {method} here; try {better} or a larger support"


def _notes(problem: Problem) -> Iterator[str]:
    crowded = crowding(problem.world.objects, problem.config.placement.num_objects, problem.region)
    for asset in {id(each): each for each in problem.world.objects}.values():
        if asset.flags:
            yield f"note: {asset.name}: {'; '.join(asset.flags)}"
    if crowded > 1:
        yield f"note: it is tight: the smallest objects alone cover {crowded:.1f} times the region's area"
