"""Plots by Matplotlib, saved as PNG and PDF."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.files import write_atomically
from cluttergen_jax.training.suite import DEFAULT_ATTEMPTS

COLOURS = {
    "random": "#8a8f98",
    "clear": "#4d9078",
    "drop": "#2f5d62",
    "open_loop": "#c9a227",
    "short_memory": "#b5651d",
    "normal": "#7b5ea7",
    "beta": "#e07b39",
    "policy": "#c8102e",
    "policy-clear": "#1f77b4",
    "ranked": "#e377c2",
}
"""Of methods, the same in every plot."""

_FEWEST = 5
_APART = 0.04

LABELS = {"random": "random (RRS)", "beta": "beta (the paper's)"}


def colour(method: str) -> str:
    """The method's colour; black for one that has none."""
    return COLOURS.get(method, "#111111")


def new_figure(width: float, height: float) -> Any:
    """An empty figure, sides in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save(figure: Any, stem: Path) -> list[str]:
    """Writes STEM.png and STEM.pdf; returns their names."""
    names = []
    for ending in ("png", "pdf"):
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
        lines |= {label: handle for label, handle in zip(labels, handles, strict=True) if label not in lines}
    ranks = [LABELS.get(method, method) for method in COLOURS]
    labels = sorted(lines, key=ranks.index)
    figure.legend([lines[label] for label in labels], labels, fontsize=7, loc="outside right center")


def grid(number: int, columns: int, width: float, height: float) -> tuple[Any, list[Any]]:
    """A figure of `number` panels in rows of `columns`, each so many inches large."""
    columns = min(columns, number)
    rows = -(-number // columns)
    figure = new_figure(columns * width, rows * height)
    axes = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for axis in axes[number:]:
        axis.set_visible(False)
    return figure, axes[:number]


def plan_view(axis: Any, positions: np.ndarray, region: Rectangle, shade: str, title: str) -> None:
    """Positions f[N, 2] (region frame, metres) as dots, with the region and the box between extremes."""
    from matplotlib.patches import Rectangle as Patch

    (x, y), low = region.half_extents, positions.min(0)
    axis.add_patch(Patch((-x, -y), 2 * x, 2 * y, fill=False, color="#444444", linewidth=0.8))
    size = np.ptp(positions, axis=0)
    axis.add_patch(Patch(tuple(low), *size, fill=False, color=shade, linewidth=0.8, linestyle="--"))
    axis.plot(*positions.T, ".", markersize=2.0, alpha=0.45, color=shade)
    axis.set_xlim(-1.15 * x, 1.15 * x)
    axis.set_ylim(-1.15 * y, 1.15 * y)
    axis.set_aspect("equal")
    axis.set_xticks([])
    axis.set_yticks([])
    axis.set_title(title, fontsize=8)


def fig1a(records: Sequence[dict], stem: Path) -> list[str]:
    """Success against the number of objects, the paper's count, a panel for each pool."""
    pools = list(dict.fromkeys(record["trial"]["pool"] for record in records))
    figure, axes = grid(len(pools), 3, 3.0, 2.4)
    for axis, pool in zip(axes, pools, strict=True):
        for record in (each for each in records if each["trial"]["pool"] == pool):
            method, figures = record["trial"]["method"], record["figures"]
            for source, style in ((figures["paper"], "-"), (figures, ":")):
                shares = at_least(source["placed_histogram"])
                label = LABELS.get(method, method) if style == "-" else None
                axis.plot(
                    range(1, len(shares) + 1), shares, style, color=colour(method), label=label, marker="."
                )
        prepare(axis, pool, "objects", "success (dotted: strict)")
        axis.set_ylim(-0.03, 1.03)
    add_legend(figure)
    return save(figure, stem)


def at_least(histogram: Sequence[int]) -> list[float]:
    """Shares of episodes in which at least 1, 2, ... objects were placed, from how many placed 0, 1, ...

    An episode of n objects is the beginning of one of more: the order is uniform, and no method is told how
    many are to come.
    """
    total = sum(histogram)
    return [sum(histogram[number:]) / total for number in range(1, len(histogram))]


def steps_by_attempt(records: Sequence[dict], stem: Path) -> list[str]:
    """Mean steps of each attempt, of at least five, with its standard error; a panel for each pool."""
    pools = list(dict.fromkeys(record["trial"]["pool"] for record in records))
    figure, axes = grid(len(pools), 3, 3.0, 2.4)
    for axis, pool in zip(axes, pools, strict=True):
        for record in (each for each in records if each["trial"]["pool"] == pool):
            steps = [
                each for each in record["figures"]["paper"]["steps_by_attempt"] if each["count"] >= _FEWEST
            ]
            method = record["trial"]["method"]
            if steps:
                error = [each["std"] / np.sqrt(each["count"]) for each in steps]
                x, y = [each["attempt"] for each in steps], [each["mean"] for each in steps]
                label = LABELS.get(method, method)
                axis.errorbar(x, y, error, color=colour(method), label=label, marker=".", linewidth=1.0)
        prepare(axis, pool, "attempt", "steps")
        axis.set_xticks(range(1, DEFAULT_ATTEMPTS + 1))
        axis.set_ylim(0, 250)
    add_legend(figure)
    return save(figure, stem)


def attempts(records: Sequence[dict], stem: Path) -> list[str]:
    """Success (the paper's count) against the attempts allowed, with 95 % intervals."""
    figure = new_figure(5.0, 2.8)
    axis = figure.subplots()
    for method in dict.fromkeys(record["trial"]["method"] for record in records):
        rows = [record for record in records if record["trial"]["method"] == method]
        x = [row["trial"]["attempts"] for row in rows]
        paper = [row["figures"]["paper"] for row in rows]
        y = np.array([each["success"] for each in paper])
        ends = np.array([[each["low95"], each["high95"]] for each in paper]).T
        axis.errorbar(
            x, y, np.abs(ends - y), color=colour(method), label=LABELS.get(method, method), marker="."
        )
    prepare(axis, "", "attempts per object", "success, paper's count")
    axis.set_ylim(-0.03, 1.03)
    add_legend(figure)
    return save(figure, stem)


def density(records: Sequence[dict], stem: Path) -> list[str]:
    """Strict success along the rows of the study, a line for each method."""
    figure = new_figure(6.4, 3.0)
    axis = figure.subplots()
    rungs = list(dict.fromkeys(rung_of(record["trial"]) for record in records))
    methods = list(dict.fromkeys(record["trial"]["method"] for record in records))
    for turn, method in enumerate(methods):
        rows = [record for record in records if record["trial"]["method"] == method]
        # Side by side, so that equal rates do not hide one another.
        x = [rungs.index(rung_of(row["trial"])) + _APART * (turn - (len(methods) - 1) / 2) for row in rows]
        y = np.array([row["figures"]["success"] for row in rows])
        ends = np.array([[row["figures"]["low95"], row["figures"]["high95"]] for row in rows]).T
        axis.errorbar(
            x, y, np.abs(ends - y), color=colour(method), label=LABELS.get(method, method), marker="."
        )
    prepare(axis, "", "", "success")
    axis.set_xticks(range(len(rungs)), rungs)
    axis.set_ylim(-0.03, 1.03)
    add_legend(figure)
    return save(figure, stem)


def rung_of(trial: dict) -> str:
    """Where a trial stands on the density ladder: its table, or its number of objects."""
    size = trial["support"].removeprefix("table-")
    return f"{trial['num_objects']} objects" if size == "table" else f"{size} m"


PLOTS = {"fig1a": fig1a, "steps_by_attempt": steps_by_attempt, "attempts": attempts, "density": density}
"""Plots of a study's records, by layout."""
