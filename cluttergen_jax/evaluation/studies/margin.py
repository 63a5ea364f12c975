"""Support margins of finished scenes, and what tilted gravity topples."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.evaluation.cells import HEAD, Column, Row, number, share, share_of, table_of
from cluttergen_jax.evaluation.measures.contacts import contacts_of
from cluttergen_jax.evaluation.measures.robustness import TiltConfig, tilt
from cluttergen_jax.evaluation.measures.scene_models import SceneModels
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.studies import robustness
from cluttergen_jax.evaluation.studies.findings import Findings, Successes, each_standing, row_of
from cluttergen_jax.evaluation.studies.rules import RULES
from cluttergen_jax.evaluation.studies.study import Result, Scale, Study, grid, of_methods
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.placement.baselines import BASELINES
from cluttergen_jax.placement.config import MIN_MARGIN
from cluttergen_jax.statistics import proportion
from cluttergen_jax.tables import Table
from cluttergen_jax.types import Verdict

ASKED = Column("margin asked for, mm", lambda row: number(row.get("min_margin", 0.0), 0, 1e3))


def trials(scale: Scale) -> tuple[Trial, ...]:
    """The scenes of `robustness`, without a margin and with the one that `generate` asks for."""
    chosen = of_methods(robustness.trials(scale), *BASELINES, "guided", "policy")
    return tuple(each for trial in chosen for each in grid(trial, min_margin=(0.0, MIN_MARGIN)))


def measure(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """Margins and tilt of every method's scenes, beside its success."""
    rows: list[Row] = []
    for trial, scenes in each_standing(runner, trials, rows):
        figures = runner.row(trial)["figures"]
        success = {name: figures[name] for name in ("success", "low95", "high95")}
        measured = runner.measured(trial, "margins", partial(_margins, scenes, runner.num_threads))
        measured |= runner.measured(trial, "tilt", partial(tilt_figures, scenes, runner.num_threads))
        unsupported = figures["verdicts"].get(Verdict.UNSUPPORTED.label, 0) / figures["attempts"]
        rows.append(row_of(trial, **success, unsupported=unsupported, **measured))
    return Findings(rows)


def _margins(scenes: Successes, num_threads: int) -> dict[str, Any]:
    models = SceneModels(scenes.world)
    margins = contacts_of(models, scenes.poses, scenes.is_placed, num_threads).margin
    least = np.nanmin(margins, axis=1)
    return {
        "scenes": len(scenes),
        "margin": [float(each) for each in np.percentile(least, [0, 10, 50])],
        "below": float((least < MIN_MARGIN).mean()),
    }


def tilt_figures(scenes: Successes, num_threads: int) -> dict[str, Any]:
    models, config = SceneModels(scenes.world), TiltConfig()
    stands = tilt(models, scenes.poses, scenes.is_placed, config, num_threads)
    return {
        "tilt": [
            {"degrees": by, "directions": float(each.mean()), **proportion(each == 1)}
            for by, each in zip(config.degrees, stands.T, strict=True)
        ],
    }


def tables(result: Result) -> list[Table]:
    """A line for each method, table and margin."""
    rows = result["measure"]["rows"]
    angles: list[Row] = next((row["tilt"] for row in rows if "tilt" in row), [])

    def stands(place: int, degrees: float) -> Column:
        def cell(row: Row) -> str:
            each = row["tilt"][place]
            return f"{share(each['share'])} ({share(each['directions'])})"

        return Column(f"stand tilted {degrees:g} deg", cell)

    columns = (
        *HEAD,
        ASKED,
        Column("success [95 %]", share_of),
        Column("attempts unsupported", lambda row: share(row["unsupported"])),
        Column("scenes", lambda row: str(row["scenes"])),
        Column("least margin of a scene, mm", _least),
        Column(f"scenes below {1e3 * MIN_MARGIN:g} mm", lambda row: share(row["below"])),
        *(stands(place, each["degrees"]) for place, each in enumerate(angles)),
    )
    notes = (
        "support margin: distance in plan of an object's centre of mass to the edge of the polygon of the "
        "contacts that carry it; of the object of a scene that has least: median [least, 10 %] of scenes",
        "stand tilted: share of scenes in which nothing moves over 5 mm or turns over 5 degrees within 2 s, "
        "in whichever of eight directions gravity is tilted; in brackets, of scenes and directions",
    )
    return [table_of(result["title"], columns, rows, (*notes, *RULES))]


def _least(row: Row) -> str:
    least, tenth, median = (f"{1e3 * each:.1f}" for each in row["margin"])
    return f"{median} [{least}, {tenth}]"


MARGIN = Study("margin", "Support margins and tilted gravity", 64, trials, tables, measure, keeps_each=True)
