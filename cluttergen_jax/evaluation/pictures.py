"""Pictures that need scenes or training runs: plan views, the closed loop, curves, renders."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.checkpoints import MissingCheckpointError
from cluttergen_jax.evaluation.episodes import width_of
from cluttergen_jax.evaluation.lab import Lab
from cluttergen_jax.evaluation.plots import LABELS, add_legend, colour, grid, plan_view, prepare, save
from cluttergen_jax.evaluation.record import LEAST_ATTEMPTS
from cluttergen_jax.evaluation.scenes import Successes, successes_of
from cluttergen_jax.evaluation.suites import Study
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.measures.arrangement import region_positions
from cluttergen_jax.measures.relations import Relation
from cluttergen_jax.render.assets import close_points, render_scene
from cluttergen_jax.render.figure import closed_loop_figure
from cluttergen_jax.render.gl import renderer_status
from cluttergen_jax.render.renderer import Trail
from cluttergen_jax.render.scene_renderer import PictureConfig, RenderStyle, scene_renderer
from cluttergen_jax.render.sheet import contact_sheet, save_png
from cluttergen_jax.sampling.record import Recorder, rectangle_of
from cluttergen_jax.training.metrics_log import read_rows

_MAP_SCENES = 500
_TRIED_SCENES = 8
_EXAMPLES = 6
_SAMPLES = 16
_AROUND = [0, 1, 2, 3, 0]
"""Corners of a rectangle one after another, and back to the first."""
_LINE = 0.003
_WHITE = (1.0, 1.0, 1.0)


def maps(shown: Sequence[tuple[str, Successes]], stem: Path) -> list[str]:
    """Plan views of each object over at most 500 scenes, a row for each method."""
    names = shown[0][1].world.names
    figure, axes = grid(len(shown) * len(names), len(names), 1.25, 1.6)
    panels = iter(axes)
    for method, scenes in shown:
        positions = region_positions(scenes.poses[:_MAP_SCENES], scenes.region)
        for k, name in enumerate(names):
            axis, here = next(panels), scenes.is_placed[:_MAP_SCENES, k]
            if here.any():
                plan_view(axis, positions[here, k], scenes.region, colour(method), name)
            if k == 0:
                axis.set_ylabel(LABELS.get(method, method), fontsize=9)
    return save(figure, stem)


def closed_loop(lab: Lab, study: Study, stem: Path) -> tuple[list[str], list[str]]:
    """The picture of an object that failed twice or more on a crowded table, and stood in the end."""
    can_draw, message = renderer_status()
    if not can_draw:
        return [], [f"not drawn: {message}"]
    notes = []
    for trial in study.trials:
        try:
            arrays = lab.arrays(trial)
        except MissingCheckpointError as error:
            notes.append(f"{trial.method}: {error}")
            continue
        lab.progress.begin(f"closed loop of {trial.title}")
        recorder = None
        for scene in _instructive(arrays)[:_TRIED_SCENES]:
            if recorder is None:
                problem = lab.problem(trial)
                recorder = Recorder(lab.sampler(trial, problem), problem.world, width_of(trial.trials))
            try:
                image = closed_loop_figure(recorder.record(trial.seed, int(scene)))
            except ConfigError:
                # Made again alone, a network's sums may differ in the last bit, and the episode with them.
                continue
            name = f"{stem.name}.png"
            save_png(image, stem.with_name(name))
            return [name], [*notes, f"{trial.method} on {trial.pool_name}, seed {trial.seed}, scene {scene}"]
        notes.append(f"{trial.method}: in {trial.trials} scenes no object failed twice and then stood")
    return [], notes


def _instructive(arrays: dict[str, np.ndarray]) -> np.ndarray:
    """Scenes with an object that stood at its third attempt or later, those on the fullest tables first."""
    tells = arrays["attempt_is_stable"] & (arrays["attempt_ordinal"] >= LEAST_ATTEMPTS)
    scenes, slots = arrays["attempt_scene"][tells], arrays["attempt_slot"][tells]
    return np.array(list(dict.fromkeys(scenes[np.argsort(-slots, kind="stable")])), int)


def learning_curves(lab: Lab, study: Study, stem: Path) -> tuple[list[dict], list[str], list[str]]:
    """Success against attempts of every run that left its progress; dots are evaluated by the last check."""
    folders = {trial: lab.checkpoints.run_folder(trial) for trial in study.trials}
    runs = {trial: folder for trial, folder in folders.items() if folder is not None}
    names = [
        f"{each.pool_name} {each.method} {each.training_seed}" for each in study.trials if each not in runs
    ]
    notes = (
        [f"without a training run (--checkpoints names their folder): {', '.join(names)}"] if names else []
    )
    if not runs:
        return [], [], notes
    pools = list(dict.fromkeys(trial.pool_name for trial in runs))
    figure, axes = grid(len(pools), 3, 3.0, 2.4)
    rows = [_curve(axes[pools.index(trial.pool_name)], trial, folder) for trial, folder in runs.items()]
    for axis, pool in zip(axes, pools, strict=True):
        prepare(axis, pool, "attempts (thousands)", "success while training")
        axis.set_ylim(0, 1.03)
    add_legend(figure)
    return rows, save(figure, stem), notes


def _curve(axis: Any, trial: Trial, folder: Path) -> dict[str, Any]:
    """Draws one run; where it ended."""
    progress, checked = (read_rows(folder / name) for name in ("progress.csv", "evaluations.csv"))
    label = LABELS.get(trial.method, trial.method) if trial.training_seed == 0 else None
    for rows, style in ((progress, {"linewidth": 1.0, "label": label}), (checked, {"marker": "o", "ls": ""})):
        x, y = [row["attempts"] / 1000 for row in rows], [row["success"] for row in rows]
        axis.plot(x, y, color=colour(trial.method), markersize=3, **style)
    return {
        "pool": trial.pool_name,
        "method": trial.method,
        "seed": trial.training_seed,
        "attempts": int(progress[-1]["attempts"]) if progress else 0,
        "success": progress[-1]["success"] if progress else None,
        "checked": checked[-1]["success"] if checked else None,
    }


def renders(lab: Lab, study: Study, stem: Path) -> tuple[list[str], list[str]]:
    """A contact sheet: a success of each table or change, pools by turns."""
    can_draw, message = renderer_status()
    if not can_draw:
        return [], [f"not drawn: {message}"]
    groups: dict[tuple[str, str], list[Trial]] = {}
    for trial in study.trials:
        groups.setdefault((trial.support, trial.change), []).append(trial)
    images, captions = [], []
    for turn, trials in enumerate(groups.values()):
        first = [trial for trial in trials if trial.method == trials[0].method]
        others = [trial for trial in trials if trial not in first]
        turned = turn % len(first)
        for trial in (*first[turned:], *first[:turned], *others):
            try:
                scenes = successes_of(lab, trial)
            except MissingCheckpointError:
                continue
            if len(scenes):
                images.append(outlined(lab, trial, scenes, 0))
                change = "" if trial.change == "none" else f", change: {trial.change}"
                captions.append(f"{trial.support_name}, {trial.pool_name}, {trial.method}{change}")
                break
    return _sheet(images, captions, stem)


def relation_pictures(
    examples: Sequence[tuple[Trial, Successes, np.ndarray]], stem: Path
) -> tuple[list[str], list[str]]:
    """A contact sheet of scenes with relations between objects, as many kinds as there are."""
    can_draw, message = renderer_status()
    if not can_draw:
        return [], [f"not drawn: {message}"]
    found: dict[str, tuple[Successes, int]] = {}
    for kind in (Relation.IN, Relation.UNDER, Relation.LEANING, Relation.ON):
        chosen = 0
        for trial, scenes, among in examples:
            hits = np.argwhere(among == kind)
            if len(hits) and chosen < _EXAMPLES // 3:
                scene, i, j = (int(each) for each in hits[0])
                names = scenes.world.names
                found[f"{names[i]} {kind.label} {names[j]} ({trial.pool_name}, {trial.method})"] = (
                    scenes,
                    scene,
                )
                chosen += 1
    return _sheet([draw(*place) for place in found.values()], list(found), stem)


def draw(scenes: Successes, scene: int) -> np.ndarray:
    """uint8[H, W, 3]: one of the successful scenes, seen closely."""
    here = np.flatnonzero(scenes.is_placed[scene])
    objects = [scenes.world.objects[k] for k in here]
    return render_scene(
        objects,
        scenes.poses[scene, here],
        scenes.world.support,
        close=True,
        width=480,
        height=360,
        samples=_SAMPLES,
    )


def outlined(lab: Lab, trial: Trial, scenes: Successes, scene: int) -> np.ndarray:
    """uint8[H, W, 3]: one of the successful scenes and the outline of the region that it was asked for in."""
    key = jax.random.fold_in(jax.random.key(trial.seed), int(scenes.index[scene]))
    region = rectangle_of(lab.problem(trial).rules.begin(key).region)
    height = np.full(len(_AROUND), scenes.world.support.top + _LINE)
    outline = np.column_stack([region.corners[_AROUND], height])
    here = np.flatnonzero(scenes.is_placed[scene])
    objects, poses = [scenes.world.objects[k] for k in here], scenes.poses[scene, here]
    seen = np.concatenate([outline, close_points(objects, poses, None)])
    with scene_renderer(objects, scenes.world.support, seen, PictureConfig(480, 360, _SAMPLES)) as renderer:
        return renderer.picture([RenderStyle(pose) for pose in poses], [Trail(outline, _WHITE, radius=_LINE)])


def _sheet(images: list[Any], captions: list[str], stem: Path) -> tuple[list[str], list[str]]:
    if not images:
        return [], ["no scene to draw"]
    name = f"{stem.name}.png"
    save_png(contact_sheet(images, captions, columns=3), stem.with_name(name))
    return [name], []
