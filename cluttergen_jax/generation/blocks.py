"""Rows of a bank, block by block, as they are made here or by workers of a cluster."""

from __future__ import annotations

import ctypes
import platform
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow as pa

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.cluster import Cluster, each_on
from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.learning.methods import Method, sampler_of
from cluttergen_jax.learning.policies.checkpoint import read_checkpoint
from cluttergen_jax.numerics import bits_of_here, with_own_settings
from cluttergen_jax.physics import engine_of
from cluttergen_jax.placement.problem import Problem, ProblemConfig, Setup, compose
from cluttergen_jax.placement.rollout import (
    BlockSampler,
    Rollout,
    sample_block,
    sample_blocks,
)
from cluttergen_jax.placement.scenes import SceneBatch
from cluttergen_jax.placement.shelves import ShelfWorlds, Shelves, shelf_key
from cluttergen_jax.progress import Progress
from cluttergen_jax.scene.bank.record import differences
from cluttergen_jax.scene.bank.table import table_of

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
    return table_of(indices, scenes, problem.world.names, half_extents, numbers, geometry.hollows)


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
        names = self._shelves.draw(shelf_key(self._seed, block[0]))
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
