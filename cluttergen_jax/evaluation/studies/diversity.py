"""Diversity of a method's scenes: evenness of positions, distances between scenes, Vendi score."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.evaluation.cells import HEAD, Column, Row, number, table_of
from cluttergen_jax.evaluation.measures import diversity as measures
from cluttergen_jax.evaluation.rivals import by_question, ranking
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.studies.density import SIZES, table_sizes
from cluttergen_jax.evaluation.studies.findings import Findings, Successes, each_standing, row_of
from cluttergen_jax.evaluation.studies.rules import RULES, margin_of, own_rules
from cluttergen_jax.evaluation.studies.study import Result, Scale, Study, grid
from cluttergen_jax.evaluation.studies.table1 import ALL_METHODS
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.statistics import finite
from cluttergen_jax.tables import Table

TIGHT = table_sizes(SIZES[2])[0]
_LEAST_SHARE = 0.25
"""A method that hardly ever succeeds would leave the others too few scenes to be compared."""


def papers_scenes(scale: Scale, full: int, quick: int) -> tuple[Trial, ...]:
    """All methods on a table of the paper's region and on a tight one, by the paper's rules."""
    base, supports = scale.trial(full, quick), table_sizes(SIZES[0], SIZES[2])
    return grid(base, pool=scale.chosen("dining"), support=supports, method=ALL_METHODS)


def scenes_of(scale: Scale, full: int, quick: int) -> tuple[Trial, ...]:
    """The same, each method by its own rules."""
    return tuple(map(own_rules, papers_scenes(scale, full, quick)))


def trials(scale: Scale) -> tuple[Trial, ...]:
    """Enough scenes that the rarer places are seen."""
    return scenes_of(scale, 512, 16)


def measure(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """Spatial entropy, nearest neighbours, Vendi score and boxes, all methods at equal counts."""
    rows: list[Row] = []
    groups: dict[tuple[str, str], list[tuple[Trial, Successes]]] = {}
    for trial, scenes in each_standing(runner, trials, rows, lambda trial: trial.trials * _LEAST_SHARE):
        groups.setdefault((trial.pool_name, trial.support_name), []).append((trial, scenes))
    for group in groups.values():
        count = min(len(scenes) for _, scenes in group)
        rows += [row_of(trial, **_figures(scenes, count)) for trial, scenes in group]
    note = "Figures depend on the number of scenes: each group is compared at equal counts."
    return Findings(rows, notes=[note])


def _figures(scenes: Successes, count: int) -> dict[str, Any]:
    world, region = scenes.world, scenes.region
    vectors = measures.embed(world.objects, scenes.poses, scenes.is_placed, region, world.support.top)

    def mean(figure: Callable[[np.ndarray], float]) -> float | None:
        return finite(measures.at_equal_count(figure, len(scenes), count)[0])

    return {
        "scenes": count,
        "evenness": mean(
            lambda some: np.nanmean(
                measures.plan_entropy(scenes.poses[some], scenes.is_placed[some], region).evenness
            )
        ),
        "nearest": mean(lambda some: measures.nearest_distance(vectors[some]).mean()),
        "vendi": mean(lambda some: measures.vendi_score(measures.scene_kernel(vectors[some], region))),
        "box_area": mean(
            lambda some: np.nanmean(
                measures.plan_box_area(scenes.poses[some], scenes.is_placed[some], region)
            )
        ),
    }


def tables(result: Result) -> list[Table]:
    """A line for each method on each table."""
    rows = result["measure"]["rows"]
    columns = (
        *HEAD,
        Column("scenes", lambda row: str(row["scenes"])),
        Column("evenness", lambda row: number(row["evenness"], 3)),
        Column("nearest scene, m", lambda row: number(row["nearest"], 3)),
        Column("Vendi score", lambda row: number(row["vendi"], 1)),
        Column("bounding box, m^2", lambda row: number(row["box_area"], 3)),
    )
    notes = (
        "evenness: entropy of an object's position over 5 cm cells, 1 for an even spread, mean over objects",
        "nearest scene: distance to the most similar other scene; Vendi score: effective number of different "
        "scenes",
        "bounding box: the paper's measure, decided by outliers",
        *RULES,
        *(
            f"Vendi score on {support}, highest first: {ranking(group, 'vendi', 1)}"
            for support, group in by_question(rows, lambda row: row["support"]).items()
        ),
    )
    return [table_of(result["title"] + margin_of(rows), columns, rows, notes)]


DIVERSITY = Study("diversity", "How different the scenes of a method are", 512, trials, tables, measure)
