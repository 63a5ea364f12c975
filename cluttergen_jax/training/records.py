"""What a run leaves to read: a CSV file, TensorBoard events, and the learning curve as a picture."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

Row = dict[str, float]


class Records:
    """Appends one row per update; a run that is taken up again continues its file.

    Args:
      folder: of the run.
      first_update: rows from this update on are dropped: they are about to be made again.
    """

    def __init__(self, folder: Path, first_update: int = 0, tensorboard: bool = True) -> None:
        self.path = folder / "progress.csv"
        self.rows = [row for row in read_rows(self.path) if row["update"] < first_update]
        self._rewrite()
        self._events = _events(folder) if tensorboard else None

    def add(self, row: Row) -> None:
        """Stores the figures of one update."""
        self.rows.append(row)
        with self.path.open("a", newline="") as file:
            csv.DictWriter(file, fieldnames=list(self.rows[0])).writerow(row)
        if self._events is not None:
            for name, value in row.items():
                self._events.add_scalar(name, value, int(row["attempts"]))

    def _rewrite(self) -> None:
        with self.path.open("w", newline="") as file:
            if self.rows:
                writer = csv.DictWriter(file, fieldnames=list(self.rows[0]))
                writer.writeheader()
                writer.writerows(self.rows)

    def begin(self, names: list[str]) -> None:
        """Writes the header if there are no rows yet."""
        if not self.rows:
            with self.path.open("w", newline="") as file:
                csv.DictWriter(file, fieldnames=names).writeheader()

    def close(self) -> None:
        """Flushes the event file."""
        if self._events is not None:
            self._events.close()


def _events(folder: Path) -> Any:
    from tensorboardX import SummaryWriter

    return SummaryWriter(str(folder / "tensorboard"))


def read_rows(path: Path) -> list[Row]:
    """The rows of a progress file; none if there is no such file."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]


def draw_curve(rows: list[Row], path: Path, title: str) -> None:
    """Success, objects placed and entropy against attempts, as a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    attempts = [row["attempts"] / 1000 for row in rows]
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    axes = figure.subplots(1, 3)
    panels = (("success", "success"), ("num_placed", "objects placed"), ("entropy", "entropy (nats)"))
    for axis, (name, label) in zip(axes, panels, strict=True):
        axis.plot(attempts, [row[name] for row in rows], linewidth=1.2)
        axis.set_xlabel("attempts (thousands)")
        axis.set_title(label, fontsize=10)
        axis.grid(alpha=0.3)
    axes[0].set_ylim(0, 1)
    figure.suptitle(title, fontsize=10)
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=120)
