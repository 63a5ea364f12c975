"""Robustness of finished scenes: creep over 1, 10 and 60 s, shaking, and changed physics."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.evaluation.cells import HEAD, Column, Row, number, share, table_of
from cluttergen_jax.evaluation.measures.robustness import CREEP_SECONDS, creep, shake, survives
from cluttergen_jax.evaluation.measures.scene_models import SceneModels
from cluttergen_jax.evaluation.rivals import share_notes
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.studies.diversity import scenes_of
from cluttergen_jax.evaluation.studies.findings import Findings, Successes, each_standing, row_of
from cluttergen_jax.evaluation.studies.rules import RULES, margin_of
from cluttergen_jax.evaluation.studies.study import Result, Scale, Study
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.statistics import finite, proportion
from cluttergen_jax.tables import Table


def trials(scale: Scale) -> tuple[Trial, ...]:
    """Few scenes: a minute is simulated of each."""
    return scenes_of(scale, 64, 4)


def measure(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """All three of every method's scenes."""
    rows: list[Row] = []
    for trial, scenes in each_standing(runner, trials, rows):
        make = partial(_figures, scenes, runner.num_threads)
        rows.append(row_of(trial, **runner.measured(trial, "robustness", make)))
    return Findings(rows)


def _figures(scenes: Successes, num_threads: int) -> dict[str, Any]:
    models = SceneModels(scenes.world)
    arrays = (scenes.poses, scenes.is_placed)
    moved = creep(models, *arrays, num_threads=num_threads)
    scores = shake(models, *arrays, num_threads=num_threads).min(1)
    standing = survives(models, *arrays, num_threads=num_threads)
    return {
        "scenes": len(scenes),
        "creep": [
            {
                "seconds": seconds,
                "median_shift": finite(np.median(moved.largest_shift[:, h])),
                **proportion(moved.survives()[:, h]),
            }
            for h, seconds in enumerate(CREEP_SECONDS)
        ],
        "shake": [float(each) for each in np.percentile(scores, [10, 50, 90])],
        "changes": {name: proportion(each) for name, each in standing.items()},
    }


def tables(result: Result) -> list[Table]:
    """Creep and shake, then changed physics."""
    rows = result["measure"]["rows"]
    made: Row = next((row for row in rows if "creep" in row), {"creep": [], "changes": {}})

    def stands(place: int, seconds: float) -> Column:
        return Column(f"stands {seconds:g} s", lambda row: share(row["creep"][place]["share"]))

    def moved(place: int, seconds: float) -> Column:
        heading = f"median creep {seconds:g} s, micrometres"
        return Column(heading, lambda row: number(row["creep"][place]["median_shift"], 2, 1e6))

    def changed(name: str) -> Column:
        return Column(name, lambda row: share(row["changes"][name]["share"]))

    seconds = list(enumerate(each["seconds"] for each in made["creep"]))
    columns = (
        *HEAD,
        Column("scenes", lambda row: str(row["scenes"])),
        *(stands(*each) for each in seconds),
        *(moved(*each) for each in seconds),
        Column("shake, m/s^2", _shake),
    )

    notes = (
        "stands: nothing moved over 5 mm or turned over 5 degrees; creep: the largest movement in a scene",
        "shake: sideways acceleration of the table at which something has moved 5 mm, the weaker of two "
        "directions, median [10 %, 90 %] of scenes",
    )
    second = "Share of scenes that stand 10 s under changed physics"
    margin = margin_of(rows)
    stood = [{**row, **row["creep"][1]} for row in rows if len(row.get("creep", ())) > 1]
    compared = share_notes(stood, lambda row: f"stands {row['seconds']:g} s on {row['support']}")
    return [
        table_of(result["title"] + margin, columns, rows, (*notes, *RULES, *compared)),
        table_of(second + margin, (*HEAD, *map(changed, made["changes"])), rows, notes[:1]),
    ]


def _shake(row: Row) -> str:
    low, median, high = row["shake"]
    return f"{median:.2f} [{low:.2f}, {high:.2f}]"


ROBUSTNESS = Study(
    "robustness", "Creep, shaking and changed physics", 64, trials, tables, measure, keeps_each=True
)
