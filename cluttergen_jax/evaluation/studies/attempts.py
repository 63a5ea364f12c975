"""Success against the attempts that an object is allowed."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

from cluttergen_jax.evaluation.cells import BOTH, LOOSE, STEPS, STRICT, Column, Row, asked, table_of
from cluttergen_jax.evaluation.plots import add_legend, panels_of_pools, prepare, save, success_line
from cluttergen_jax.evaluation.studies.study import Result, Scale, Study, grid
from cluttergen_jax.evaluation.studies.table1 import CLUTTERGEN
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.learning.training.suite import TABLE_ATTEMPTS as MOST_ATTEMPTS
from cluttergen_jax.tables import Table

PAPERS_SENTENCE = "more attempts help up to 5; two or fewer hurt"
"""What the paper says of the maximum number of attempts, in a figure without numbers."""


def trials(scale: Scale) -> tuple[Trial, ...]:
    """Chance, the paper's method and ours, for each number of attempts.

    `train --suite paper` makes a `policy` for each of them; the paper's was trained with five.
    """
    base, pools = scale.counted_twice(1000, 4), scale.chosen("dining")
    return grid(base, pool=pools, method=("random", CLUTTERGEN, "policy"), attempts=MOST_ATTEMPTS)


def tables(result: Result) -> list[Table]:
    """Success by both counts."""
    columns = (
        *asked("pool", "method", "attempts"),
        Column("trained with", _trained_with, is_asked=True),
        *BOTH,
        STEPS,
    )
    notes = (STRICT, LOOSE, f"the paper: {PAPERS_SENTENCE} (a figure without numbers)")
    return [table_of(result["title"], columns, _sorted(result["records"]), notes)]


def _trained_with(row: Row) -> str:
    return str((row.get("policy") or {}).get("max_attempts", "-"))


def plot(rows: list[Row], stem: Path) -> list[str]:
    """Success by the paper's count, with 95 % intervals, a panel for each pool."""
    figure, panels = panels_of_pools(rows)
    for axis, pool, of_pool in panels:
        for method, chosen in groupby(_sorted(of_pool), _method):
            made = list(chosen)
            x = [row["trial"]["attempts"] for row in made]
            success_line(axis, method, x, [row["figures"]["paper"] for row in made])
        prepare(axis, pool, "attempts per object", "success, paper's count")
    add_legend(figure)
    return save(figure, stem)


def _sorted(rows: list[Row]) -> list[Row]:
    """Pool by pool and method by method, both as they come first, by attempts: rows may have been kept."""
    trials = [row["trial"] for row in rows]
    pools, methods = (list(dict.fromkeys(each[name] for each in trials)) for name in ("pool", "method"))

    def place(row: Row) -> tuple[int, int, int]:
        trial = row["trial"]
        return pools.index(trial["pool"]), methods.index(trial["method"]), trial["attempts"]

    return sorted(rows, key=place)


def _method(row: Row) -> str:
    return str(row["trial"]["method"])


ATTEMPTS = Study("attempts", "Success against attempts allowed per object", 1000, trials, tables, plot=plot)
