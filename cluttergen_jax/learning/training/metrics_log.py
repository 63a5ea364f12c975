"""Logs of a run's metrics: CSV files, TensorBoard, Weights & Biases, the learning curve as a picture."""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from cluttergen_jax.errors import MissingExtraError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.schema import Record

Row = dict[str, float]


class Sink(Protocol):
    """Something that follows a run's figures from outside, such as TensorBoard."""

    def add(self, row: Row, group: str) -> None:
        """One row; `group` is "" for training's figures, or a prefix such as "evaluation/"."""
        ...

    def close(self) -> None:
        """All rows have been given."""
        ...


class MetricsLog:
    """Appends rows to a CSV file; a run that is taken up again continues it.

    Args:
      path: the file.
      first_update: rows from this update on are dropped: they are about to be made again.
      sinks: are given every new row too.
      group: the rows' prefix there.
    """

    def __init__(
        self, path: Path, first_update: int = 0, sinks: Sequence[Sink] = (), group: str = ""
    ) -> None:
        self.path = path
        self._sinks = sinks
        self._group = group
        self.rows = [row for row in read_rows(path) if row["update"] < first_update]
        if self.rows or path.exists():
            self._rewrite()

    def add(self, row: Row) -> None:
        """Stores the figures of one update."""
        self.rows.append(row)
        if len(self.rows) == 1:
            self._rewrite()
        else:
            with self.path.open("a", newline="") as file:
                csv.DictWriter(file, fieldnames=list(self.rows[0])).writerow(row)
        for sink in self._sinks:
            sink.add(row, self._group)

    def _rewrite(self) -> None:
        text = io.StringIO()
        if self.rows:
            writer = csv.DictWriter(text, fieldnames=list(self.rows[0]))
            writer.writeheader()
            writer.writerows(self.rows)
        write_atomically(self.path, text.getvalue().encode())


class TensorBoard:
    """A `Sink` that writes TensorBoard's event files."""

    def __init__(self, folder: Path) -> None:
        from tensorboardX import SummaryWriter

        self._writer = SummaryWriter(str(folder / "tensorboard"))

    def add(self, row: Row, group: str) -> None:
        """See `Sink.add`."""
        for name, value in row.items():
            self._writer.add_scalar(group + name, value, int(row["attempts"]))

    def close(self) -> None:
        """See `Sink.close`."""
        self._writer.close()


def read_rows(path: Path) -> list[Row]:
    """The rows of a file of `MetricsLog`; none if there is no such file.

    A last row that was cut short, as by a full disk, is left out.
    """
    if not path.exists():
        return []
    with path.open(newline="") as file:
        found = [_numbers(row) for row in csv.DictReader(file)]
    return [row for row in found if row is not None]


def _numbers(row: Mapping[str, str]) -> Row | None:
    try:
        return {name: float(value) for name, value in row.items()}
    except (TypeError, ValueError):
        return None


PANELS = (("success", "success"), ("num_placed", "objects placed"), ("entropy", "entropy (nats)"))


def draw_curve(rows: list[Row], path: Path, title: str, evaluations: Sequence[Row] = ()) -> None:
    """Success, objects placed and entropy against attempts, as a PNG; evaluated success as points."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    attempts = [row["attempts"] / 1000 for row in rows]
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    axes = figure.subplots(1, 3)
    for axis, (name, label) in zip(axes, PANELS, strict=True):
        # A single row makes no line.
        marker = "." if len(rows) == 1 else ""
        axis.plot(
            attempts, [row[name] for row in rows], marker=marker, linewidth=1.2, label="training"
        )
        axis.set_xlabel("attempts (thousands)")
        axis.set_title(label, fontsize=10)
        axis.grid(alpha=0.3)
    if evaluations:
        _draw_evaluations(axes[0], evaluations)
    # Room for a line at 0 or 1, which the frame would hide.
    axes[0].set_ylim(-0.03, 1.03)
    figure.suptitle(title, fontsize=10)
    FigureCanvasAgg(figure)
    picture = io.BytesIO()
    figure.savefig(picture, dpi=120)
    write_atomically(path, picture.getvalue())


def _draw_evaluations(axis: Any, evaluations: Sequence[Row]) -> None:
    """The rate of whole last checks with its 95 % interval."""
    success = [row["success"] for row in evaluations]
    below = [row["success"] - row["low95"] for row in evaluations]
    above = [row["high95"] - row["success"] for row in evaluations]
    attempts = [row["attempts"] / 1000 for row in evaluations]
    style = {"fmt": "o", "markersize": 3, "linewidth": 1, "color": "black"}
    axis.errorbar(attempts, success, yerr=[below, above], label="evaluation", **style)
    axis.legend(fontsize=8, loc="lower right")


PROJECT = "cluttergen"


class WandbLog:
    """A `Sink` that sends every row to Weights & Biases.

    A run that is taken up again goes on where it was: its id is made from its folder.

    Args:
      folder: of the run; its name is the run's.
      recipe: JSON values that describe the run.

    Raises:
      MissingExtraError: wandb is not installed.
    """

    def __init__(self, folder: Path, recipe: Record) -> None:
        try:
            import wandb
        except ImportError as error:
            raise MissingExtraError("wandb", "`wandb`") from error
        identity = hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:16]
        self._run = wandb.init(
            project=PROJECT,
            name=folder.name,
            id=identity,
            resume="allow",
            dir=str(folder),
            config=recipe,
        )

    def add(self, row: Row, group: str) -> None:
        """See `Sink.add`; the step is the number of attempts."""
        self._run.log(
            {group + name: value for name, value in row.items()}, step=int(row["attempts"])
        )

    def close(self) -> None:
        """See `Sink.close`."""
        self._run.finish()
