"""Cells of tables that show the strict count and the paper's looser one side by side."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from cluttergen_jax.evaluation.cells import Column, Row, interval, mean_and_spread
from cluttergen_jax.proportions import wilson

STRICT = "strict: every slot stable without disturbing anything, and the finished scene stands"
LOOSE = "paper's count: only the current object is judged, the others are put back, no last check"


def figures_by(row: Row, is_loose: bool) -> dict[str, Any]:
    """A row's figures by one of the two counts."""
    return row["figures"]["paper"] if is_loose else row["figures"]


def pooled(rows: Iterable[Row], is_loose: bool) -> str:
    """Success over all trials of several rows, with its interval."""
    figures = [figures_by(row, is_loose) for row in rows]
    successes, trials = (sum(each[name] for each in figures) for name in ("num_success", "trials"))
    return interval(successes / trials, *wilson(successes, trials))


def stable_steps(rows: Iterable[Row]) -> str:
    """Stable steps by the paper's count; of several seeds, their plain mean."""
    spreads = [row["figures"]["paper"]["stable_steps"] for row in rows]
    known = [each for each in spreads if each["mean"] is not None]
    if not known:
        return "-"
    mean, std = (sum(each[name] for each in known) / len(known) for name in ("mean", "std"))
    return mean_and_spread({"mean": mean, "std": std})


BOTH = (
    Column("success, strict [95 %]", lambda row: pooled([row], is_loose=False)),
    Column("success, paper's count [95 %]", lambda row: pooled([row], is_loose=True)),
)
STEPS = Column("stable steps", lambda row: stable_steps([row]))
