"""Methods side by side: the rows and the table of `cluttergen_jax.evaluate`."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.evaluation import plots
from cluttergen_jax.evaluation.cells import (
    SPEED,
    SUCCESS,
    Column,
    figure_column,
    name_of,
    number,
    request_columns,
    share,
    table_of,
)
from cluttergen_jax.evaluation.records import Row
from cluttergen_jax.evaluation.resolved import Checkpoints
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.store import Store, json_bytes
from cluttergen_jax.evaluation.trial import Trial, trial_of
from cluttergen_jax.files import write_atomically
from cluttergen_jax.tables import Table

_FIGURES = (
    "success",
    "low95",
    "high95",
    "filled",
    "placed",
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


def open_runner(
    folder: Path | None,
    trials: Sequence[Trial],
    checkpoint: str | Path | None,
    checkpoints: str | Path | None,
    engine: str,
    num_threads: int,
    fresh: bool,
) -> Runner:
    """A runner that knows how much is left to do; what cannot be found is said before anything runs."""
    where = Checkpoints(
        folder=None if checkpoints is None else Path(checkpoints),
        path=None if checkpoint is None else Path(checkpoint),
    )
    runner = Runner(Store(folder and folder / "results"), where, engine, num_threads, fresh)
    runner.plan(trials)
    if folder is not None:
        # Before hours of work: a place that cannot be written to.
        folder.mkdir(parents=True, exist_ok=True)
    return runner


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
        Column("attempts per valid scene", _effort),
        SPEED,
    )
    first = trial_of(rows[0])
    return table_of("; ".join([f"{first.trials} trials a row", *first.asked]), columns, rows)


def _draw(rows: Sequence[dict[str, Any]], stem: Path) -> None:
    """A panel for each pool on each support: success of each row with its interval."""
    made = [row for row in rows if row["missing"] is None]
    places = list(dict.fromkeys((row["pool"], row["support"]) for row in made))
    figure, axes = plots.grid_of_panels(len(places), 3, 3.4, 2.4)
    for axis, place in zip(axes, places, strict=True):
        bars = [row for row in made if (row["pool"], row["support"]) == place]
        y = np.array([row["success"] for row in bars])
        ends = np.array([[row["low95"], row["high95"]] for row in bars]).T
        colours = [plots.colour(row["method"]) for row in bars]
        axis.bar(range(len(bars)), y, yerr=np.abs(ends - y), color=colours, capsize=2)
        axis.set_xticks(range(len(bars)), [row["row"] for row in bars], rotation=30, ha="right")
        axis.set_ylim(0, 1.03)
        axis.set_axisbelow(True)
        plots.prepare(
            axis, f"{place[0]} on {place[1]}, {bars[0]['objects']} objects", "", "success"
        )
    plots.save(figure, stem, ("png",))


def _effort(row: Row) -> str:
    figures = row["figures"]
    return number(figures["attempts_per_valid_scene"]) if figures["success"] else "-"
