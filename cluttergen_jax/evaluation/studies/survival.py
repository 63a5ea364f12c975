"""The share of scenes that stand 10 s in PyBullet and in Drake, where they are installed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.errors import MissingExtraError
from cluttergen_jax.evaluation.cells import HEAD, Column, Row, number, share_of, table_of
from cluttergen_jax.evaluation.measures.scene_models import SceneModels
from cluttergen_jax.evaluation.measures.survival import PEERS, SURVIVAL_SECONDS, movement_elsewhere
from cluttergen_jax.evaluation.rivals import share_notes
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.studies import margin, robustness
from cluttergen_jax.evaluation.studies.diversity import TIGHT
from cluttergen_jax.evaluation.studies.findings import Findings, Successes, each_standing, row_of
from cluttergen_jax.evaluation.studies.rules import RULES, margin_of
from cluttergen_jax.evaluation.studies.study import Result, Scale, Study
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.statistics import finite, proportion
from cluttergen_jax.tables import Table


def of_margins(scale: Scale) -> tuple[Trial, ...]:
    """The policy on the tight table, with and without a support margin."""
    return tuple(each for each in margin.trials(scale) if (each.method, each.support) == ("policy", TIGHT))


def measure(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """Every trial in every engine."""
    rows: list[Row] = []
    notes: dict[str, None] = {}
    for trial, scenes in each_standing(runner, trials, rows):
        for engine in PEERS:
            make = partial(figures_in, scenes, engine, runner.num_threads)
            try:
                stood = runner.measured(trial, f"survival in {engine}", make)
            except MissingExtraError as error:
                notes[f"{engine}: {error}"] = None
                continue
            rows.append(row_of(trial, engine=engine, **stood))
    return Findings(rows, notes=list(notes))


def figures_in(scenes: Successes, engine: str, num_threads: int) -> dict[str, Any]:
    models = SceneModels(scenes.world)
    movement = movement_elsewhere(engine, models, scenes.poses, scenes.is_placed, num_threads=num_threads)
    return {
        "seconds": SURVIVAL_SECONDS[0],
        "scenes": len(scenes),
        "median_shift": finite(np.median(movement.largest_shift[:, 0])),
        **proportion(movement.survives()[:, 0]),
    }


def tables(result: Result) -> list[Table]:
    """A line for each method, table and engine."""
    rows = result["measure"]["rows"]
    columns = (
        *HEAD,
        *((margin.ASKED,) if asks_several(rows) else ()),
        Column("engine", lambda row: row["engine"]),
        Column("scenes", lambda row: str(row["scenes"])),
        Column("stands 10 s [95 %]", lambda row: share_of(row, "share")),
        Column("median of the largest movement, mm", lambda row: number(row["median_shift"], 2, 1e3)),
    )
    notes = (
        "stands: nothing moved over 5 mm or turned over 5 degrees",
        *RULES,
        *share_notes(rows, lambda row: f"stands 10 s in {row.get('engine')} on {row['support']}"),
    )
    # Of several margins, a column tells them apart.
    margin_text = "" if asks_several(rows) else margin_of(rows)
    return [table_of(result["title"] + margin_text, columns, rows, notes)]


def asks_several(rows: Sequence[Row]) -> bool:
    """Whether rows ask for different support margins."""
    return len({row.get("min_margin", 0.0) for row in rows}) > 1


SURVIVAL = Study(
    "survival", "The same scenes in another engine", 64, robustness.trials, tables, measure, keeps_each=True
)
MARGIN_SURVIVAL = replace(
    SURVIVAL,
    name="margin_survival",
    title="What a support margin does for survival in another engine",
    trials=of_margins,
)
