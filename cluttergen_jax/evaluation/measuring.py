"""What is looked at beside the trials' own figures: measures of scenes, pictures, times.

Each function takes the lab, a study and the folder for pictures, and returns JSON: `rows` (one dict each),
`pictures` (file names in that folder) and `notes`.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.errors import MissingExtraError
from cluttergen_jax.evaluation.checkpoints import MissingCheckpointError
from cluttergen_jax.evaluation.lab import Lab
from cluttergen_jax.evaluation.pictures import closed_loop, learning_curves, maps, relation_pictures, renders
from cluttergen_jax.evaluation.proportion import wilson
from cluttergen_jax.evaluation.scenes import Successes, successes_of
from cluttergen_jax.evaluation.suites import Study
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.measures.acceptance import acceptance_bias
from cluttergen_jax.measures.contacts import contacts_of
from cluttergen_jax.measures.diversity import (
    at_equal_count,
    nearest_distance,
    plan_box_area,
    plan_entropy,
    scene_kernel,
    vendi_score,
)
from cluttergen_jax.measures.embedding import embed
from cluttergen_jax.measures.relations import Relation, count_relations, relations
from cluttergen_jax.measures.robustness import CREEP_SECONDS, creep, shake, survives
from cluttergen_jax.measures.scene_models import SceneModels
from cluttergen_jax.measures.survival import PEERS, SURVIVAL_SECONDS, movement_elsewhere
from cluttergen_jax.measures.tilt import TiltConfig, tilt
from cluttergen_jax.placement.config import MIN_MARGIN
from cluttergen_jax.types import Verdict

Found = dict[str, Any]
Measure = Callable[[Lab, Study, Path], Found]
KEPT_BY_ROW = ("robustness", "survival", "margin")
"""Measures so long that each row is kept by itself (`Lab.measured`) instead of all of them together."""
_ENOUGH = 2
_LEAST_SHARE = 0.25


def found(rows: list[dict], pictures: list[str] | None = None, notes: list[str] | None = None) -> Found:
    """The form that every measure returns."""
    return {"rows": rows, "pictures": pictures or [], "notes": notes or []}


def each_standing(lab: Lab, study: Study, rows: list[dict]) -> Iterator[tuple[Trial, Successes]]:
    """The study's trials with their successful scenes; a row says why where there are too few."""
    for trial in study.trials:
        try:
            scenes = successes_of(lab, trial)
        except MissingCheckpointError as error:
            rows.append(_row(trial, missing=error.given, hint=error.hint))
            continue
        if len(scenes) < _ENOUGH:
            rows.append(_row(trial, missing=f"{len(scenes)} of {trial.trials} scenes succeed"))
            continue
        yield trial, scenes


def _row(trial: Trial, **figures: Any) -> dict[str, Any]:
    asked = {"min_margin": trial.min_margin} if trial.min_margin else {}
    head = {"pool": trial.pool_name, "support": trial.support_name, "method": trial.method}
    return head | asked | figures


def diversity_maps(lab: Lab, study: Study, folder: Path) -> Found:
    """Plan views of each object, methods side by side, with the paper's bounding boxes."""
    rows: list[dict] = []
    shown = []
    for trial, scenes in each_standing(lab, study, rows):
        boxes = plan_box_area(scenes.poses, scenes.is_placed, scenes.region)
        entropy = plan_entropy(scenes.poses, scenes.is_placed, scenes.region)
        shown.append((trial.method, scenes))
        for k, name in enumerate(scenes.world.names):
            rows.append(
                _row(
                    trial,
                    object=name,
                    scenes=len(scenes),
                    box_area=_finite(boxes[k]),
                    evenness=_finite(entropy.evenness[k]),
                )
            )
    return found(rows, maps(shown, folder / f"{study.name}") if shown else [])


def diversity(lab: Lab, study: Study, folder: Path) -> Found:
    """Spatial entropy, nearest neighbours, Vendi score and boxes, all methods at equal counts."""
    rows: list[dict] = []
    groups: dict[tuple[str, str], list[tuple[Trial, Successes]]] = {}
    for trial, scenes in each_standing(lab, study, rows):
        if len(scenes) < trial.trials * _LEAST_SHARE:
            # A method that hardly ever succeeds would leave the others too few scenes to be compared.
            rows.append(_row(trial, missing=f"{len(scenes)} of {trial.trials} scenes succeed: too few"))
            continue
        groups.setdefault((trial.pool_name, trial.support_name), []).append((trial, scenes))
    for group in groups.values():
        count = min(len(scenes) for _, scenes in group)
        rows += [_row(trial, **_diversity_of(scenes, count)) for trial, scenes in group]
    return found(
        rows, notes=["Figures depend on the number of scenes: each group is compared at equal counts."]
    )


def _diversity_of(scenes: Successes, count: int) -> dict[str, Any]:
    world, region = scenes.world, scenes.region
    vectors = embed(world.objects, scenes.poses, scenes.is_placed, region, world.support.top)

    def mean(measure: Callable[[np.ndarray], float]) -> float | None:
        return _finite(at_equal_count(measure, len(scenes), count)[0])

    return {
        "scenes": count,
        "evenness": mean(
            lambda some: np.nanmean(plan_entropy(scenes.poses[some], scenes.is_placed[some], region).evenness)
        ),
        "nearest": mean(lambda some: nearest_distance(vectors[some]).mean()),
        "vendi": mean(lambda some: vendi_score(scene_kernel(vectors[some], region))),
        "box_area": mean(
            lambda some: np.nanmean(plan_box_area(scenes.poses[some], scenes.is_placed[some], region))
        ),
    }


def acceptance(lab: Lab, study: Study, folder: Path) -> Found:
    """Lifts of objects, places, turns and slots: every proposal, and those that stand in valid scenes."""
    rows: list[dict] = []
    for trial, scenes in each_standing(lab, study, rows):
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
            rows.append(
                _row(
                    trial,
                    sorting=sorting,
                    under=[
                        {
                            "label": bias.labels[c],
                            "lift": float(bias.lift[c]),
                            "low95": float(bias.low[c]),
                            "high95": float(bias.high[c]),
                        }
                        for c in (bias.labels.index(label) for label in bias.under_represented)
                    ],
                    proposals=int(bias.proposed.sum()),
                    passed=int(bias.passed.sum()),
                )
            )
    return found(rows)


def robustness(lab: Lab, study: Study, folder: Path) -> Found:
    """Creep over 1, 10 and 60 s, shaking, and changed physics."""
    rows: list[dict] = []
    for trial, scenes in each_standing(lab, study, rows):
        rows.append(_row(trial, **lab.measured(trial, "robustness", partial(_robustness_of, lab, scenes))))
    return found(rows)


def _robustness_of(lab: Lab, scenes: Successes) -> dict[str, Any]:
    models = SceneModels(scenes.world)
    arrays = (scenes.poses, scenes.is_placed)
    moved = creep(models, *arrays, num_threads=lab.num_threads)
    scores = shake(models, *arrays, num_threads=lab.num_threads).min(1)
    standing = survives(models, *arrays, num_threads=lab.num_threads)
    return {
        "scenes": len(scenes),
        "creep": [
            {
                "seconds": seconds,
                "median_shift": _finite(np.median(moved.largest_shift[:, h])),
                **_share(moved.survives()[:, h]),
            }
            for h, seconds in enumerate(CREEP_SECONDS)
        ],
        "shake": [float(each) for each in np.percentile(scores, [10, 50, 90])],
        "changes": {name: _share(each) for name, each in standing.items()},
    }


def margin(lab: Lab, study: Study, folder: Path) -> Found:
    """Support margins of finished scenes, and what tilted gravity topples."""
    rows: list[dict] = []
    for trial, scenes in each_standing(lab, study, rows):
        figures = lab.record(trial)["figures"]
        success = {name: figures[name] for name in ("success", "low95", "high95")}
        measured = lab.measured(trial, "margins", partial(_margins_of, lab, scenes))
        measured |= lab.measured(trial, "tilt", partial(_tilt_of, lab, scenes))
        unsupported = figures["verdicts"].get(Verdict.UNSUPPORTED.label, 0) / figures["attempts"]
        rows.append(_row(trial, **success, unsupported=unsupported, **measured))
    return found(rows)


def _margins_of(lab: Lab, scenes: Successes) -> dict[str, Any]:
    models = SceneModels(scenes.world)
    margins = contacts_of(models, scenes.poses, scenes.is_placed, lab.num_threads).margin
    least = np.nanmin(margins, axis=1)
    return {
        "scenes": len(scenes),
        "margin": [float(each) for each in np.percentile(least, [0, 10, 50])],
        "below": float((least < MIN_MARGIN).mean()),
    }


def _tilt_of(lab: Lab, scenes: Successes) -> dict[str, Any]:
    models, config = SceneModels(scenes.world), TiltConfig()
    stands = tilt(models, scenes.poses, scenes.is_placed, config, lab.num_threads)
    return {
        "tilt": [
            {"degrees": by, "directions": float(share.mean()), **_share(share == 1)}
            for by, share in zip(config.degrees, stands.T, strict=True)
        ],
    }


def survival(lab: Lab, study: Study, folder: Path) -> Found:
    """The share of scenes that stand 10 s in PyBullet and in Drake, where they are installed."""
    rows: list[dict] = []
    notes: dict[str, None] = {}
    for trial, scenes in each_standing(lab, study, rows):
        for engine in PEERS:
            try:
                stood = lab.measured(
                    trial, f"survival in {engine}", partial(_survival_of, lab, scenes, engine)
                )
            except MissingExtraError as error:
                notes[f"{engine}: {error}"] = None
                continue
            rows.append(_row(trial, engine=engine, **stood))
    return found(rows, notes=list(notes))


def _survival_of(lab: Lab, scenes: Successes, engine: str) -> dict[str, Any]:
    movement = movement_elsewhere(
        engine, SceneModels(scenes.world), scenes.poses, scenes.is_placed, num_threads=lab.num_threads
    )
    return {
        "seconds": SURVIVAL_SECONDS[0],
        "scenes": len(scenes),
        "median_shift": _finite(np.median(movement.largest_shift[:, 0])),
        **_share(movement.survives()[:, 0]),
    }


def relation_counts(lab: Lab, study: Study, folder: Path) -> Found:
    """How often objects stand on, in, under or against one another, per hundred scenes, with examples."""
    rows: list[dict] = []
    examples = []
    for trial, scenes in each_standing(lab, study, rows):
        relation = relations(
            SceneModels(scenes.world), scenes.poses, scenes.is_placed, num_threads=lab.num_threads
        )
        among = relation[:, :, :-1]
        pairs = count_relations(relation, scenes.world.names)
        for kind in (Relation.ON, Relation.IN, Relation.UNDER, Relation.LEANING):
            common = [
                (n, a, b) for (label, a, b), n in pairs.items() if label == kind.label and b != "support"
            ]
            rows.append(
                _row(
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
    pictures, notes = relation_pictures(examples, folder / study.name)
    return found(rows, pictures, notes)


def timing(lab: Lab, study: Study, folder: Path) -> Found:
    """Each trial in a process of its own, from start to finish: on one core, and on all of them."""
    rows = []
    for trial in study.trials:
        try:
            checkpoint = lab.checkpoints.find(trial)
        except MissingCheckpointError as error:
            rows.append(_row(trial, missing=error.given, hint=error.hint))
            continue
        for cores in dict.fromkeys((1, os.cpu_count() or 1)):
            lab.progress.begin(f"time of {trial.title} on {cores} cores")
            order = {"trial": asdict(trial), "cores": cores, "engine": lab.engine}
            order["checkpoint"] = None if checkpoint is None else str(checkpoint)
            rows.append(_row(trial, **_timed(order)))
    return found(rows)


def _timed(order: dict[str, Any]) -> dict[str, Any]:
    """What `timing.main` prints, run in a process that sees so many cores."""
    command = [sys.executable, "-m", "cluttergen_jax.evaluation.timing", json.dumps(order)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        return {"missing": f"the timed process failed: {done.stderr.strip().splitlines()[-1:]}"}
    return json.loads(done.stdout.splitlines()[-1])


def _share(good: np.ndarray) -> dict[str, float]:
    low, high = wilson(int(good.sum()), len(good))
    return {"share": float(good.mean()), "low95": low, "high95": high}


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


MEASURES: dict[str, Measure] = {
    "diversity_maps": diversity_maps,
    "closed_loop": lambda lab, study, folder: found([], *closed_loop(lab, study, folder / study.name)),
    "learning_curves": lambda lab, study, folder: found(*learning_curves(lab, study, folder / study.name)),
    "renders": lambda lab, study, folder: found([], *renders(lab, study, folder / study.name)),
    "relations": relation_counts,
    "diversity": diversity,
    "acceptance": acceptance,
    "robustness": robustness,
    "survival": survival,
    "margin": margin,
    "timing": timing,
}
