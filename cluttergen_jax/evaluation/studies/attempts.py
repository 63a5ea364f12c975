"""Success against the attempts that an object is allowed."""

from __future__ import annotations

from pathlib import Path

from cluttergen_jax.evaluation.cells import BOTH, LOOSE, STEPS, STRICT, Column, Row, asked, table_of
from cluttergen_jax.evaluation.plots import add_legend, new_figure, prepare, save, success_line
from cluttergen_jax.evaluation.studies.study import Result, Scale, Study, grid
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.learning.training.suite import TABLE_ATTEMPTS as MOST_ATTEMPTS
from cluttergen_jax.tables import Table

PAPERS_SENTENCE = "more attempts help up to 5; two or fewer hurt"
"""What the paper says of the maximum number of attempts, in a figure without numbers."""


def trials(scale: Scale) -> tuple[Trial, ...]:
    """The policy and chance, for each number of attempts; `train --suite paper` makes the policies."""
    base, pools = scale.counted_twice(1000, 4), scale.chosen("dining")
    return grid(base, pool=pools, method=("random", "policy"), attempts=MOST_ATTEMPTS)


def tables(result: Result) -> list[Table]:
    """Success by both counts."""
    columns = (
        *asked("pool", "method", "attempts"),
        Column("trained with", _trained_with, is_asked=True),
        *BOTH,
        STEPS,
    )
    notes = (STRICT, LOOSE, f"the paper: {PAPERS_SENTENCE} (a figure without numbers)")
    return [table_of(result["title"], columns, result["records"], notes)]


def _trained_with(row: Row) -> str:
    return str((row.get("policy") or {}).get("max_attempts", "-"))


def plot(rows: list[Row], stem: Path) -> list[str]:
    """Success by the paper's count, with 95 % intervals."""
    figure = new_figure(5.0, 2.8)
    axis = figure.subplots()
    for method in dict.fromkeys(row["trial"]["method"] for row in rows):
        chosen = [row for row in rows if row["trial"]["method"] == method]
        x = [row["trial"]["attempts"] for row in chosen]
        success_line(axis, method, x, [row["figures"]["paper"] for row in chosen])
    prepare(axis, "", "attempts per object", "success, paper's count")
    add_legend(figure)
    return save(figure, stem)


ATTEMPTS = Study("attempts", "Success against attempts allowed per object", 1000, trials, tables, plot=plot)
