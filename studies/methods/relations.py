"""Relations between objects that nobody asked for: on, in, under, leaning against one another."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cluttergen_jax.assets.pool import EMBEDDED
from cluttergen_jax.evaluation.comparison import Column, number, request_columns
from cluttergen_jax.evaluation.records import Row
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.trial import Trial, grid
from cluttergen_jax.judging.scene_models import SceneModels
from studies.measures.relations import Relation, count_relations, relations
from studies.methods.pictures import draw_scene, if_drawable, sheet
from studies.methods.table1 import CLUTTERGEN, first_seed
from studies.rules import RULES, named_rows
from studies.study import Findings, Scale, Study, Successes, each_success, of_methods, row_of

_EXAMPLES = 2
"""Scenes drawn of each relation."""


def trials(scale: Scale) -> tuple[Trial, ...]:
    """Of table 1: the paper's method, our policy and chance; `guided` and `spread` by their own rules.

    Nobody is asked for a support margin, as in table 1.
    """
    bases = grid(scale.trial(1000, 6), pool=scale.pools_or(*EMBEDDED))
    ours = [each.replace(min_margin=0.0) for each in named_rows(bases, "spread", "guided")]
    return (*of_methods(first_seed(scale), CLUTTERGEN, "policy", "random"), *ours)


def measure(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """Counts from contacts, with examples."""
    rows: list[Row] = []
    examples = []
    for trial, scenes in each_success(runner, trials, rows):
        models = SceneModels(scenes.world)
        relation = relations(models, scenes.poses, scenes.is_placed, num_threads=runner.num_threads)
        among = relation[:, :, :-1]
        pairs = count_relations(relation, scenes.world.names)
        for kind in (Relation.ON, Relation.IN, Relation.UNDER, Relation.LEANING):
            common = [
                (n, a, b)
                for (label, a, b), n in pairs.items()
                if label == kind.label and b != "support"
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


@if_drawable
def _pictures(examples: Sequence[tuple[Trial, Successes, np.ndarray]], stem: Path) -> Findings:
    """A contact sheet of scenes with relations between objects, as many kinds as there are."""
    found: dict[str, tuple[Successes, int]] = {}
    for kind in (Relation.IN, Relation.UNDER, Relation.LEANING, Relation.ON):
        number_drawn = 0
        for trial, scenes, among in examples:
            hits = np.argwhere(among == kind)
            if len(hits) and number_drawn < _EXAMPLES:
                scene, i, j = (int(each) for each in hits[0])
                names = scenes.world.names
                caption = f"{names[i]} {kind.label} {names[j]} ({trial.pool_name}, {trial.method})"
                found[caption] = (scenes, scene)
                number_drawn += 1
    return sheet([draw_scene(*place) for place in found.values()], list(found), stem)


RELATIONS = Study(
    "relations",
    "Relations that arise by themselves",
    1000,
    trials,
    (
        *request_columns("pool", "method"),
        Column("relation", lambda row: row.get("relation", "-"), is_asked=True),
        Column("per 100 scenes", lambda row: number(100 * row["count"] / row["scenes"])),
        Column("scenes with one", lambda row: f"{row['scenes_with']} of {row['scenes']}"),
        Column(
            "commonest",
            lambda row: (
                "; ".join(f"{each['what']} ({each['count']})" for each in row["commonest"]) or "-"
            ),
        ),
    ),
    ("between objects, counted from contacts, in valid scenes", *RULES),
    measure,
    says_margin=True,
)
