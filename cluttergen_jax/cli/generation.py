"""From the options of `cluttergen generate` to a bank: the problem, its recipe, the blocks, the files."""

from __future__ import annotations

import dataclasses
import time
from importlib.metadata import version
from typing import Any

import numpy as np

from cluttergen_jax.assets.pool import composed, find_pool
from cluttergen_jax.assets.reach import check_keep_out
from cluttergen_jax.assets.rectangle_text import parse_keep_out, parse_region
from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.bank import BankWriter, read_bank
from cluttergen_jax.bank.card import write_card
from cluttergen_jax.bank.reference import read_start, start_of
from cluttergen_jax.bank.stats import summary_of
from cluttergen_jax.bank.table import table_of
from cluttergen_jax.bank.writer import names_of
from cluttergen_jax.cli.files import write_files
from cluttergen_jax.cli.generate import Generate
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import writing
from cluttergen_jax.methods import (
    FILTERED,
    checkpoint_hash,
    choose_method,
    proposer_of,
    suited,
)
from cluttergen_jax.placement.config import MAX_SLOTS, PlacementConfig, placement_record
from cluttergen_jax.policies.checkpoint import Checkpoint
from cluttergen_jax.problem import Problem, ProblemConfig, check_number, crowding, keep_out_of, make_problem
from cluttergen_jax.sampling import BLOCK_SIZE, BlockSampler, blocks_of, sample_blocks

MAX_SCENES = 10_000_000
_FEW = 0.5
_BETTER = {
    "random": "--method clear",
    "clear": "--method drop",
    "drop": "fewer objects",
    "ranked": "fewer objects",
    FILTERED: "--method drop",
}


def generate(args: Generate) -> int:
    """Makes the bank, or what it lacks; the exit status."""
    if not 1 <= args.num_scenes <= MAX_SCENES:
        raise ConfigError(f"--num-scenes {args.num_scenes}", f"1 to {MAX_SCENES}", "--num-scenes 20")
    if not 0 <= args.seed < 2**32:
        raise ConfigError(f"--seed {args.seed}", "0 to 4294967295")
    if args.max_files < 0:
        raise ConfigError(f"--max-files {args.max_files}", "0 or more", "--max-files 0 for none")
    args = dataclasses.replace(args, pool=composed(args.pool, args.exclude), exclude=())
    config = problem_config(args)
    num_objects = config.placement.num_objects
    method, checkpoint = choose_method(args.method, args.pool, args.support, num_objects, args.checkpoint)
    config = dataclasses.replace(config, placement=suited(config.placement, checkpoint))
    standing, poses = read_start(args.start)
    problem = make_problem(config, standing)
    start = start_of(problem.world, standing, poses)
    keep_out = [parse_keep_out(text) for text in args.keep_out]
    check_keep_out(keep_out, problem.region)
    propose = proposer_of(method, checkpoint, problem.rules)
    sampler = BlockSampler(problem.rules, propose, keep_out_of(keep_out), start)
    _warn_of_flags(problem)
    _warn_of_crowding(problem)
    with BankWriter(
        args.out,
        recipe_of(args, method, problem, checkpoint),
        args.num_scenes,
        names_of(problem.world.objects),
        problem.world.support,
        args.overwrite,
    ) as writer:
        started = time.perf_counter()
        num_new = run_blocks(sampler, problem, writer, args.num_scenes, args.seed)
        bank = read_bank(args.out)
        print(summary_of(bank.table, args.num_scenes, num_new, time.perf_counter() - started), flush=True)
        if advice := _advice(method, float(np.mean(bank.table["is_success"]))):
            print(advice)
        with writing(bank.path):
            write_card(bank)
            if (num_files := min(args.num_scenes, args.max_files)) > 0:
                write_files(bank, num_files, problem.config, args.render, writer.keep_digests)
    return 0


def problem_config(args: Generate) -> ProblemConfig:
    """The problem that the command line asks for."""
    available = len(args.objects) or len(find_pool(args.pool))
    num_objects = args.num_objects if args.num_objects is not None else min(available, MAX_SLOTS)
    check_number(num_objects, available, args.pool, args.repeat)
    region: Rectangle | None = None
    if args.region is not None:
        region = parse_region(args.region, find_support(args.support).region)
    return ProblemConfig(
        pool=args.pool,
        objects=args.objects,
        repeat=args.repeat,
        support=args.support,
        region=region,
        engine=args.engine,
        num_threads=args.threads,
        placement=PlacementConfig(
            num_objects=num_objects,
            max_attempts=args.attempts,
            containment=args.containment,
            order=args.order,
            min_margin=args.min_margin,
        ),
    )


def recipe_of(args: Generate, method: str, problem: Problem, checkpoint: Checkpoint | None) -> dict[str, Any]:
    """What decides the scenes of a bank; two equal recipes make equal scenes on one machine."""
    config = dataclasses.asdict(problem.config)
    # Neither decides a scene: threads do not, and every scene of a bank has the same region.
    for name in ("num_threads", "change"):
        config.pop(name)
    return {
        **config,
        "placement": placement_record(problem.config.placement),
        "region": dataclasses.asdict(problem.region),
        "start": args.start,
        "keep_out": args.keep_out,
        "method": method,
        "checkpoint": args.checkpoint,
        "checkpoint_hash": None if checkpoint is None else checkpoint_hash(checkpoint.path),
        "seed": args.seed,
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
    better = _BETTER.get(method, f"--method {FILTERED}")
    return f"advice     few scenes succeed with {method} here; try {better} or a larger support"


def _warn_of_crowding(problem: Problem) -> None:
    crowded = crowding(problem.world.objects, problem.config.placement.num_objects, problem.region)
    if crowded > 1:
        print(f"note: it is tight: the smallest objects alone cover {crowded:.1f} times the region's area")


def _warn_of_flags(problem: Problem) -> None:
    for asset in {id(each): each for each in problem.world.objects}.values():
        if asset.flags:
            print(f"note: {asset.name}: {'; '.join(asset.flags)}")
