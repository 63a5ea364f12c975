"""Success against attempts of the training runs behind table 1."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cluttergen_jax.evaluation.cells import Column, share, table_of
from cluttergen_jax.evaluation.plots import add_legend, colour, grid, label_of, prepare, save
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.studies import table1
from cluttergen_jax.evaluation.studies.findings import Findings
from cluttergen_jax.evaluation.studies.study import Result, Scale, Study
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.learning.training.metrics_log import read_rows
from cluttergen_jax.placement.baselines import BASELINES
from cluttergen_jax.tables import Table

PAPER_ATTEMPTS, PAPER_SUCCESS = 2_300_000, 0.85
"""In the paper every group is above this success after so many attempts."""


def trials(scale: Scale) -> tuple[Trial, ...]:
    """The learned ones of table 1."""
    return tuple(trial for trial in table1.trials(scale) if trial.method not in BASELINES)


def measure(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """Every run that left its progress; dots are evaluated by the last check."""
    folders = {trial: runner.checkpoints.run_folder(trial) for trial in trials}
    runs = {trial: folder for trial, folder in folders.items() if folder is not None}
    names = [f"{each.pool_name} {each.method} {each.training_seed}" for each in trials if each not in runs]
    notes = (
        [f"without a training run (--checkpoints names their folder): {', '.join(names)}"] if names else []
    )
    if not runs:
        return Findings(notes=notes)
    pools = list(dict.fromkeys(trial.pool_name for trial in runs))
    figure, axes = grid(len(pools), 3, 3.0, 2.4)
    rows = [_curve(axes[pools.index(trial.pool_name)], trial, folder) for trial, folder in runs.items()]
    for axis, pool in zip(axes, pools, strict=True):
        prepare(axis, pool, "attempts (thousands)", "success while training")
        axis.set_ylim(0, 1.03)
    add_legend(figure)
    return Findings(rows, save(figure, stem), notes)


def _curve(axis: Any, trial: Trial, folder: Path) -> dict[str, Any]:
    """Draws one run; where it ended."""
    progress, checked = (read_rows(folder / name) for name in ("progress.csv", "evaluations.csv"))
    label = label_of(trial.method) if trial.training_seed == 0 else None
    for rows, style in ((progress, {"linewidth": 1.0, "label": label}), (checked, {"marker": "o", "ls": ""})):
        x, y = [row["attempts"] / 1000 for row in rows], [row["success"] for row in rows]
        axis.plot(x, y, color=colour(trial.method), markersize=3, **style)
    return {
        "pool": trial.pool_name,
        "method": trial.method,
        "seed": trial.training_seed,
        "attempts": int(progress[-1]["attempts"]) if progress else 0,
        "success": progress[-1]["success"] if progress else None,
        "checked": checked[-1]["success"] if checked else None,
    }


def _written(runner: Runner, trial: Trial) -> int | None:
    """When the trial's run last wrote its progress, in nanoseconds."""
    run = runner.checkpoints.run_folder(trial)
    return None if run is None else (run / "progress.csv").stat().st_mtime_ns


def tables(result: Result) -> list[Table]:
    """Where training ended."""
    columns = (
        Column("pool", lambda row: row["pool"]),
        Column("method", lambda row: row["method"]),
        Column("seed", lambda row: str(row["seed"])),
        Column("training attempts", lambda row: f"{row['attempts']:,}"),
        Column("success at the end, while training", lambda row: share(row["success"])),
        Column("by the last check", lambda row: share(row["checked"])),
    )
    note = f"the paper: above {PAPER_SUCCESS} after {PAPER_ATTEMPTS:,} attempts in every group"
    return [table_of(result["title"], columns, result["measure"]["rows"], (note,))]


LEARNING_CURVES = Study(
    "learning_curves", "Success while training", 1000, trials, tables, measure, depends_on=_written
)
