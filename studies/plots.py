"""What several figures of studies share: shares with their intervals, and one legend for all panels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cluttergen_jax.plots import FONT, LOOKS, colour, mark, method_of
from cluttergen_jax.statistics import wilson

LABELS = {"random": "random (RRS)", "beta_free": "beta_free (the paper's)"}
PAPERS = "#777777"
"""The colour of what the paper shows."""


def dashes(name: str) -> str:
    """Solid, and dashed where a row's rules are not its method's own."""
    return "-" if name == method_of(name) else "--"


def label_of(name: str) -> str:
    """A row's name in legends."""
    return LABELS.get(name, name)


def plot_shares(
    axis: Any,
    name: str,
    x: Sequence[float],
    successes: Sequence[int],
    trials: Sequence[int],
    is_hollow: bool = False,
    label: str | None = None,
) -> None:
    """Draws shares with their 95 % intervals (Wilson), in the colour and with the mark of a row's method.

    Args:
      name: of the row; x, successes, trials: of each point.
      is_hollow: thin, with empty marks: another count of the same scenes.
      label: for the legend; the row's own if None, none if "".
    """
    shares = np.asarray(successes) / np.asarray(trials)
    ends = np.array([wilson(*each) for each in zip(successes, trials, strict=True)]).T
    axis.errorbar(
        x,
        shares,
        np.abs(ends - shares),
        color=colour(name),
        label=label_of(name) if label is None else label,
        marker=mark(name),
        markersize=3.5,
        markerfacecolor="white" if is_hollow else colour(name),
        markeredgewidth=0.7,
        linestyle=dashes(name),
        linewidth=0.7 if is_hollow else 1.1,
        elinewidth=0.7,
        capsize=1.5,
        capthick=0.7,
    )
    axis.set_ylim(-0.03, 1.03)


def add_legend(figure: Any, place: str = "outside right center", columns: int = 1) -> None:
    """One legend for all panels, in the order of `LOOKS`, lines with their marks and dashes."""
    from matplotlib.lines import Line2D

    handles: dict[str, Any] = {}
    for axis in figure.axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            # Of a line with intervals the first part is the line.
            line = handle[0] if isinstance(handle, tuple) else handle
            if label not in handles and isinstance(line, Line2D):
                shown = Line2D([], [])
                shown.update_from(line)
                handles[label] = shown
            handles.setdefault(label, handle)
    ranks = {label_of(method): rank for rank, method in enumerate(LOOKS)}
    # Of one rank in the order in which they were drawn.
    labels = sorted(handles, key=lambda label: ranks.get(method_of(label), len(ranks)))
    figure.legend(
        [handles[label] for label in labels],
        labels,
        fontsize=FONT,
        loc=place,
        ncols=columns,
        frameon=False,
        handlelength=3.2,
    )
