"""`cluttergen train --suite`: all runs of a suite, one after another, each from where it stopped."""

from __future__ import annotations

import dataclasses
import gc
import os
import statistics
import sys
from pathlib import Path
from typing import Any

import jax
from tqdm import tqdm

from cluttergen_jax.agent.checkpoint import check_folder, has_state, read_record
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.cli.train import Train, recipe_of
from cluttergen_jax.errors import ClutterGenError, ConfigError
from cluttergen_jax.evaluation.published import BUDGET
from cluttergen_jax.progress import time_text
from cluttergen_jax.training.metrics_log import read_rows
from cluttergen_jax.training.suite import PlannedRun, plan

RATE = 450.0
"""Attempts per second until a run of the suite has told its own: preset `cpu`, dining, beside another run."""


@dataclasses.dataclass(frozen=True)
class Standing:
    """How far one run of a suite has come.

    Attributes:
      planned: the run; command: `cluttergen train` for it.
      attempts: made so far; total: of the whole run.
      rate: attempts per second, lately; None before the first.
      is_done: trained and, if that was asked for, evaluated.
      success: of its evaluation, or of training; None before.
    """

    planned: PlannedRun
    command: Train
    attempts: int
    total: int
    rate: float | None
    is_done: bool
    success: float | None

    @property
    def word(self) -> str:
        """For the list."""
        return "done" if self.is_done else "begun" if self.attempts else "to do"


def run_suite(args: Train) -> int:
    """Lists or makes the runs of `args.suite`; the exit status, 1 if any of them failed.

    Ctrl-C stops the whole suite; the same command takes it up again.
    """
    for pool in args.pools:
        find_pool(pool)
    runs = plan(str(args.suite), args.pools, args.seeds, args.suite_only)
    root = Path(args.out or "runs")
    standings = [_standing(args, run, root) for run in runs]
    print(_overview(standings))
    if args.suite_list:
        return 0
    failed = []
    for number, standing in enumerate(standings, 1):
        name = standing.planned.name
        if standing.is_done:
            continue
        print(f"\n{number}/{len(standings)}  {name}")
        try:
            standing.command.train()
        except ClutterGenError as error:
            failed.append(name)
            print(f"error: {name}: {error}", file=sys.stderr)
        # The next run has another world: programs and engines of this one are never used again.
        jax.clear_caches()
        gc.collect()
    print(f"\n{len(standings) - len(failed)} of {len(standings)} runs done, in {root}")
    if failed:
        print(f"failed: {', '.join(failed)}; the same command tries them again", file=sys.stderr)
    return 1 if failed else 0


def command_of(args: Train, run: PlannedRun, root: Path) -> Train:
    """`cluttergen train` for one run of a suite."""
    return dataclasses.replace(
        args,
        pool=run.pool,
        variant=run.variant,
        seed=run.seed,
        attempts=run.attempts,
        support=run.support,
        num_objects=run.num_objects,
        out=str(root / run.name),
        suite=None,
    )


def _standing(args: Train, run: PlannedRun, root: Path) -> Standing:
    """Reads how far a run has come.

    Raises:
      ConfigError: its folder holds a run with other settings.
    """
    command = command_of(args, run, root)
    settings = command.settings()
    check_folder(command.folder, recipe_of(command, settings))
    batch, total = settings.ppo.batch_size, settings.ppo.num_updates * settings.ppo.batch_size
    last, policy = command.folder / "last", command.folder / "policy"
    attempts = int(read_record(last)["num_updates"]) * batch if has_state(last) else 0
    record: dict[str, Any] = read_record(policy) if (policy / "record.json").exists() else {}
    is_evaluated = "evaluation" in record or not args.eval_episodes
    rows = read_rows(command.folder / "progress.csv")
    rate = statistics.median(row["attempts_per_second"] for row in rows[-50:]) if rows else None
    return Standing(
        planned=run,
        command=command,
        attempts=attempts,
        total=total,
        rate=rate,
        is_done=attempts >= total and bool(record) and is_evaluated,
        success=record.get("evaluation", record).get("success"),
    )


def _overview(standings: list[Standing]) -> str:
    """The list of runs, the budget beside the paper's, and the time that is left."""
    totals = {standing.total for standing in standings}
    if len(totals) != 1:
        raise ConfigError("runs with different budgets in one suite", "one --num-attempts for all")
    width = max(len(standing.planned.name) for standing in standings)
    lines = []
    for standing in standings:
        success = "" if standing.success is None else f"  success {standing.success:.2f}"
        done = f"{tqdm.format_sizeof(standing.attempts)}/{tqdm.format_sizeof(standing.total)}"
        lines.append(f"  {standing.planned.name:{width}}  {standing.word:5}  {done:>11}{success}")
    budget = totals.pop()
    rates = [standing.rate for standing in standings if standing.rate]
    rate, source = (statistics.median(rates), "measured") if rates else (RATE, "assumed until one has run")
    left = sum(standing.total - standing.attempts for standing in standings if not standing.is_done)
    lines += [
        f"{len(standings)} runs of {budget:,} attempts each (the paper: {BUDGET:,}), "
        f"{sum(standing.is_done for standing in standings)} done",
        f"time left about {time_text(left / rate)}, compiling and evaluating aside "
        f"({rate:.0f} attempts per second, {source}; {os.cpu_count()} cores)",
    ]
    return "\n".join(lines)
