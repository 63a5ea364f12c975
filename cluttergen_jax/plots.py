"""One look for all figures: fit to print, for eyes of all kinds, as pixels and as vectors.

A method has one colour and one mark everywhere; lines that have
the colour of another differ in their dashes. Colours are from Okabe and Ito's palette and from Tol's.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from cluttergen_jax.files import write_atomically

PAGE = 7.0
"""Inches of two columns."""

LOOKS: dict[str, tuple[str, str]] = {
    "random": ("#999999", "o"),
    "settle": ("#000000", "s"),
    "clear": ("#56b4e9", "^"),
    "drop": ("#117733", "v"),
    "open_loop": ("#a6761d", "<"),
    "short_memory": ("#e69f00", ">"),
    "normal": ("#cc79a7", "P"),
    "beta_free": ("#d55e00", "X"),
    "policy": ("#882255", "D"),
    "spread": ("#66ccbb", "p"),
    "guided": ("#0072b2", "*"),
}
"""Of methods: colour and mark."""
FONT = 7
"""Points."""
_DPI = 200


def method_of(name: str) -> str:
    """Of what tables call a row (`trial.row_name`)."""
    return name.partition(", ")[0]


def colour(name: str) -> str:
    """The colour of a row's method; black for one that has none."""
    return LOOKS.get(method_of(name), ("#111111", "."))[0]


def mark(name: str) -> str:
    """The mark of a row's method."""
    return LOOKS.get(method_of(name), ("#111111", "."))[1]


def new_figure(width: float, height: float) -> Any:
    """An empty figure, sides in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def grid_of_panels(number: int, columns: int, width: float, height: float) -> tuple[Any, list[Any]]:
    """A figure of `number` panels in rows of `columns`, each so many inches large."""
    columns = min(columns, number)
    rows = -(-number // columns)
    figure = new_figure(columns * width, rows * height)
    axes = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for axis in axes[number:]:
        axis.set_visible(False)
    return figure, axes[:number]


def prepare(axis: Any, title: str, x: str, y: str = "") -> None:
    """The look that all panels share."""
    axis.set_title(title, fontsize=FONT + 1)
    axis.set_xlabel(x, fontsize=FONT)
    axis.set_ylabel(y, fontsize=FONT)
    axis.tick_params(labelsize=FONT - 1, width=0.6, length=2.5)
    axis.grid(alpha=0.25, linewidth=0.5)
    axis.spines[["top", "right"]].set_visible(False)
    axis.spines[["left", "bottom"]].set_linewidth(0.6)


def save(figure: Any, stem: Path, endings: tuple[str, ...] = ("png", "pdf")) -> list[str]:
    """Writes STEM.png and STEM.pdf, or what else is asked for; returns their names."""
    import matplotlib

    names = []
    # Text stays text in a PDF.
    with matplotlib.rc_context({"pdf.fonttype": 42}):
        for ending in endings:
            buffer = io.BytesIO()
            # Without a date, equal plots are equal files.
            metadata = {"CreationDate": None} if ending == "pdf" else {"Software": None}
            figure.savefig(buffer, format=ending, dpi=_DPI, metadata=metadata)
            path = stem.with_name(f"{stem.name}.{ending}")
            write_atomically(path, buffer.getvalue())
            names.append(path.name)
    return names
