"""A bank of scenes: sampled, summed up, and written with files to look at."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from cluttergen_jax.cluster import Cluster
from cluttergen_jax.files import writing
from cluttergen_jax.generation.blocks import (
    Block,
    bits_of,
    blocks_here,
    blocks_on,
    shelved_blocks_here,
)
from cluttergen_jax.generation.files import write_files
from cluttergen_jax.generation.recipe import recipe_of
from cluttergen_jax.generation.sampler import set_up_bank
from cluttergen_jax.learning.methods import DEFAULT_METHOD, sampler_of
from cluttergen_jax.placement.problem import Problem
from cluttergen_jax.placement.rollout import blocks_of
from cluttergen_jax.placement.room import area_of, crowding
from cluttergen_jax.scene.bank import Bank, BankWriter, read_bank
from cluttergen_jax.scene.bank.card import write_card
from cluttergen_jax.scene.bank.remote import publish_all, url_of
from cluttergen_jax.scene.bank.stats import ClutterTally, Totals
from cluttergen_jax.scene.bank.writer import Objects, names_of
from cluttergen_jax.spec import SceneSpec

_FEW = 0.5
_ROOM = "fewer objects, a larger region or a larger `budget`"


@dataclass(frozen=True, eq=False, repr=False)
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


def write_bank(
    out: str | Path,
    spec: SceneSpec,
    seed: int,
    num_scenes: int,
    render: bool = True,
    max_files: int = 1000,
    overwrite: bool = False,
    cluster: Cluster | None = None,
    allow_other_bits: bool = False,
) -> GeneratedBank:
    """The bank of a request and a seed in a folder, begun or continued; see `cluttergen_jax.generate`."""
    # Where blocks draw their objects from `shelves`, the setup is the first block's.
    method, setup, shelves = set_up_bank(spec, seed)
    problem = setup.problem
    sampler = sampler_of(setup, method)
    bits = bits_of(setup, cluster)
    recipe = recipe_of(
        problem,
        method,
        seed,
        spec.keep_out,
        spec.start,
        spec.checkpoint,
        None if shelves is None else shelves.pool.names,
    )

    def make_tables(blocks: Sequence[Block]) -> Iterator[tuple[int, pa.Table]]:
        if cluster is not None:
            wanted = None if allow_other_bits else bits
            return blocks_on(cluster, setup, method, blocks, seed, wanted, shelves)
        if shelves is not None:
            return shelved_blocks_here(shelves, method, blocks, seed)
        return blocks_here(sampler, problem, blocks, seed)

    names: Objects = (
        names_of(problem.world.objects) if shelves is None else shelves.pool.__getitem__
    )
    notes = tuple(_notes(problem))
    with BankWriter(
        out,
        recipe,
        num_scenes,
        names,
        problem.world.support,
        overwrite,
        bits=bits,
        allow_other_bits=allow_other_bits,
    ) as writer:
        for note in notes:
            print(note, file=sys.stderr, flush=True)
        started = time.perf_counter()
        num_new = run_blocks(make_tables, writer, num_scenes)
        bank = read_bank(writer.path)
        totals = Totals()
        clutter = ClutterTally(bank)
        for rows in bank.tables():
            rows = rows.filter(pc.less(rows["index"], num_scenes))
            totals.add(rows)
            clutter.add(rows)
        asked = [each.line() for each in clutter.features() if each.asked is not None]
        summary = totals.text(num_new, time.perf_counter() - started)
        if bank.num_scenes > num_scenes:
            summary += f"\nbank       holds {bank.num_scenes} scenes, {num_scenes} counted here"
        summary = "\n".join([summary, *(f"clutter    {line}" for line in asked)])
        with writing(bank.path):
            write_card(bank)
            num_files = min(num_scenes, max_files)
            written = ""
            if num_files > 0:
                written = write_files(bank, num_files, problem.config, render, writer.keep_digests)
            record = read_bank(writer.path).record
            publish_all(bank.path)
            if url := url_of(bank.path):
                written = "\n".join(filter(None, (written, f"stored     {url}")))
    return GeneratedBank(
        bank.path,
        record,
        notes=notes,
        summary=summary,
        advice=_advice(method.name, totals.success / totals.scenes),
        files_written=written,
    )


def run_blocks(
    made: Callable[[Sequence[Block]], Iterator[tuple[int, pa.Table]]],
    writer: BankWriter,
    num_scenes: int,
) -> int:
    """Makes every block that the bank lacks; returns the number of new scenes."""
    missing = [
        (block, rows) for block, rows in blocks_of(num_scenes) if not writer.has_block(block, rows)
    ]
    for block, table in made(missing):
        writer.write_block(block, table)
    writer.finish()
    return sum(rows for _, rows in missing)


def _advice(method: str, success: float) -> str:
    """What to try where few scenes succeed; nothing where most do."""
    if success >= _FEW:
        return ""
    better = _ROOM if method == DEFAULT_METHOD else f"method={DEFAULT_METHOD!r}"
    return f"advice     few scenes succeed with {method} here; try {better}"


def _notes(problem: Problem) -> Iterator[str]:
    world = problem.world
    number = problem.config.placement.num_objects
    crowded = crowding(world.objects, number, problem.region, area_of(world.support))
    for asset in {id(each): each for each in problem.world.objects}.values():
        if asset.flags:
            yield f"note: {asset.name}: {'; '.join(asset.flags)}"
    if crowded > 1:
        yield f"note: it is tight: the smallest objects alone cover {crowded:.1f} times the region's area"
