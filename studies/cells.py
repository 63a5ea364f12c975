"""Columns and cells that studies share: effort, success by both counts, what failed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

from cluttergen_jax.evaluation.comparison import (
    Column,
    figure_column,
    interval,
    number,
    request_columns,
    share_of,
    values_of,
)
from cluttergen_jax.evaluation.records import Figures, Row
from cluttergen_jax.evaluation.runner import WITHIN
from cluttergen_jax.statistics import wilson
from studies.results import made_rows

Value = TypeVar("Value")


def columns_of(
    values: Iterable[Value], heading: Callable[[Value], str], cell: Callable[[Row, Value], str]
) -> tuple[Column, ...]:
    """A column for each of some values."""

    def column(value: Value) -> Column:
        return Column(heading(value), lambda row: cell(row, value))

    return tuple(map(column, values))


HEAD = request_columns("pool", support="table", method="method")
"""The first columns of tables about finished scenes."""


def number_column(heading: str, name: str, digits: int = 1, scale: float = 1.0) -> Column:
    """A column of a figure that a row of findings has by name; a dash where it has none."""
    return Column(heading, lambda row: number(values_of(row).get(name), digits, scale))


def mean_and_spread(spread: Mapping[str, Any]) -> str:
    """Mean and standard deviation of `proportion.spread_of`."""
    return "-" if spread["mean"] is None else f"{spread['mean']:.1f} ± {spread['std']:.1f}"


FILL = figure_column("fill", "fill", 2)
SCENES = Column("scenes", lambda row: str(row["scenes"]))


def per_valid_scene(row: Row, name: str, digits: int) -> str:
    """A row's attempts or simulated steps for each scene that succeeded; a dash where none did."""
    figures = row["figures"]
    return (
        number(values_of(figures)[f"{name}_per_valid_scene"], digits)
        if figures["num_success"]
        else "-"
    )


def _within(row: Row, place: int) -> str:
    # Results of older versions did not count them.
    known = row["figures"].get("within")
    return share_of(known[place], "share") if known else "-"


COST = (
    Column("attempts per valid scene", lambda row: per_valid_scene(row, "attempts", 1)),
    Column(
        "simulated steps per valid scene", lambda row: per_valid_scene(row, "simulated_steps", 0)
    ),
)
EFFORT = (*columns_of(range(len(WITHIN)), lambda n: f"within {WITHIN[n]:g} n", _within), *COST)
"""Success at some cost, and the cost of success."""
EFFORT_NOTES = (
    "within: finished successfully with at most so many attempts in all, n objects a scene",
    "per valid scene: all attempts and steps of the row, rejected scenes included; speeds leave compilation "
    "out",
)


def is_failed(row: Row) -> bool:
    """Whether figures that were asked for could not be made.

    Too few scenes that succeed are a finding, and what other training seeds lack is left out.
    """
    return "hint" in row and not row.get("trial", {}).get("training_seed")


STRICT = "strict: every slot stable without disturbing anything, and the finished scene stands"
LOOSE = "paper's count: only the current object is judged, the others are put back, no last check"


def figures_by(row: Row, is_loose: bool) -> Figures:
    """A row's figures by one of the two counts."""
    return row["figures"]["paper"] if is_loose else row["figures"]


def pooled_success(rows: Iterable[Row], is_loose: bool = False) -> str:
    """Success over all trials of several rows, with its interval; a dash where none is made."""
    figures = [figures_by(row, is_loose) for row in made_rows(rows)]
    if not figures:
        return "-"
    successes = sum(each["num_success"] for each in figures)
    trials = sum(each["trials"] for each in figures)
    return interval(successes / trials, *wilson(successes, trials))


def stable_steps(rows: Iterable[Row]) -> str:
    """Stable steps by the paper's count; of several seeds, their plain mean."""
    spreads = [row["figures"]["paper"]["stable_steps"] for row in rows]
    known = [each for each in spreads if each["mean"] is not None]
    if not known:
        return "-"
    return mean_and_spread(
        {name: sum(each[name] for each in known) / len(known) for name in ("mean", "std")}
    )


BOTH = (
    Column("success, strict [95 %]", lambda row: pooled_success([row])),
    Column("success, paper's count [95 %]", lambda row: pooled_success([row], is_loose=True)),
)
STEPS = Column("stable steps", lambda row: stable_steps([row]))
