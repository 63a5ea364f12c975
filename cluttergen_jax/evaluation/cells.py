"""Columns and cells of tables: proportions with intervals, figures, and success by both counts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from cluttergen_jax.evaluation.episodes import WITHIN
from cluttergen_jax.evaluation.records import Figures, Row
from cluttergen_jax.evaluation.trial import trial_of
from cluttergen_jax.statistics import wilson
from cluttergen_jax.tables import Table

Value = TypeVar("Value")


@dataclass(frozen=True)
class Column:
    """A heading, and what a row shows below it.

    Attributes:
      cell: the row's text.
      is_asked: known before the row is made, and so shown where its figures are missing, too.
    """

    heading: str
    cell: Callable[[Row], str]
    is_asked: bool = False


def request_columns(*names: str, **headings: str) -> tuple[Column, ...]:
    """Columns of what a row's trial asks; `headings` names some otherwise than their field."""

    def column(name: str, heading: str) -> Column:
        cell = name_of if name == "method" else lambda row: str(request_of(row)[name])
        return Column(heading, cell, is_asked=True)

    return (
        *(column(n, n) for n in names),
        *(column(n, heading) for n, heading in headings.items()),
    )


def columns_of(
    values: Iterable[Value], heading: Callable[[Value], str], cell: Callable[[Row, Value], str]
) -> tuple[Column, ...]:
    """A column for each of some values."""

    def column(value: Value) -> Column:
        return Column(heading(value), lambda row: cell(row, value))

    return tuple(map(column, values))


def request_of(row: Row) -> Mapping[str, Any]:
    """What a row asked: rows of findings have it beside what was found."""
    return row.get("trial", row)


def name_of(row: Row) -> str:
    """A row's method, and what sets its rules apart; rows of findings have it by name."""
    return trial_of(row).row_name if "trial" in row else row["method"]


def made_rows(rows: Iterable[Row]) -> list[Row]:
    """Those that have figures."""
    return [row for row in rows if "figures" in row]


HEAD = request_columns("pool", support="table", method="method")
"""The first columns of tables about finished scenes."""


def table_of(
    title: str, columns: Sequence[Column], rows: Iterable[Row], notes: Iterable[str] = ()
) -> Table:
    """A line for each row; where figures are missing it has dashes, and a note below says why."""
    rows = list(rows)
    lines = (
        tuple(each.cell(row) if "missing" not in row or each.is_asked else "-" for each in columns)
        for row in rows
    )
    why = dict.fromkeys(missing(row) for row in rows if "missing" in row)
    return Table(title, tuple(each.heading for each in columns), tuple(lines), (*notes, *why))


def share(value: float | None) -> str:
    """A proportion with three digits."""
    return "-" if value is None else f"{value:.3f}"


def interval(value: float, low: float, high: float) -> str:
    """A proportion with its 95 % interval."""
    return f"{value:.3f} [{low:.3f}, {high:.3f}]"


def share_of(row: Mapping[str, Any], name: str = "success") -> str:
    """A row's proportion with its own interval."""
    return interval(row[name], row["low95"], row["high95"])


def number(value: float | None, digits: int = 1, scale: float = 1.0) -> str:
    """A figure times `scale`; a dash where there is none."""
    return "-" if value is None else f"{value * scale:,.{digits}f}"


def number_column(heading: str, name: str, digits: int = 1, scale: float = 1.0) -> Column:
    """A column of a figure that a row of findings has by name; a dash where it has none."""
    return Column(heading, lambda row: number(values_of(row).get(name), digits, scale))


def figure_column(heading: str, name: str, digits: int = 1) -> Column:
    """A column of one of a row's `figures`."""
    return Column(heading, lambda row: number(values_of(row["figures"]).get(name), digits))


def values_of(row: Mapping[str, Any]) -> Mapping[str, Any]:
    """A row or its figures, to be read by names that are not written out."""
    return row


def mean_and_spread(spread: Mapping[str, Any]) -> str:
    """Mean and standard deviation of `proportion.spread_of`."""
    return "-" if spread["mean"] is None else f"{spread['mean']:.1f} ± {spread['std']:.1f}"


SUCCESS = Column("success [95 %]", lambda row: share_of(row["figures"]))
SPEED = figure_column("valid scenes per CPU-second", "valid_scenes_per_cpu_second")
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


def missing(row: Row) -> str:
    """Why there is no figure, and what to do about it.

    What a trial lacks names itself; how few of its scenes succeed is said of which.
    """
    if hint := row.get("hint"):
        return f"{row['missing']}; try: {hint}"
    request = request_of(row)
    named = [str(request[name]) for name in ("pool", "support", "method") if name in request]
    return f"{', '.join(named)}: {row['missing']}" if named else row["missing"]


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
