"""What several figures of studies share: one legend for all panels, and success with its intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cluttergen_jax.evaluation.comparison import COLOURS, colour, method_of
from cluttergen_jax.evaluation.records import Figures

LABELS = {"random": "random (RRS)", "beta_free": "beta_free (the paper's)"}


def label_of(method: str) -> str:
    """The method's name in legends."""
    return LABELS.get(method, method)


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
    labels = sorted(lines, key=lambda label: (ranks.get(method_of(label), len(ranks)), label))
    figure.legend(
        [lines[label] for label in labels], labels, fontsize=7, loc="outside right center"
    )


def plot_success(axis: Any, name: str, x: Sequence[float], figures: Sequence[Figures]) -> None:
    """Draws a row's success with 95 % intervals, dashed where its rules are not its method's own."""
    y = np.array([each["success"] for each in figures])
    ends = np.array([[each["low95"], each["high95"]] for each in figures]).T
    style = "-" if name == method_of(name) else "--"
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
