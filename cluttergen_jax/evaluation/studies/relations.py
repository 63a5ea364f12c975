"""Relations between objects that nobody asked for: on, in, under, leaning against one another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from cluttergen_jax.assets.pool import EMBEDDED
from cluttergen_jax.evaluation.cells import Column, Row, asked, number, table_of
from cluttergen_jax.evaluation.measures.relations import Relation, count_relations, relations
from cluttergen_jax.evaluation.measures.scene_models import SceneModels
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.studies.contact_sheets import SAMPLES, sheet
from cluttergen_jax.evaluation.studies.findings import Findings, Successes, each_standing, row_of
from cluttergen_jax.evaluation.studies.rules import RULES, margin_of, named_rows
from cluttergen_jax.evaluation.studies.study import Result, Scale, Study, grid, of_methods
from cluttergen_jax.evaluation.studies.table1 import CLUTTERGEN, first_seed
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.rendering.assets import render_scene
from cluttergen_jax.rendering.gl import renderer_status
from cluttergen_jax.tables import Table

_EXAMPLES = 2
"""Scenes drawn of each relation."""


def trials(scale: Scale) -> tuple[Trial, ...]:
    """Of table 1: the paper's method, our policy and chance; `guided` and `spread` by their own rules.

    Nobody is asked for a support margin, as in table 1.
    """
    bases = grid(scale.trial(1000, 6), pool=scale.chosen(*EMBEDDED))
    ours = [replace(each, min_margin=0.0) for each in named_rows(bases, "spread", "guided")]
    return (*of_methods(first_seed(scale), CLUTTERGEN, "policy", "random"), *ours)


def measure(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """Counts from contacts, with examples."""
    rows: list[Row] = []
    examples = []
    for trial, scenes in each_standing(runner, trials, rows):
        models = SceneModels(scenes.world)
        relation = relations(models, scenes.poses, scenes.is_placed, num_threads=runner.num_threads)
        among = relation[:, :, :-1]
        pairs = count_relations(relation, scenes.world.names)
        for kind in (Relation.ON, Relation.IN, Relation.UNDER, Relation.LEANING):
            common = [
                (n, a, b) for (label, a, b), n in pairs.items() if label == kind.label and b != "support"
            ]
            rows.append(
                row_of(
                    trial,
                    relation=kind.label,
                    scenes=len(scenes),
                    count=int((among == kind).sum()),
                    scenes_with=int((among == kind).any((1, 2)).sum()),
                    commonest=[
                        {"count": n, "what": f"{a} {kind.label} {b}"}
                        for n, a, b in sorted(common, reverse=True)[:3]
                    ],
                )
            )
        examples.append((trial, scenes, among))
    drawn = _pictures(examples, stem)
    return Findings(rows, drawn.pictures, drawn.notes)


def _pictures(examples: Sequence[tuple[Trial, Successes, np.ndarray]], stem: Path) -> Findings:
    """A contact sheet of scenes with relations between objects, as many kinds as there are."""
    can_draw, message = renderer_status()
    if not can_draw:
        return Findings(notes=[f"not drawn: {message}"])
    found: dict[str, tuple[Successes, int]] = {}
    for kind in (Relation.IN, Relation.UNDER, Relation.LEANING, Relation.ON):
        chosen = 0
        for trial, scenes, among in examples:
            hits = np.argwhere(among == kind)
            if len(hits) and chosen < _EXAMPLES:
                scene, i, j = (int(each) for each in hits[0])
                names = scenes.world.names
                caption = f"{names[i]} {kind.label} {names[j]} ({trial.pool_name}, {trial.method})"
                found[caption] = (scenes, scene)
                chosen += 1
    return sheet([draw(*place) for place in found.values()], list(found), stem)


def draw(scenes: Successes, scene: int) -> np.ndarray:
    """uint8[H, W, 3]: one of the successful scenes, seen closely."""
    here = np.flatnonzero(scenes.is_placed[scene])
    objects, poses = [scenes.world.objects[k] for k in here], scenes.poses[scene, here]
    return render_scene(
        objects, poses, scenes.world.support, close=True, width=480, height=360, samples=SAMPLES
    )


def tables(result: Result) -> list[Table]:
    """Relations per hundred scenes, and the commonest pairs."""
    columns = (
        *asked("pool", "method"),
        Column("relation", lambda row: row.get("relation", "-"), is_asked=True),
        Column("per 100 scenes", lambda row: number(100 * row["count"] / row["scenes"])),
        Column("scenes with one", lambda row: f"{row['scenes_with']} of {row['scenes']}"),
        Column("commonest", _commonest),
    )
    rows = result["measure"]["rows"]
    notes = ("between objects, counted from contacts, in valid scenes", *RULES)
    return [table_of(result["title"] + margin_of(rows), columns, rows, notes)]


def _commonest(row: Row) -> str:
    return "; ".join(f"{each['what']} ({each['count']})" for each in row["commonest"]) or "-"


RELATIONS = Study("relations", "Relations that arise by themselves", 1000, trials, tables, measure)
