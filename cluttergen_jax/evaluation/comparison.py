"""Methods side by side: columns, cells and plots of rows, and what `cluttergen_jax.evaluate` returns."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.evaluation.records import Row
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.store import json_bytes
from cluttergen_jax.evaluation.trial import Trial, trial_of
from cluttergen_jax.files import write_atomically
from cluttergen_jax.plots import colour, grid_of_panels, prepare, save
from cluttergen_jax.tables import Table

_FIGURES = (
    "success",
    "low95",
    "high95",
    "filled",
    "placed",
    "usual_pairs",
    "side_contacts",
    "attempts_per_valid_scene",
    "simulated_steps_per_valid_scene",
    "valid_scenes_per_cpu_second",
    "valid_scenes_per_second",
    "seconds",
    "compile_seconds",
)


@dataclass(frozen=True)
class Comparison:
    """What became of methods on pools and supports.

    Attributes:
      rows: one flat dict each: `pool`, `support`, `objects`, `method`, `row` (the method, and what sets its
        rules apart from its own), `trials`, `asked` (what else says what is placed where, if anything does),
        figures such as `success`, `low95` and `placed`, and `missing`,
        which says why there are none.
      table: the same for people, with what is missing below it; speeds leave compilation out.
    """

    rows: list[dict[str, Any]]
    table: Table

    @property
    def num_missing(self) -> int:
        """Rows that could not be made."""
        return sum(row["missing"] is not None for row in self.rows)

    def write(self, folder: Path) -> None:
        """Writes table.md, table.csv (all digits), table.tex, results.json and bars.png."""
        text = io.StringIO()
        writer = csv.DictWriter(text, fieldnames=list(self.rows[0]))
        writer.writeheader()
        writer.writerows(self.rows)
        write_atomically(folder / "table.md", (self.table.markdown() + "\n").encode())
        write_atomically(folder / "table.csv", text.getvalue().encode())
        write_atomically(folder / "table.tex", self.table.latex().encode())
        write_atomically(folder / "results.json", json_bytes(self.rows))
        _draw(self.rows, folder / "bars")


def compare(runner: Runner, trials: Sequence[Trial], folder: Path | None) -> Comparison:
    """The rows of trials and their table, written into the folder if there is one.

    Raises:
      ClutterGenError: none of the rows can be made; why the first cannot.
    """
    rows = [runner.row(trial) for trial in trials]
    if all("figures" not in row for row in rows):
        raise runner.errors[0]
    found = Comparison([_flat(row) for row in rows], _table(rows))
    if folder is not None:
        found.write(folder)
    return found


def _flat(row: Row) -> dict[str, Any]:
    """A row with its figures beside what its trial asks."""
    trial = row["trial"]
    figures = row.get("figures", {})
    asked = trial_of(row).asked
    head = {
        "pool": trial["pool"],
        "support": trial["support"],
        "objects": trial["num_objects"],
        "method": trial["method"],
        "row": name_of(row),
        "trials": trial["trials"],
        **({"asked": "; ".join(asked)} if asked else {}),
    }
    return head | {name: figures.get(name) for name in _FIGURES} | {"missing": row.get("missing")}


def _table(rows: list[Row]) -> Table:
    columns = (
        *request_columns("pool", "support", num_objects="objects", method="method"),
        SUCCESS,
        Column("filled", lambda row: share(row["figures"]["filled"])),
        figure_column("placed", "placed", 2),
        figure_column("usual pairs", "usual_pairs", 3),
        figure_column("side contacts", "side_contacts", 2),
        Column("attempts per valid scene", _effort),
        SPEED,
    )
    first = trial_of(rows[0])
    return table_of("; ".join([f"{first.trials} trials a row", *first.asked]), columns, rows)


def _draw(rows: Sequence[dict[str, Any]], stem: Path) -> None:
    """A panel for each pool on each support: success of each row with its interval."""
    made = [row for row in rows if row["missing"] is None]
    places = list(dict.fromkeys((row["pool"], row["support"]) for row in made))
    figure, axes = grid_of_panels(len(places), 3, 3.4, 2.4)
    for axis, place in zip(axes, places, strict=True):
        bars = [row for row in made if (row["pool"], row["support"]) == place]
        y = np.array([row["success"] for row in bars])
        ends = np.array([[row["low95"], row["high95"]] for row in bars]).T
        colours = [colour(row["method"]) for row in bars]
        axis.bar(range(len(bars)), y, yerr=np.abs(ends - y), color=colours, capsize=2)
        axis.set_xticks(range(len(bars)), [row["row"] for row in bars], rotation=30, ha="right")
        axis.set_ylim(0, 1.03)
        axis.set_axisbelow(True)
        prepare(axis, f"{place[0]} on {place[1]}, {bars[0]['objects']} objects", "", "success")
    save(figure, stem, ("png",))


def _effort(row: Row) -> str:
    figures = row["figures"]
    return number(figures["attempts_per_valid_scene"]) if figures["success"] else "-"


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


def table_of(
    title: str, columns: Sequence[Column], rows: Iterable[Row], notes: Iterable[str] = ()
) -> Table:
    """A line for each row; where figures are missing it has dashes, and a note below says why.

    What rows were trained with, may use and are asked for stands in a column of its own where they differ
    in it (`_FACTS`): no table compares unequal budgets or rules without saying so.
    """
    rows = list(rows)
    place = next((at for at, each in enumerate(columns) if not each.is_asked), len(columns))
    columns = [*columns[:place], *_differing(columns, rows), *columns[place:]]
    lines = (
        tuple(each.cell(row) if "missing" not in row or each.is_asked else "-" for each in columns)
        for row in rows
    )
    why = dict.fromkeys(missing(row) for row in rows if "missing" in row)
    return Table(title, tuple(each.heading for each in columns), tuple(lines), (*notes, *why))


_FACTS: dict[str, Callable[[Row], Any]] = {
    "training attempts": lambda row: (row.get("policy") or {}).get("attempts"),
    "budget": lambda row: row.get("rules", row["trial"]).get("budget"),
    "margin, mm": lambda row: 1e3 * (row["trial"].get("min_margin") or 0.0),
}
"""What makes rows unequal beside their method's own way, by the heading of the column that says it."""


def _differing(columns: Sequence[Column], rows: Sequence[Row]) -> list[Column]:
    """Columns of the facts in which rows with figures differ and which no column shows."""
    shown = {column.heading for column in columns}
    made = [row for row in rows if "trial" in row and "figures" in row]

    def cell(row: Row, fact: Callable[[Row], Any]) -> str:
        value = fact(row)
        return "-" if value is None else f"{value:,g}" if value < 1e4 else f"{value:,.0f}"

    found = []
    for heading, fact in _FACTS.items():
        values = {fact(row) for row in made} - {None}
        if len(values) > 1 and heading not in shown:
            found.append(Column(heading, partial(cell, fact=fact)))
    return found


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
