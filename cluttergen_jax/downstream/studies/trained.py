"""Placers that differ in what they were trained on: rows by variant and seed, and their table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cluttergen_jax.downstream.placer.evaluation.evaluate import PlacerTrials
from cluttergen_jax.downstream.placer.evaluation.tables import MAIN, NOTES, Row, main_cells
from cluttergen_jax.downstream.placer.pairs.store import PairSet
from cluttergen_jax.downstream.studies.study import SuiteFolder
from cluttergen_jax.proportions import wilson
from cluttergen_jax.tables import Table

SEEDS_NOTE = (
    "of several training seeds the mean; its interval is that of the queries that each was asked, since all "
    "were asked the same, and knows nothing of what differs from seed to seed"
)


class Variant(NamedTuple):
    """One way to train a placer.

    Attributes:
      labels: what a table says of it, by column; all but the noise.
      runs: the trained placers by training seed; a name for what is not trained.
    """

    labels: dict[str, str]
    runs: dict[int, Path] | str


def household_placers(suite: SuiteFolder, head: str, num_pairs: int, pairs: PairSet) -> dict[int, Path]:
    """Placers that learned from the first so many pairs of household alone, by training seed."""
    name = f"household-{head}-{num_pairs}"
    return {seed: suite.trained(name, pairs, head, seed, num_pairs) for seed in suite.scale.training_seeds}


def rows_of(trials: PlacerTrials, variants: Sequence[Variant], noises: Sequence[float]) -> list[Row]:
    """Each variant's rows by noise and training seed, with its labels: `variant`, `training_seed`."""
    rows = []
    for noise in noises:
        for variant in variants:
            for seed, placer, name in _placers(variant.runs):
                row = trials.row(placer, noise, name=name)
                rows.append(row | {"variant": variant.labels, "training_seed": seed})
    return rows


def _placers(runs: dict[int, Path] | str) -> list[tuple[int | None, str, str]]:
    if isinstance(runs, str):
        return [(None, runs, runs)]
    return [(seed, str(run), run.name) for seed, run in runs.items()]


def grouped(rows: Sequence[Row]) -> list[list[Row]]:
    """Rows that differ in their training seed alone, together."""
    groups: dict[Any, list[Row]] = {}
    for row in rows:
        trial = row["trial"]
        told = {name: value for name, value in trial.items() if name != "placer"}
        groups.setdefault((*row["variant"].items(), *told.items()), []).append(row)
    return list(groups.values())


def table_of(title: str, rows: Sequence[Row], notes: Sequence[str] = ()) -> Table:
    """The main table of variants, a line for all training seeds of one."""
    groups = grouped(rows)
    columns = (*groups[0][0]["variant"], "noise", "seeds", MAIN[0], "each seed", *MAIN[1:])
    return Table(title, columns, tuple(map(_line, groups)), (*notes, SEEDS_NOTE, NOTES[1]))


def _line(rows: list[Row]) -> tuple[str, ...]:
    shares = [row["figures"]["success"]["share"] for row in rows]
    cells = main_cells(mean_figures(rows))
    return (
        *rows[0]["variant"].values(),
        f"{rows[0]['trial']['noise']:g}",
        "-" if rows[0]["training_seed"] is None else str(len(rows)),
        cells[0],
        "-" if len(rows) == 1 else " ".join(f"{share:.3f}" for share in shares),
        *cells[1:],
    )


def mean_figures(rows: Sequence[Row]) -> dict[str, Any]:
    """What `main_cells` reads of figures, as means over rows of the same queries."""
    queries = rows[0]["trial"]["queries"]
    figures = [row["figures"] for row in rows]
    shares = ("success", "best_of_all", "with_margin", "paper")
    verdicts = [each["verdicts"] for each in figures]
    errors = [each["z_error"]["median"] for each in figures]
    return {
        **{name: pooled([each[name] for each in figures], queries) for name in shares},
        "many": pooled([each["many"] for each in figures], queries),
        "z_error": {"median": None if None in errors else float(np.mean(errors))},
        "verdicts": {name: float(np.mean([each[name] for each in verdicts])) for name in verdicts[0]},
    }


def pooled(shares: Sequence[dict[str, Any]], queries: int) -> dict[str, Any]:
    """The mean of shares of the same queries, with the interval of a share of so many.

    Args:
      queries: where a share does not say itself of how many it is; where these differ, the fewest count.
    """
    told = [each["share"] for each in shares]
    if None in told:
        return {"share": None, "low95": None, "high95": None}
    mean, number = float(np.mean(told)), min(int(each.get("queries", queries)) for each in shares)
    low, high = wilson(round(mean * number), number)
    return {"share": mean, "low95": low, "high95": high}
