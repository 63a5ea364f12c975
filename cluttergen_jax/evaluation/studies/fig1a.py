"""Figure 1a: success against the number of objects."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cluttergen_jax.evaluation.cells import LOOSE, Column, Row, asked, share, table_of
from cluttergen_jax.evaluation.plots import add_legend, colour, label_of, panels_of_pools, prepare, save
from cluttergen_jax.evaluation.studies.study import Result, Scale, Study, of_methods
from cluttergen_jax.evaluation.studies.table1 import CLUTTERGEN, first_seed
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.tables import Table

PAPER = {
    "ClutterGen": (0.99, 1.0, 1.0, 0.99, 0.98, 0.99, 0.96, 0.94, 0.94, 0.87),
    "RRS": (0.73, 0.49, 0.25, 0.22, 0.08, 0.03, 0.0, 0.0, 0.0, 0.0),
}
"""The paper's success with 1, 2, ... objects, read off its picture; RRS is its `random`."""
_STYLES = {"ClutterGen": "--", "RRS": ":"}


def trials(scale: Scale) -> tuple[Trial, ...]:
    """Of table 1: chance, the paper's method and ours."""
    return of_methods(first_seed(scale), "random", CLUTTERGEN, "policy")


def at_least(histogram: Sequence[int]) -> list[float]:
    """Shares of episodes in which at least 1, 2, ... objects were placed, from how many placed 0, 1, ...

    An episode of n objects is the beginning of one of more: the order is uniform, and no method is told how
    many are to come.
    """
    total = sum(histogram)
    return [sum(histogram[number:]) / total for number in range(1, len(histogram))]


def tables(result: Result) -> list[Table]:
    """A column for each number of objects."""
    made = [row["figures"] for row in result["records"] if "figures" in row]
    most = max((len(figures["placed_histogram"]) - 1 for figures in made), default=1)

    def column(number: int) -> Column:
        return Column(f"n = {number}", lambda row: share(_shares(row)[number - 1]))

    notes = (
        LOOSE,
        "an episode of n objects is the beginning of one of ten: orders are uniform, and no method is told "
        "how many are to come",
        "the dotted lines of the plot are strict but for the last check; the paper's values were read off "
        "its picture, which does not say of which group they are",
    )
    columns = (*asked("pool", "method"), *map(column, range(1, most + 1)))
    theirs = [
        {"pool": "the paper's", "method": name, "shares": shares}
        for name, shares in PAPER.items()
        if most <= len(shares)
    ]
    return [table_of(result["title"], columns, [*result["records"], *theirs], notes)]


def _shares(row: Row) -> Sequence[float]:
    """By the paper's count."""
    return row["shares"] if "shares" in row else at_least(row["figures"]["paper"]["placed_histogram"])


def plot(rows: list[Row], stem: Path) -> list[str]:
    """The paper's count, a panel for each pool."""
    figure, panels = panels_of_pools(rows)
    for axis, pool, of_pool in panels:
        for row in of_pool:
            method, figures = row["trial"]["method"], row["figures"]
            for source, style in ((figures["paper"], "-"), (figures, ":")):
                shares = at_least(source["placed_histogram"])
                label = label_of(method) if style == "-" else None
                x = range(1, len(shares) + 1)
                axis.plot(x, shares, style, color=colour(method), label=label, marker=".")
        for name, theirs in PAPER.items():
            label = f"{name}, the paper"
            x = range(1, len(theirs) + 1)
            axis.plot(x, theirs, _STYLES[name], color="#777777", linewidth=1.0, label=label)
        prepare(axis, pool, "objects", "success (dotted: strict)")
        axis.set_ylim(-0.03, 1.03)
    add_legend(figure)
    return save(figure, stem)


FIG1A = Study("fig1a", "Success against the number of objects (figure 1a)", 1000, trials, tables, plot=plot)
