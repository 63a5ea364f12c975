"""Pictures of scenes: contact sheets of those that succeeded, and one object's attempts, one by one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps
from pathlib import Path

import jax
import numpy as np

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.resolved import MissingRowError
from cluttergen_jax.evaluation.runner import LEAST_ATTEMPTS, Runner, width_of
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.numerics import new_key
from cluttergen_jax.placement.rollout import EpisodeRecorder, rectangle_of
from cluttergen_jax.rendering.assets import close_points, render_scene
from cluttergen_jax.rendering.figure import closed_loop_figure
from cluttergen_jax.rendering.gl import renderer_status
from cluttergen_jax.rendering.renderer import Trail
from cluttergen_jax.rendering.scene_renderer import PictureConfig, RenderStyle, open_scene_renderer
from cluttergen_jax.rendering.sheet import contact_sheet, save_png
from studies.methods.table1 import CLUTTERGEN, first_seed
from studies.study import Findings, Scale, Study, Successes, successes_of

_SAMPLES = 16
"""Rays per pixel of small pictures."""
_AROUND = [0, 1, 2, 3, 0]
"""Corners of a rectangle one after another, and back to the first."""
_LINE = 0.003
_WHITE = (1.0, 1.0, 1.0)
_TRIED_SCENES = 8
Draw = Callable[..., Findings]


def if_drawable(draw: Draw) -> Draw:
    """Findings of what draws; without a renderer, a note says so."""

    @wraps(draw)
    def findings(*arguments: object) -> Findings:
        can_draw, message = renderer_status()
        return draw(*arguments) if can_draw else Findings(notes=[f"not drawn: {message}"])

    return findings


@if_drawable
def render_regions(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """A success of each table or change, pools by turns, with the region that it was asked for in."""
    groups: dict[tuple[str, str], list[Trial]] = {}
    for trial in trials:
        groups.setdefault((trial.support, trial.change), []).append(trial)
    images = []
    captions = []
    for turn, group in enumerate(groups.values()):
        first = [trial for trial in group if trial.method == group[0].method]
        others = [trial for trial in group if trial not in first]
        start = turn % len(first)
        for trial in (*first[start:], *first[:start], *others):
            try:
                scenes = successes_of(runner, trial)
            except MissingRowError:
                continue
            if len(scenes):
                images.append(_draw_region(runner, trial, scenes))
                change = "" if trial.change == "none" else f", change: {trial.change}"
                captions.append(f"{trial.support_name}, {trial.pool_name}, {trial.method}{change}")
                break
    return sheet(images, captions, stem)


def _draw_region(runner: Runner, trial: Trial, scenes: Successes) -> np.ndarray:
    """uint8[H, W, 3]: the first successful scene and the outline of its region."""
    key = jax.random.fold_in(new_key(trial.seed), int(scenes.index[0]))
    region = rectangle_of(runner.setup(runner.resolve(trial)).rules.begin(key).region)
    height = np.full(len(_AROUND), scenes.world.support.top + _LINE)
    outline = np.column_stack([region.corners[_AROUND], height])
    here = np.flatnonzero(scenes.is_placed[0])
    objects = [scenes.world.objects[k] for k in here]
    poses = scenes.poses[0, here]
    seen = np.concatenate([outline, close_points(objects, poses, None)])
    with open_scene_renderer(
        objects, scenes.world.support, seen, PictureConfig(480, 360, _SAMPLES)
    ) as renderer:
        return renderer.picture(
            [RenderStyle(pose) for pose in poses], [Trail(outline, _WHITE, radius=_LINE)]
        )


def draw_scene(scenes: Successes, scene: int) -> np.ndarray:
    """uint8[H, W, 3]: one of the successful scenes, seen closely."""
    here = np.flatnonzero(scenes.is_placed[scene])
    objects = [scenes.world.objects[k] for k in here]
    poses = scenes.poses[scene, here]
    return render_scene(
        objects, poses, scenes.world.support, close=True, width=480, height=360, samples=_SAMPLES
    )


def sheet(images: Sequence[np.ndarray], captions: Sequence[str], stem: Path) -> Findings:
    """The pictures side by side in STEM.png."""
    if not images:
        return Findings(notes=["no scene to draw"])
    name = f"{stem.name}.png"
    save_png(contact_sheet(list(images), list(captions), columns=3), stem.with_name(name))
    return Findings(pictures=[name])


@if_drawable
def _draw_attempts(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """The picture of an object that failed twice or more on a crowded table, and stood in the end."""
    notes = []
    for trial in trials:
        try:
            arrays = runner.arrays(trial)
        except MissingRowError as error:
            notes.append(f"{trial.method}: {error}")
            continue
        runner.begin(f"closed loop of {trial.title}")
        recorder = None
        for scene in _crowded_scenes(arrays)[:_TRIED_SCENES]:
            if recorder is None:
                resolved = runner.resolve(trial)
                sampler = runner.sampler(resolved)
                world = runner.world(resolved)
                recorder = EpisodeRecorder(sampler, world, width_of(trial.trials))
            try:
                image = closed_loop_figure(recorder.record(trial.seed, int(scene)))
            except ConfigError:
                # Made again alone, a network's sums may differ in the last bit, and the episode with them.
                continue
            name = f"{stem.name}.png"
            save_png(image, stem.with_name(name))
            notes.append(f"{trial.method} on {trial.pool_name}, seed {trial.seed}, scene {scene}")
            return Findings(pictures=[name], notes=notes)
        notes.append(
            f"{trial.method}: in {trial.trials} scenes no object failed twice and then stood"
        )
    return Findings(notes=notes)


def _crowded_scenes(arrays: dict[str, np.ndarray]) -> np.ndarray:
    """Scenes with an object that stood at its third attempt or later, those on the fullest tables first."""
    is_late = arrays["attempt_is_stable"] & (arrays["attempt_ordinal"] >= LEAST_ATTEMPTS)
    scenes = arrays["attempt_scene"][is_late]
    slots = arrays["attempt_slot"][is_late]
    return np.array(list(dict.fromkeys(scenes[np.argsort(-slots, kind="stable")])), int)


def _first_failures(scale: Scale) -> tuple[Trial, ...]:
    """The paper's method; others in its place where it is not trained, or never fails twice and stands."""
    trials = first_seed(scale)
    pool = scale.pools_or(scale.values("office", trials[0].pool))[0]
    of_pool = [trial for trial in trials if trial.pool == pool]
    return tuple(
        t for method in (CLUTTERGEN, "policy", "random") for t in of_pool if t.method == method
    )


CLOSED_LOOP = Study(
    "closed_loop",
    "One object on a crowded table: failed attempts ringed in red, until it stands",
    1000,
    _first_failures,
    measure=_draw_attempts,
)
