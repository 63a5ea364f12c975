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

PAPER = {
    "dining": (88, 91, 84, 60, 50),
    "study": (113, 107, 100, 64, 44),
    "office": (118, 118, 92, 66, 51),
    "kitchen": (106, 85, 49, 48, 60),
    "household": (136, 102, 120, 98, 34),
}
"""The paper's mean steps of attempts 1 to 5 by the pool that stands for its group, read off its picture."""
_FEWEST = 5
"""Attempts behind a point of the plot."""


def tables(result: Result) -> list[Table]:
    """Mean steps, a column for each attempt."""

    def column(attempt: int) -> Column:
        return Column(f"attempt {attempt}", lambda row: _cell(row, attempt))

    most = max((row["trial"]["attempts"] for row in result["records"]), default=0)
    columns = (
        *asked("pool", "method"),
        Column("placements", lambda row: "-" if "steps" in row else str(_count(row))),
        *map(column, range(1, most + 1)),
    )
    notes = (
        LOOSE,
        "objects that stood in the end and took at least three attempts; mean ± standard deviation",
        "the paper's values were read off its picture; it takes their fall for a sign that its policy learns "
        "from failures within an episode",
        *_selection(result["records"]),
    )
    pools = dict.fromkeys(row["trial"]["pool"] for row in result["records"])
    rows: list[Row] = []
    for pool in pools:
        rows += [row for row in result["records"] if row["trial"]["pool"] == pool]
        if pool in PAPER:
            rows.append({"pool": pool, "method": "ClutterGen, the paper", "steps": PAPER[pool]})
    return [table_of(result["title"], columns, rows, notes)]


def _selection(rows: list[Row]) -> list[str]:
    """What the row without a memory says of that fall, where its own steps fall."""
    falls = [
        f"{row['trial']['pool']} {steps[0]:.0f} to {steps[-1]:.0f}"
        for row in rows
        if row["trial"]["method"] == "random" and "figures" in row
        if len(steps := [each["mean"] for each in _steps(row).values() if each["count"] >= _FEWEST]) > 1
        if steps[-1] < steps[0]
    ]
    if not falls:
        return []
    return [
        f"`random`, which remembers nothing, falls in the same way ({', '.join(falls)}): what stands in the "
        "end had a last attempt that went well, so the fall is selection, and no sign of learning"
    ]


def _count(row: Row) -> int:
    return _steps(row)[1]["count"] if 1 in _steps(row) else 0


def _cell(row: Row, attempt: int) -> str:
    if "steps" in row:
        return str(row["steps"][attempt - 1]) if attempt <= len(row["steps"]) else "-"
    return mean_and_spread(_steps(row).get(attempt, {"mean": None}))


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
        if pool in PAPER:
            theirs = PAPER[pool]
            axis.plot(
                range(1, len(theirs) + 1),
                theirs,
                "--",
                color="#777777",
                linewidth=1.0,
                label="ClutterGen, the paper",
            )
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
