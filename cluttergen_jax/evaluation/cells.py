"""Columns and cells of tables: proportions with intervals, and figures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cluttergen_jax.evaluation.records import Row
from cluttergen_jax.evaluation.trial import trial_of
from cluttergen_jax.tables import Table


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


def request_of(row: Row) -> Mapping[str, Any]:
    """What a row asked: rows of findings have it beside what was found."""
    return row.get("trial", row)


def name_of(row: Row) -> str:
    """A row's method, and what sets its rules apart; rows of findings have it by name."""
    return trial_of(row).row_name if "trial" in row else row["method"]


def made_rows(rows: Iterable[Row]) -> list[Row]:
    """Those that have figures."""
    return [row for row in rows if "figures" in row]


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


def figure_column(heading: str, name: str, digits: int = 1) -> Column:
    """A column of one of a row's `figures`."""
    return Column(heading, lambda row: number(values_of(row["figures"]).get(name), digits))


def values_of(row: Mapping[str, Any]) -> Mapping[str, Any]:
    """A row or its figures, to be read by names that are not written out."""
    return row


SUCCESS = Column("success [95 %]", lambda row: share_of(row["figures"]))
SPEED = figure_column("valid scenes per CPU-second", "valid_scenes_per_cpu_second")


def missing(row: Row) -> str:
    """Why there is no figure, and what to do about it.

    What a trial lacks names itself; how few of its scenes succeed is said of which.
    """
    if hint := row.get("hint"):
        return f"{row['missing']}; try: {hint}"
    request = request_of(row)
    named = [str(request[name]) for name in ("pool", "support", "method") if name in request]
    return f"{', '.join(named)}: {row['missing']}" if named else row["missing"]
