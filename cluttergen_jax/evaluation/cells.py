"""Columns and cells of tables: proportions with intervals, figures, and success by both counts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from cluttergen_jax.evaluation.episodes import WITHIN
from cluttergen_jax.evaluation.trial import row_name
from cluttergen_jax.statistics import wilson
from cluttergen_jax.tables import Table

Row = dict[str, Any]


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


def asked(*names: str, **headings: str) -> tuple[Column, ...]:
    """Columns of what a row's trial asks; `headings` names some otherwise than their field."""

    def column(name: str, heading: str) -> Column:
        if name == "method":
            return Column(heading, name_of, is_asked=True)
        return Column(heading, lambda row: str(row.get("trial", row)[name]), is_asked=True)

    return (*(column(n, n) for n in names), *(column(n, heading) for n, heading in headings.items()))


def name_of(row: Row) -> str:
    """A row's method, and what sets its rules apart; rows of findings have it by name."""
    return row_name(row["trial"]) if "trial" in row else str(row["method"])


HEAD = (*asked("pool", support="table"), *asked("method"))
"""The first columns of tables about finished scenes."""


def table_of(title: str, columns: Sequence[Column], rows: Iterable[Row], notes: Iterable[str] = ()) -> Table:
    """A line for each row; where figures are missing it has dashes, and a note below says why."""
    rows = list(rows)
    why = dict.fromkeys(missing(row) for row in rows if "missing" in row)
    return Table(
        title,
        tuple(column.heading for column in columns),
        tuple(_line(columns, row) for row in rows),
        (*notes, *why),
    )


def _line(columns: Sequence[Column], row: Row) -> tuple[str, ...]:
    is_made = "missing" not in row
    return tuple(column.cell(row) if is_made or column.is_asked else "-" for column in columns)


def share(value: float | None) -> str:
    """A proportion with three digits."""
    return "-" if value is None else f"{value:.3f}"


def interval(value: float, low: float, high: float) -> str:
    """A proportion with its 95 % interval."""
    return f"{value:.3f} [{low:.3f}, {high:.3f}]"


def share_of(row: Row, name: str = "success") -> str:
    """A row's proportion with its own interval."""
    return interval(row[name], row["low95"], row["high95"])


def number(value: float | None, digits: int = 1, scale: float = 1.0) -> str:
    """A figure times `scale`; a dash where there is none."""
    return "-" if value is None else f"{value * scale:,.{digits}f}"


def mean_and_spread(spread: dict) -> str:
    """Mean and standard deviation of `proportion.spread_of`."""
    if spread["mean"] is None:
        return "-"
    return f"{spread['mean']:.1f} ± {spread['std']:.1f}"


SPEED = Column(
    "valid scenes per CPU-second", lambda row: number(row["figures"]["valid_scenes_per_cpu_second"])
)


def per_valid_scene(row: Row, name: str, digits: int) -> str:
    """A row's attempts or simulated steps for each scene that succeeded; a dash where none did."""
    figures = row["figures"]
    return number(figures[f"{name}_per_valid_scene"], digits) if figures["num_success"] else "-"


def _within(place: int, times: float) -> Column:
    def cell(row: Row) -> str:
        # Results of older versions did not count them.
        known = row["figures"].get("within")
        return share_of(known[place], "share") if known else "-"

    return Column(f"within {times:g} n", cell)


EFFORT = (
    *(_within(*each) for each in enumerate(WITHIN)),
    Column("attempts per valid scene", lambda row: per_valid_scene(row, "attempts", 1)),
    Column("simulated steps per valid scene", lambda row: per_valid_scene(row, "simulated_steps", 0)),
)
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
    asked = row.get("trial", row)
    named = [str(asked[name]) for name in ("pool", "support", "method") if name in asked]
    return f"{', '.join(named)}: {row['missing']}" if named else row["missing"]


def is_failed(row: Row) -> bool:
    """Whether figures that were asked for could not be made.

    Too few scenes that succeed are a finding, and what other training seeds lack is left out.
    """
    return "hint" in row and not row.get("trial", {}).get("training_seed")


STRICT = "strict: every slot stable without disturbing anything, and the finished scene stands"
LOOSE = "paper's count: only the current object is judged, the others are put back, no last check"


def figures_by(row: Row, is_loose: bool) -> dict[str, Any]:
    """A row's figures by one of the two counts."""
    return row["figures"]["paper"] if is_loose else row["figures"]


def pooled(rows: Iterable[Row], is_loose: bool) -> str:
    """Success over all trials of several rows, with its interval."""
    figures = [figures_by(row, is_loose) for row in rows]
    successes, trials = (sum(each[name] for each in figures) for name in ("num_success", "trials"))
    return interval(successes / trials, *wilson(successes, trials))


def stable_steps(rows: Iterable[Row]) -> str:
    """Stable steps by the paper's count; of several seeds, their plain mean."""
    spreads = [row["figures"]["paper"]["stable_steps"] for row in rows]
    known = [each for each in spreads if each["mean"] is not None]
    if not known:
        return "-"
    mean, std = (sum(each[name] for each in known) / len(known) for name in ("mean", "std"))
    return mean_and_spread({"mean": mean, "std": std})


BOTH = (
    Column("success, strict [95 %]", lambda row: pooled([row], is_loose=False)),
    Column("success, paper's count [95 %]", lambda row: pooled([row], is_loose=True)),
)
STEPS = Column("stable steps", lambda row: stable_steps([row]))
