"""Clutter targets: how many objects should rest on others, how many do, and what that costs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cluttergen_jax.evaluation.comparison import SUCCESS, Column, number, request_columns
from cluttergen_jax.evaluation.records import Row
from cluttergen_jax.evaluation.resolved import MissingRowError
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.trial import Trial, grid
from cluttergen_jax.placement.clutter import Clutter
from studies.cells import EFFORT, EFFORT_NOTES
from studies.methods.pictures import draw_scene, if_drawable, sheet
from studies.rankings import OURS, TWIN, success_notes
from studies.results import made_rows
from studies.rules import own_rules
from studies.study import Findings, Scale, Study, successes_of

STACKS = range(6)
"""Objects that should rest on others, of ten."""


def trials(scale: Scale) -> tuple[Trial, ...]:
    """Nothing asked for, then from none to half of the objects, by both methods that can be asked."""
    rows = grid(
        scale.trial(256, 4),
        pool=scale.pools_or("dining"),
        method=(OURS, TWIN),
        clutter=(None, *(f"stack={each}" for each in STACKS)),
    )
    return tuple(map(own_rules, rows))


def _with_targets(rows: list[Row]) -> list[Row]:
    """Rows of one target are compared by their methods."""
    return [
        Row(row, trial={**row["trial"], "clutter": ""}, target=_target(row))  # type: ignore[misc]
        for row in rows
    ]


def _target(row: Row) -> float | None:
    text = row["trial"]["clutter"]
    return Clutter.of(text).stack if text else None


def _target_text(row: Row) -> str:
    return "nothing" if row["target"] is None else f"{row['target']:g}"


def _error(row: Row) -> str:
    stack = row["target"]
    got = row["figures"]["stack"]["mean"]
    return f"{got / stack - 1:+.0%}" if stack and got is not None else "-"


@if_drawable
def _render(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """A scene for each number of objects on others, from tidy to heap: one that has as many as were asked."""
    images: list[np.ndarray] = []
    captions: list[str] = []
    for trial in (each for each in trials if each.spec.clutter):
        stack = Clutter.of(trial.spec.clutter or "stack=0").stack or 0
        try:
            # Both methods follow the target; the first one that is there is drawn.
            scenes = successes_of(runner, trial)
        except MissingRowError:
            continue
        caption = f"asked {stack:g}"
        if not len(scenes) or any(each.startswith(f"{caption}:") for each in captions):
            continue
        got = (scenes.arrays["level"][scenes.index] > 0).sum(1)
        best = int(np.argmin(np.abs(got - stack)))
        images.append(draw_scene(scenes, best))
        captions.append(f"{caption}: {got[best]} on others ({trial.pool_name}, {trial.method})")
    return sheet(images, captions, stem)


def _notes(rows: list[Row]) -> list[str]:
    return [
        "objects on others: those that rest on another object, counted from contacts, in valid scenes",
        "error: of what was got, in parts of what was asked",
        *EFFORT_NOTES,
        *success_notes(
            made_rows(rows), lambda row: f"{row['trial']['pool']}, asked {_target_text(row)}"
        ),
    ]


CLUTTER_TARGETS = Study(
    "dial",
    "Ten objects, so many of them on others",
    256,
    trials,
    (
        *request_columns("pool", "method"),
        Column("objects on others, asked", _target_text, is_asked=True),
        Column("got, mean of scenes", lambda row: number(row["figures"]["stack"]["mean"], 2)),
        Column("standard deviation", lambda row: number(row["figures"]["stack"]["std"], 2)),
        Column("error", _error),
        SUCCESS,
        *EFFORT,
    ),
    _notes,
    says_margin=True,
    prepare=_with_targets,
    renders=_render,
    measured_as="renders of the dial",
)
