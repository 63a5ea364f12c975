"""Plots by Matplotlib, saved as PNG and PDF: what several figures share."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.evaluation.records import Figures
from cluttergen_jax.files import write_atomically

COLOURS = {
    "random": "#8a8f98",
    "clear": "#4d9078",
    "drop": "#2f5d62",
    "open_loop": "#c9a227",
    "short_memory": "#b5651d",
    "normal": "#7b5ea7",
    "beta_free": "#e07b39",
    "policy": "#c8102e",
    "spread": "#17a2a2",
    "guided": "#1f3fb4",
}
"""Of methods, the same in every plot."""

LABELS = {"random": "random (RRS)", "beta_free": "beta_free (the paper's)"}


def colour(name: str) -> str:
    """The colour of a row's method; black for one that has none."""
    return COLOURS.get(_method_of(name), "#111111")


def _method_of(name: str) -> str:
    """Of what tables call a row (`trial.row_name`)."""
    return name.partition(", ")[0]


def label_of(method: str) -> str:
    """The method's name in legends."""
    return LABELS.get(method, method)


def new_figure(width: float, height: float) -> Any:
    """An empty figure, sides in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save(figure: Any, stem: Path, endings: tuple[str, ...] = ("png", "pdf")) -> list[str]:
    """Writes STEM.png and STEM.pdf, or what else is asked for; returns their names."""
    names = []
    for ending in endings:
        buffer = io.BytesIO()
        # Without a date, equal plots are equal files.
        metadata = {"CreationDate": None} if ending == "pdf" else {"Software": None}
        figure.savefig(buffer, format=ending, dpi=130, metadata=metadata)
        path = stem.with_name(f"{stem.name}.{ending}")
        write_atomically(path, buffer.getvalue())
        names.append(path.name)
    return names


def prepare(axis: Any, title: str, x: str, y: str = "") -> None:
    """The look that all panels share."""
    axis.set_title(title, fontsize=9)
    axis.set_xlabel(x, fontsize=8)
    axis.set_ylabel(y, fontsize=8)
    axis.tick_params(labelsize=7)
    axis.grid(alpha=0.25, linewidth=0.6)


def add_legend(figure: Any) -> None:
    """One legend beside all panels, in the order of `COLOURS`; a panel may lack some of its lines."""
    lines: dict[str, Any] = {}
    for axis in figure.axes:
        handles, labels = axis.get_legend_handles_labels()
        lines |= {
            label: handle
            for label, handle in zip(labels, handles, strict=True)
            if label not in lines
        }
    ranks = {label_of(method): rank for rank, method in enumerate(COLOURS)}
    labels = sorted(lines, key=lambda label: (ranks.get(_method_of(label), len(ranks)), label))
    figure.legend(
        [lines[label] for label in labels], labels, fontsize=7, loc="outside right center"
    )


def grid_of_panels(number: int, columns: int, width: float, height: float) -> tuple[Any, list[Any]]:
    """A figure of `number` panels in rows of `columns`, each so many inches large."""
    columns = min(columns, number)
    rows = -(-number // columns)
    figure = new_figure(columns * width, rows * height)
    axes = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for axis in axes[number:]:
        axis.set_visible(False)
    return figure, axes[:number]


def plot_success(axis: Any, name: str, x: Sequence[float], figures: Sequence[Figures]) -> None:
    """Draws a row's success with 95 % intervals, dashed where its rules are not its method's own."""
    y = np.array([each["success"] for each in figures])
    ends = np.array([[each["low95"], each["high95"]] for each in figures]).T
    style = "-" if name == _method_of(name) else "--"
    axis.errorbar(
        x,
        y,
        np.abs(ends - y),
        color=colour(name),
        label=label_of(name),
        marker=".",
        linestyle=style,
    )
    axis.set_ylim(-0.03, 1.03)
