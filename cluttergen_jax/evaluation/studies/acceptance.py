"""Acceptance bias of a method: what passes less often than it is proposed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cluttergen_jax.evaluation.cells import HEAD, Column, Row, table_of
from cluttergen_jax.evaluation.measures.acceptance import Bias, acceptance_bias
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.studies import diversity
from cluttergen_jax.evaluation.studies.findings import Findings, each_standing, row_of
from cluttergen_jax.evaluation.studies.study import Result, Scale, Study
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.tables import Table


def trials(scale: Scale) -> tuple[Trial, ...]:
    """The scenes of `diversity`, by the paper's rules: every object proposed in its turn, none taken away."""
    return diversity.papers_scenes(scale, 512, 16)


def measure(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """Lifts of objects, places, turns and slots: every proposal, and those that stand in valid scenes."""
    rows: list[Row] = []
    for trial, scenes in each_standing(runner, trials, rows):
        arrays = scenes.arrays
        action, scene = arrays["attempt_action"], arrays["attempt_scene"]
        sortings = acceptance_bias(
            scenes.world.names,
            arrays["attempt_object"],
            (2 * action[:, :2] - 1) * np.asarray(scenes.region.half_extents),
            2 * np.pi * action[:, 3],
            arrays["attempt_slot"],
            arrays["attempt_is_stable"] & arrays["is_success"][scene],
            scene,
            scenes.region,
        )
        for sorting, bias in sortings.items():
            proposals, passed = int(bias.proposed.sum()), int(bias.passed.sum())
            rows.append(
                row_of(trial, sorting=sorting, under=_under(bias), proposals=proposals, passed=passed)
            )
    return Findings(rows)


def _under(bias: Bias) -> list[Row]:
    """What is under-represented, with the intervals of its lift."""
    return [
        {
            "label": bias.labels[c],
            "lift": float(bias.lift[c]),
            "low95": float(bias.low[c]),
            "high95": float(bias.high[c]),
        }
        for c in (bias.labels.index(label) for label in bias.under_represented)
    ]


def tables(result: Result) -> list[Table]:
    """What is under-represented among what passes."""
    columns = (
        *HEAD,
        Column("sorted by", lambda row: row["sorting"]),
        Column("proposals", lambda row: str(row["proposals"])),
        Column("passed", lambda row: str(row["passed"])),
        Column(
            "under-represented: lift [95 %]",
            lambda row: "; ".join(f"{each['label']} {_lift(each)}" for each in row["under"][:5]) or "nothing",
        ),
    )
    notes = (
        "lift: share among proposals that stand in a valid scene over share among all proposals; 1 is "
        "no bias",
        "shown are at most five whose whole interval lies below 1; intervals are bootstrapped over scenes",
    )
    return [table_of(result["title"], columns, result["measure"]["rows"], notes)]


def _lift(row: Row) -> str:
    return f"{row['lift']:.2f} [{row['low95']:.2f}, {row['high95']:.2f}]"


ACCEPTANCE = Study("acceptance", "What passes less often than it is proposed", 512, trials, tables, measure)
