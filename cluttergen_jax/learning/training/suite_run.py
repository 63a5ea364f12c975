"""Training of all policies of a suite, one after another, each from where it stopped."""

from __future__ import annotations

import dataclasses
import gc
import os
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path

import jax
from tqdm import tqdm

from cluttergen_jax.assets import find_pool
from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.learning.training.presets import make_settings, paper
from cluttergen_jax.learning.training.pretrain import is_pretrained, pretrain_for
from cluttergen_jax.learning.training.run_folder import RunFolder
from cluttergen_jax.learning.training.run_logger import read_rows
from cluttergen_jax.learning.training.suite import POOLS, SEEDS, PlannedRun, plan
from cluttergen_jax.learning.training.train import TrainConfig, recipe_of, run_training
from cluttergen_jax.progress import time_text
from cluttergen_jax.schema import Record

RATE = 450.0
"""Attempts per second until a run of the suite has told its own: preset `cpu`, dining, beside another run."""


@dataclasses.dataclass(frozen=True)
class RunStatus:
    """How far one run of a suite has come.

    Attributes:
      planned: the run; config: what it is given.
      attempts: made so far; total: of the whole run.
      rate: attempts per second, lately; None before the first.
      is_done: trained and, if that was asked for, evaluated.
      success: of its evaluation, or of training; None before.
    """

    planned: PlannedRun
    config: TrainConfig
    attempts: int
    total: int
    rate: float | None
    is_done: bool
    success: float | None

    @property
    def word(self) -> str:
        """For the list."""
        return "done" if self.is_done else "begun" if self.attempts else "to do"


@dataclasses.dataclass(frozen=True)
class SuiteReport:
    """How a suite went.

    Attributes:
      folder: of its runs.
      standings: how far each run had come at the beginning.
      failed: by a run's name, why it failed.
    """

    folder: Path
    standings: tuple[RunStatus, ...]
    failed: dict[str, str]


def run_suite(
    suite: str,
    base: TrainConfig,
    root: Path,
    pools: Sequence[str] = POOLS,
    seeds: Sequence[int] = SEEDS,
    suite_only: str | None = None,
    suite_list: bool = False,
    show: Callable[[str], None] = print,
) -> SuiteReport:
    """The runs of a suite, one after another; see `cluttergen_jax.training.train_suite`.

    Args:
      base: what each run is given but for its own pool, method, seed and so on.
      root: the folder of all runs.
    """
    for pool in pools:
        find_pool(pool)
    planned = plan(suite, pools, seeds, suite_only)
    base = _with_encoder(base, planned, root, suite_list, show)
    standings = [_standing(config_of(base, run, root), run) for run in planned]
    show(_overview(standings))
    failed: dict[str, str] = {}
    for number, standing in enumerate(standings, 1):
        name = standing.planned.name
        if standing.is_done or suite_list:
            continue
        show(f"\n{number}/{len(standings)}  {name}")
        try:
            run_training(standing.config, show=show)
        except ClutterGenError as error:
            failed[name] = str(error)
        # The next run has another world: programs and engines of this one are never used again.
        jax.clear_caches()
        gc.collect()
    if not suite_list:
        show(f"\n{len(standings) - len(failed)} of {len(standings)} runs done, in {root}")
    return SuiteReport(root, tuple(standings), failed)


def config_of(base: TrainConfig, run: PlannedRun, root: Path) -> TrainConfig:
    """What one run of a suite is given; weights of a point encoder are for those that see point clouds."""
    preset = run.preset(base.preset)
    sees_clouds = make_settings(preset, run.variant).network.reads_clouds
    problem = base.problem
    rules = dataclasses.replace(problem.placement, max_attempts=run.attempts)
    return dataclasses.replace(
        base,
        preset=preset,
        encoder_weights=base.encoder_weights if sees_clouds or base.encoder else None,
        problem=dataclasses.replace(problem, pool=run.pool, placement=rules),
        variant=run.variant,
        seed=run.seed,
        out=str(root / run.name),
    )


def _with_encoder(
    base: TrainConfig,
    planned: Sequence[PlannedRun],
    root: Path,
    suite_list: bool,
    show: Callable[[str], None],
) -> TrainConfig:
    """With the pretrained encoder that the paper's runs keep frozen: made here unless another is given."""
    networks = [make_settings(run.preset(base.preset), run.variant).network for run in planned]
    network = next((network for network in networks if network.encoder_frozen), None)
    if network is None or base.encoder or base.encoder_weights:
        return base
    folder = root / f"encoder-{network.scene_encoder}"
    if not suite_list:
        pretrain_for(network, folder, show)
    return dataclasses.replace(base, encoder_weights=str(folder))


def _standing(config: TrainConfig, run: PlannedRun) -> RunStatus:
    """Reads how far a run has come; ConfigError where its folder holds a run with other settings."""
    last: Record = {}
    record: Record = {}
    if config.encoder_weights is None or is_pretrained(Path(config.encoder_weights)):
        settings = config.settings()
        folder = RunFolder(config.folder, recipe_of(config, settings))
        last = folder.record("last")
        record = folder.record("policy")
    else:
        # No run has begun without its encoder.
        kind = make_settings(config.preset, run.variant).network.scene_encoder
        settings = dataclasses.replace(config, encoder_weights=None, encoder=kind).settings()
    batch = settings.ppo.batch_size
    total = settings.ppo.num_updates * settings.ppo.batch_size
    attempts = int(last.get("num_updates", 0)) * batch
    asked = config.eval_episodes
    evaluation = record.get("evaluation")
    is_evaluated = not asked or (
        evaluation is not None and evaluation.get("episodes", asked) >= asked
    )
    rows = read_rows(config.folder / "progress.csv")
    rate = statistics.median(row["attempts_per_second"] for row in rows[-50:]) if rows else None
    return RunStatus(
        planned=run,
        config=config,
        attempts=attempts,
        total=total,
        rate=rate,
        is_done=attempts >= total and bool(record) and is_evaluated,
        success=record.get("evaluation", record).get("success"),
    )


def _overview(standings: list[RunStatus]) -> str:
    """The list of runs, the budget beside the paper's, and the time that is left."""
    width = max(len(standing.planned.name) for standing in standings)
    lines = []
    for standing in standings:
        success = "" if standing.success is None else f"  success {standing.success:.2f}"
        done = f"{tqdm.format_sizeof(standing.attempts)}/{tqdm.format_sizeof(standing.total)}"
        lines.append(f"  {standing.planned.name:{width}}  {standing.word:5}  {done:>11}{success}")
    budgets = sorted({standing.total for standing in standings})
    rates = [standing.rate for standing in standings if standing.rate]
    rate, source = (
        (statistics.median(rates), "measured") if rates else (RATE, "assumed until one has run")
    )
    left = sum(standing.total - standing.attempts for standing in standings if not standing.is_done)
    lines += [
        f"{len(standings)} runs of {' and '.join(f'{budget:,}' for budget in budgets)} attempts (the paper: "
        f"{paper().ppo.num_attempts:,}), "
        f"{sum(standing.is_done for standing in standings)} done",
        f"time left about {time_text(left / rate)}, compiling and evaluating aside "
        f"({rate:.0f} attempts per second, {source}; {os.cpu_count()} cores)",
    ]
    return "\n".join(lines)
