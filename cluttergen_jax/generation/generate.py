"""A bank of scenes: sampled block by block, here or on a cluster, summed up, with files to look at."""

from __future__ import annotations

import ctypes
import platform
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from cluttergen_jax.assets import ObjectAsset, SupportAsset
from cluttergen_jax.assets.sense import FREE, Named, read_sense
from cluttergen_jax.cluster import Cluster, each_on
from cluttergen_jax.errors import ClutterGenError, first_names
from cluttergen_jax.files import writing
from cluttergen_jax.generation.files import write_files
from cluttergen_jax.generation.recipe import recipe_of
from cluttergen_jax.generation.relation_advice import advice_on, relation_notes
from cluttergen_jax.generation.sampler import set_up_bank
from cluttergen_jax.learning.methods import DEFAULT_METHOD, Method, sampler_of
from cluttergen_jax.learning.policies.checkpoint import read_checkpoint
from cluttergen_jax.numerics import bits_of_here, with_own_settings
from cluttergen_jax.physics import engine_of
from cluttergen_jax.placement.problem import Problem, ProblemConfig, Setup, compose
from cluttergen_jax.placement.rollout import (
    BlockSampler,
    Rollout,
    blocks_of,
    sample_block,
    sample_blocks,
)
from cluttergen_jax.placement.room import USUALLY_PACKED, area_of, crowding, share_packed
from cluttergen_jax.placement.scenes import SceneBatch
from cluttergen_jax.placement.shelves import ShelfWorlds, Shelves
from cluttergen_jax.progress import Progress
from cluttergen_jax.scene.bank import Bank, BankWriter, read_bank
from cluttergen_jax.scene.bank.card import write_card
from cluttergen_jax.scene.bank.record import differences
from cluttergen_jax.scene.bank.relation_tally import RelationFailures, RelationTally
from cluttergen_jax.scene.bank.remote import publish_all, url_of
from cluttergen_jax.scene.bank.stats import ClutterTally, Totals
from cluttergen_jax.scene.bank.table import table_of
from cluttergen_jax.scene.bank.writer import Objects, names_of
from cluttergen_jax.schema import Record
from cluttergen_jax.spec import MOST_UNASKED, SceneSpec

_FEW = 0.5
_OFTEN = 0.1
"""Share of the scenes that fail at a relation from which it is said what helps."""
_MOST_NAMED = 8
_ROOM = "fewer objects, a larger region or a larger `budget`"


@dataclass(frozen=True, eq=False, repr=False)
class GeneratedBank(Bank):
    """A bank as `generate` leaves it; printed, it tells how well it went.

    Attributes:
      notes: flagged objects, those that find no room, and a crowded region: said (stderr) before the first
        scene is made.
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
    asked_in_words: Record | None = None,
) -> GeneratedBank:
    """The bank of a request and a seed in a folder, begun or continued; see `cluttergen_jax.generate`.

    Args:
      asked_in_words: the sentence and the model that its layout is from (`layouts.asked_of`).
    """
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
    if asked_in_words is not None:
        recipe["asked"] = asked_in_words

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
    named = problem.world.objects if shelves is None else shelves.pool.facts
    notes = tuple(_notes(problem, named, spec.theme))
    with BankWriter(
        out,
        recipe,
        num_scenes,
        names,
        problem.world.finished_support,
        overwrite,
        bits=bits,
        allow_other_bits=allow_other_bits,
        open_support=None if problem.world.doors is None else problem.world.support,
    ) as writer:
        for note in notes:
            print(note, file=sys.stderr, flush=True)
        started = time.perf_counter()
        num_new = run_blocks(make_tables, writer, num_scenes)
        bank = read_bank(writer.path)
        totals = Totals()
        clutter = ClutterTally(bank)
        relations = RelationTally(bank)
        for rows in bank.tables():
            rows = rows.filter(pc.less(rows["index"], num_scenes))
            totals.add(rows)
            clutter.add(rows)
            relations.add(rows)
        asked = [each.line() for each in clutter.features() if each.asked is not None]
        summary = totals.text(num_new, time.perf_counter() - started)
        if bank.num_scenes > num_scenes:
            summary += f"\nbank       holds {bank.num_scenes} scenes, {num_scenes} counted here"
        failed = relations.failures()
        summary = "\n".join(
            [
                summary,
                *(f"clutter    {line}" for line in asked),
                *(f"relations  {each.line()}" for each in failed),
            ]
        )
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
        advice=_advice(method.name, totals, failed),
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


def _advice(method: str, totals: Totals, failed: Sequence[RelationFailures]) -> str:
    """What to try where few scenes succeed, or many fail at relations; nothing where most do well."""
    hints = [advice_on(each) for each in failed if each.scenes >= _OFTEN * each.total]
    if hints:
        return "\n".join(f"advice     {hint}" for hint in hints)
    if totals.success >= _FEW * totals.scenes:
        return ""
    better = _ROOM if method == DEFAULT_METHOD else f"method={DEFAULT_METHOD!r}"
    if totals.hits:
        (text, _), *_ = totals.hits.most_common(1)
        better = f"overhang='none', as {text}; smaller objects, fewer of them, or doors='open'"
    return f"advice     few scenes succeed with {method} here; try {better}"


def _notes(problem: Problem, named: Sequence[Named], theme: str) -> Iterator[str]:
    """What is to be known before the first scene; `named` are all objects that may be drawn."""
    world = problem.world
    placement = problem.config.placement
    crowded = crowding(world.objects, placement.num_objects, problem.region, area_of(world.support))
    yield from (f"note: {note}" for note in problem.notes)
    for asset in {id(each): each for each in problem.world.objects}.values():
        if asset.flags:
            yield f"note: {asset.name}: {'; '.join(asset.flags)}"
    yield from relation_notes(problem)
    if placement.most_stacked is not None:
        area = area_of(world.support) or 4 * float(np.prod(problem.region.half_extents))
        _, most = share_packed(world.objects, placement, area)
        if most > USUALLY_PACKED:
            yield (
                f"note: it is tight: the outlines of some draws cover {most:.2f} of the region, where not "
                "all objects find room side by side"
            )
    if problem.config.placement.natural:
        sense = read_sense(problem.config.placement.sense)
        free = sorted({each.name for each in named if sense.kind_of(each) == FREE})
        if free:
            yield (
                f"note: sense: {len(free)} objects without a known label are free, to be anywhere: "
                f"{first_names(free, _MOST_NAMED)}"
            )
    if theme and len(named) < MOST_UNASKED:
        names = first_names([each.name for each in named], _MOST_NAMED)
        yield f"note: theme {theme!r}: of this pool {len(named)} belong to it: {names}"
    if crowded > 1:
        yield f"note: it is tight: the smallest objects alone cover {crowded:.1f} times the region's area"


Block = tuple[int, int]
"""The number of a block, and how many of its scenes are wanted."""


def blocks_here(
    sampler: BlockSampler, problem: Problem, blocks: Sequence[Block], seed: int
) -> Iterator[tuple[int, pa.Table]]:
    """Yields the number and the rows of each block, in order."""
    for block, indices, scenes in sample_blocks(sampler, blocks, seed) if blocks else ():
        yield block, _rows(problem, indices, scenes)


def blocks_on(
    cluster: Cluster,
    setup: Setup,
    method: Method,
    blocks: Sequence[Block],
    seed: int,
    bits: dict[str, str] | None = None,
    shelves: Shelves | None = None,
) -> Iterator[tuple[int, pa.Table]]:
    """Likewise, as the workers of a cluster make them.

    Args:
      shelves: what blocks draw their objects from, if they do.
      bits: what workers have to compute by (`numerics.bits_of_here`); None for anything.
    """
    maker = replace(BlockMaker.of(setup, method, seed), bits=bits)
    items: Sequence[Any] = blocks if shelves is None else _ShelvedBlocks(shelves, blocks, seed)
    made = each_on(cluster, maker, items, "block", maker.config.num_threads, int(_is_on_gpu(setup)))
    with Progress("placing", sum(rows for _, rows in blocks), "scene") as progress, closing(made):
        if blocks:
            progress.say("workers start, and each compiles: about 30 s until the first scenes")
        for place, table in made:
            yield blocks[place][0], table
            progress.update(table.num_rows, f"{progress.rate(table.num_rows):.1f} scenes/s")


def shelved_blocks_here(
    shelves: Shelves, method: Method, blocks: Sequence[Block], seed: int
) -> Iterator[tuple[int, pa.Table]]:
    """`blocks_here`, each of objects of its own."""
    rollout = Rollout()
    with Progress("compiling", sum(rows for _, rows in blocks), "scene") as progress:

        def count(number: int, _: Any) -> None:
            progress.rename("placing")
            progress.update(number)

        for block, rows in blocks:
            setup = shelves.block(seed, block)
            made = sample_block(rollout, sampler_of(setup, method), block, rows, seed, count)
            yield block, _rows(setup.problem, *made, shelves.numbers(setup.problem.world.names))


def _rows(
    problem: Problem, indices: np.ndarray, scenes: SceneBatch, numbers: np.ndarray | None = None
) -> pa.Table:
    """Rows of scenes.

    Args:
      numbers: i32[K], of the world's objects among those that the bank's record names; as there if None.
    """
    _give_back_memory()
    geometry = problem.rules.geometry
    half_extents = np.asarray(geometry.half_extents)
    world = problem.world
    return table_of(
        indices, scenes, world.names, half_extents, numbers, geometry.hollows, world.doors
    )


def _give_back_memory() -> None:
    """Returns what a block has freed to the system; without it, glibc's heaps grow from block to block.

    Steps run in threads that come and go, and each has its own part of the heap.
    """
    # Where the C library has no such call, its heaps are of another kind.
    if trim := getattr(ctypes.CDLL(None), "malloc_trim", None):
        trim(0)


class _ShelvedBlocks(Sequence[tuple[Block, tuple[ObjectAsset, ...], np.ndarray]]):
    """Blocks with the objects of their shelves, which are read when a worker is free for one."""

    def __init__(self, shelves: Shelves, blocks: Sequence[Block], seed: int) -> None:
        self._shelves = shelves
        self._blocks = blocks
        self._seed = seed

    def __len__(self) -> int:
        return len(self._blocks)

    def __getitem__(self, place: Any) -> Any:
        block = self._blocks[place]
        names = self._shelves.names_of_block(self._seed, block[0])
        return (
            block,
            tuple(self._shelves.pool[name] for name in names),
            self._shelves.numbers(names),
        )


@dataclass(frozen=True, eq=False)
class BlockMaker:
    """What makes the blocks of a bank in another process, assets and weights included: it reads no files.

    Attributes:
      config: of the problem, with as many threads as a worker has cores, and this process's engine.
      objects, standing: those that are placed, and those that stand there when an episode begins. Where
        blocks draw objects of their own, they come with each block, and here are those of one.
      radius: metres, see `placement.problem.WorldSizes`; None where all blocks have the same objects.
      keep_out, start: of `Setup`, as NumPy arrays.
      weights: the files of the method's checkpoint by name; None for a baseline.
      bits: what a worker has to compute by; None for anything.
    """

    config: ProblemConfig
    objects: tuple[ObjectAsset, ...]
    standing: tuple[ObjectAsset, ...]
    support: SupportAsset
    keep_out: Any
    start: Any
    method: str
    weights: dict[str, bytes] | None
    seed: int
    radius: float | None = None
    bits: dict[str, str] | None = None

    @classmethod
    def of(cls, setup: Setup, method: Method, seed: int) -> BlockMaker:
        """What makes the blocks of a setup; a worker has one thread unless more are asked for."""
        config = setup.problem.config
        world = setup.problem.world
        first = world.num_objects - setup.problem.rules.num_started
        return cls(
            config=replace(
                config,
                num_threads=config.num_threads or 1,
                engine=engine_of(config.engine, config.stability),
            ),
            objects=world.objects[:first],
            standing=world.objects[first:],
            support=world.support,
            keep_out=jax.device_get(setup.keep_out),
            start=jax.device_get(setup.start),
            method=method.name,
            weights=None if method.checkpoint is None else method.checkpoint.files(),
            seed=seed,
            radius=setup.problem.rules.map_radius,
        )

    @with_own_settings
    def __call__(self) -> Callable[[Any], pa.Table]:
        """The function that makes a block's rows; see `check_worker`."""
        check_worker(self.bits)
        keep_out, start = jax.tree.map(jnp.asarray, (self.keep_out, self.start))
        if self.radius is None:
            problem = compose(self.objects, self.support, self.config, self.standing)
            sampler = self._sampler(Setup(problem, keep_out, start))
            rollout = Rollout(is_constant=True)

            @with_own_settings
            def make(block: Block) -> pa.Table:
                return _rows(problem, *sample_block(rollout, sampler, *block, self.seed))

            return make
        worlds = ShelfWorlds(self.config, self.support, self.radius, keep_out, _not_at_hand)
        shared = Rollout()

        @with_own_settings
        def make_shelved(item: tuple[Block, tuple[ObjectAsset, ...], np.ndarray]) -> pa.Table:
            (block, rows), objects, numbers = item
            setup = worlds.setup(objects)
            made = sample_block(shared, self._sampler(setup), block, rows, self.seed)
            return _rows(setup.problem, *made, numbers)

        return make_shelved

    def _sampler(self, setup: Setup) -> BlockSampler:
        with tempfile.TemporaryDirectory() as folder:
            for name, data in (self.weights or {}).items():
                Path(folder, name).write_bytes(data)
            checkpoint = None if self.weights is None else read_checkpoint(Path(folder))
            return sampler_of(setup, Method(self.method, checkpoint))


def _not_at_hand(name: str) -> ObjectAsset:
    raise AssertionError(f"{name} is of a block that is made already")


def bits_of(setup: Setup, cluster: Cluster | None) -> dict[str, str]:
    """By what scenes are computed (`numerics.bits_of_here`), here or by workers of this machine's kind."""
    # Without a GPU engine workers see no GPU.
    return bits_of_here() | ({} if cluster is None or _is_on_gpu(setup) else {"device": "cpu"})


def _is_on_gpu(setup: Setup) -> bool:
    config = setup.problem.config
    return engine_of(config.engine, config.stability) == "warp"


def check_worker(bits: dict[str, str] | None) -> None:
    """Refuses (ClutterGenError) where scenes would have other bits than the bank's; None allows any."""
    here = bits_of_here()
    if bits is not None and here != bits:
        others = "; ".join(differences(here, bits))
        raise ClutterGenError(
            f"scenes of a worker on {platform.node()} would have other bits than those of the bank: {others}",
            "machines of one kind, which make the same scenes",
            "`allow_other_bits` for a bank that is a mixture",
        )
