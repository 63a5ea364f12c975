"""Robust scenes: what asking for them costs, and what they withstand that others do not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from cluttergen_jax.assets.pool import ALL
from cluttergen_jax.config import TRUSTED_METHODS
from cluttergen_jax.errors import MissingExtraError
from cluttergen_jax.evaluation.cells import (
    EFFORT_NOTES,
    Column,
    Row,
    asked,
    per_valid_scene,
    share_of,
    table_of,
)
from cluttergen_jax.evaluation.measures.robustness import RobustConfig, robust
from cluttergen_jax.evaluation.measures.scene_models import SceneModels
from cluttergen_jax.evaluation.measures.survival import PEERS
from cluttergen_jax.evaluation.rivals import share_notes
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.studies import margin, survival
from cluttergen_jax.evaluation.studies.diversity import TIGHT
from cluttergen_jax.evaluation.studies.findings import Findings, Successes, each_standing, row_of
from cluttergen_jax.evaluation.studies.rules import RULES, margin_of, named_rows
from cluttergen_jax.evaluation.studies.study import Result, Scale, Study
from cluttergen_jax.evaluation.trial import ROBUST, Trial
from cluttergen_jax.statistics import proportion
from cluttergen_jax.tables import Table

ROWS = tuple(
    name for method in ("drop, ruin", "spread", "guided") for name in (method, f"{method}, {ROBUST}")
)
"""Each method without and with robust scenes asked for."""
STACKED = "stack=3"
"""Clutter of the rows with objects on others, of the methods that can be asked for it."""
DEGREES = (2.0, 5.0)
"""Tilts that are shown, of those that are measured."""
_MOST = {"drake": {10: 32, 30: 8}}
"""Scenes that are simulated in an engine, by their number of objects, where that takes minutes a scene."""
_CROWD = 30
"""Objects of the crowded rows. Each of their scenes takes more than ten times as long to tilt and to simulate
elsewhere, so that they have a quarter of the trials."""


def trials(scale: Scale) -> tuple[Trial, ...]:
    """Ten objects on a tight table, thirty of every pool on the paper's, and ten with some on others."""
    base = scale.trial(256, 4)
    tight = [replace(base, pool=pool, support=TIGHT) for pool in scale.chosen("dining")]
    stacked = [replace(each, clutter=STACKED) for each in tight]
    crowd = replace(base, pool=ALL, num_objects=_CROWD, trials=-(-base.trials // 4))
    return (
        *named_rows([*tight, crowd], *ROWS),
        *named_rows(stacked, *(name for name in ROWS if name.split(", ")[0] in TRUSTED_METHODS)),
    )


def measure(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """Success and cost of every trial; of its scenes, tilt, `robust` and survival in other engines."""
    rows: list[Row] = []
    notes: dict[str, None] = {}
    for trial, scenes in each_standing(runner, trials, rows):
        found: Row = {"objects": trial.num_objects, "figures": runner.row(trial)["figures"]}
        tilted = runner.measured(trial, "tilt", partial(margin.tilt_figures, scenes, runner.num_threads))
        found["tilt"] = [each for each in tilted["tilt"] if each["degrees"] in DEGREES]
        found[ROBUST] = runner.measured(trial, ROBUST, partial(_robust, scenes, runner.num_threads))
        found["survival"] = {}
        for engine in PEERS:
            most = _MOST.get(engine, {}).get(trial.num_objects)
            make = partial(survival.figures_in, scenes.first(most), engine, runner.num_threads)
            try:
                found["survival"][engine] = runner.measured(trial, f"survival in {engine}", make)
            except MissingExtraError as error:
                notes[f"{engine}: {error}"] = None
        rows.append(row_of(trial, **found))
    return Findings(rows, notes=list(notes))


def _robust(scenes: Successes, num_threads: int) -> dict[str, Any]:
    models = SceneModels(scenes.world)
    return proportion(robust(models, scenes.poses, scenes.is_placed, num_threads=num_threads))


def tables(result: Result) -> list[Table]:
    """A line for each method and problem, with robust scenes asked for and without."""
    rows = result["measure"]["rows"]
    made = [row for row in rows if "missing" not in row]
    engines = dict.fromkeys(engine for row in made for engine in row["survival"])

    def tilted(place: int, degrees: float) -> Column:
        heading = f"stand tilted {degrees:g} deg, every direction"
        return Column(heading, lambda row: share_of(row["tilt"][place], "share"))

    def survives(engine: str) -> Column:
        return Column(f"stands 10 s in {engine}", lambda row: _survival(row, engine))

    columns = (
        *asked("pool", support="table"),
        Column("objects", lambda row: str(row.get("objects", "-")), is_asked=True),
        *asked("method"),
        Column("success [95 %]", lambda row: share_of(row["figures"])),
        Column("attempts per valid scene", lambda row: per_valid_scene(row, "attempts", 1)),
        Column("simulated steps per valid scene", lambda row: per_valid_scene(row, "simulated_steps", 0)),
        *(tilted(*each) for each in enumerate(DEGREES)),
        Column(ROBUST, lambda row: share_of(row[ROBUST], "share")),
        *map(survives, engines),
    )
    config = RobustConfig()
    notes = (
        f"`, {ROBUST}`: what is placed must also stand under a slight tilt with less "
        "friction and softer contacts (`--robust`)",
        "stand tilted: share of scenes in which nothing moves over 5 mm or turns over 5 degrees within 2 s, "
        "whichever of eight directions gravity is tilted in",
        f"{ROBUST}: nothing moves over 5 mm in plan or turns over 5 degrees with gravity tilted by "
        f"{config.degrees:g} degrees in {config.num_directions} directions, {config.friction:g} of the "
        "friction and MuJoCo's default contact",
        f"rows of {_CROWD} objects have a quarter of the trials; Drake has the first "
        f"{_MOST['drake'][10]} scenes that stand, {_MOST['drake'][_CROWD]} of {_CROWD} objects",
        EFFORT_NOTES[1],
        *RULES,
        *share_notes(
            [{**row, **row[ROBUST]} for row in made if STACKED not in row["method"]],
            lambda row: f"{ROBUST}, {row['pool']}, {row['objects']} objects",
        ),
    )
    return [table_of(result["title"] + margin_of(made), columns, rows, notes)]


def _survival(row: Row, engine: str) -> str:
    found = row["survival"].get(engine)
    return share_of(found, "share") if found else "-"


STABILITY = Study(
    "stability", "Robust scenes, asked for and not", 256, trials, tables, measure, keeps_each=True
)
