"""Contact sheets of scenes that succeeded."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from cluttergen_jax.evaluation.resolved import MissingRowError
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.studies.findings import Findings, Successes, successes_of
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.numerics import new_key
from cluttergen_jax.placement.rollout.record import rectangle_of
from cluttergen_jax.rendering.assets import close_points
from cluttergen_jax.rendering.gl import renderer_status
from cluttergen_jax.rendering.renderer import Trail
from cluttergen_jax.rendering.scene_renderer import PictureConfig, RenderStyle, scene_renderer
from cluttergen_jax.rendering.sheet import contact_sheet, save_png

SAMPLES = 16
"""Rays per pixel of small pictures."""
_AROUND = [0, 1, 2, 3, 0]
"""Corners of a rectangle one after another, and back to the first."""
_LINE = 0.003
_WHITE = (1.0, 1.0, 1.0)


def renders(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """A success of each table or change, pools by turns."""
    can_draw, message = renderer_status()
    if not can_draw:
        return Findings(notes=[f"not drawn: {message}"])
    groups: dict[tuple[str, str], list[Trial]] = {}
    for trial in trials:
        groups.setdefault((trial.support, trial.change), []).append(trial)
    images, captions = [], []
    for turn, group in enumerate(groups.values()):
        first = [trial for trial in group if trial.method == group[0].method]
        others = [trial for trial in group if trial not in first]
        turned = turn % len(first)
        for trial in (*first[turned:], *first[:turned], *others):
            try:
                scenes = successes_of(runner, trial)
            except MissingRowError:
                continue
            if len(scenes):
                images.append(_outlined(runner, trial, scenes, 0))
                change = "" if trial.change == "none" else f", change: {trial.change}"
                captions.append(f"{trial.support_name}, {trial.pool_name}, {trial.method}{change}")
                break
    return sheet(images, captions, stem)


def _outlined(runner: Runner, trial: Trial, scenes: Successes, scene: int) -> np.ndarray:
    """uint8[H, W, 3]: one of the successful scenes and the outline of the region that it was asked for in."""
    key = jax.random.fold_in(new_key(trial.seed), int(scenes.index[scene]))
    region = rectangle_of(runner.setup(runner.resolve(trial)).rules.begin(key).region)
    height = np.full(len(_AROUND), scenes.world.support.top + _LINE)
    outline = np.column_stack([region.corners[_AROUND], height])
    here = np.flatnonzero(scenes.is_placed[scene])
    objects, poses = [scenes.world.objects[k] for k in here], scenes.poses[scene, here]
    seen = np.concatenate([outline, close_points(objects, poses, None)])
    with scene_renderer(objects, scenes.world.support, seen, PictureConfig(480, 360, SAMPLES)) as renderer:
        return renderer.picture([RenderStyle(pose) for pose in poses], [Trail(outline, _WHITE, radius=_LINE)])


def sheet(images: Sequence[Any], captions: Sequence[str], stem: Path) -> Findings:
    """The pictures side by side in STEM.png."""
    if not images:
        return Findings(notes=["no scene to draw"])
    name = f"{stem.name}.png"
    save_png(contact_sheet(list(images), list(captions), columns=3), stem.with_name(name))
    return Findings(pictures=[name])
