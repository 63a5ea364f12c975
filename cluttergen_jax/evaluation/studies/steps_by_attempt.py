"""Steps of the first attempt, the second and so on, at objects that took at least three."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cluttergen_jax.evaluation.cells import LOOSE, Column, Row, asked, mean_and_spread, table_of
from cluttergen_jax.evaluation.plots import add_legend, colour, label_of, panels_of_pools, prepare, save
from cluttergen_jax.evaluation.studies.study import Result, Study
from cluttergen_jax.evaluation.studies.table1 import first_seed
from cluttergen_jax.learning.training.suite import DEFAULT_ATTEMPTS
from cluttergen_jax.tables import Table

_FEWEST = 5
"""Attempts behind a point of the plot."""


def tables(result: Result) -> list[Table]:
    """Mean steps, a column for each attempt."""

    def column(attempt: int) -> Column:
        nothing = {"mean": None}
        return Column(f"attempt {attempt}", lambda row: mean_and_spread(_steps(row).get(attempt, nothing)))

    most = max((row["trial"]["attempts"] for row in result["records"]), default=0)
    columns = (
        *asked("pool", "method"),
        Column("placements", lambda row: str(_steps(row).get(1, {"count": 0})["count"])),
        *map(column, range(1, most + 1)),
    )
    notes = (
        LOOSE,
        "objects that stood in the end and took at least three attempts; mean ± standard deviation",
    )
    return [table_of(result["title"], columns, result["records"], notes)]


def _steps(row: Row) -> dict[int, Row]:
    """The spreads of steps by attempt, the paper's count."""
    return {each["attempt"]: each for each in row["figures"]["paper"]["steps_by_attempt"]}


def plot(rows: list[Row], stem: Path) -> list[str]:
    """Mean steps of each attempt with their standard error, a panel for each pool."""
    figure, panels = panels_of_pools(rows)
    for axis, pool, of_pool in panels:
        for row in of_pool:
            steps = [each for each in _steps(row).values() if each["count"] >= _FEWEST]
            if steps:
                method = row["trial"]["method"]
                error = [each["std"] / np.sqrt(each["count"]) for each in steps]
                x, y = [each["attempt"] for each in steps], [each["mean"] for each in steps]
                style = {"color": colour(method), "label": label_of(method)}
                axis.errorbar(x, y, error, marker=".", linewidth=1.0, **style)
        prepare(axis, pool, "attempt", "steps")
        axis.set_xticks(range(1, DEFAULT_ATTEMPTS + 1))
        axis.set_ylim(0, 250)
    add_legend(figure)
    return save(figure, stem)


STEPS_BY_ATTEMPT = Study(
    "steps_by_attempt",
    "Steps of each attempt at objects that took at least three",
    1000,
    first_seed,
    tables,
    plot=plot,
)
