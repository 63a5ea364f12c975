"""Picture of closed-loop placement: one object's failed attempts on a crowded table, until it stands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.episodes import LEAST_ATTEMPTS, width_of
from cluttergen_jax.evaluation.resolved import MissingRowError
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.studies.findings import Findings
from cluttergen_jax.evaluation.studies.study import Scale, Study
from cluttergen_jax.evaluation.studies.table1 import CLUTTERGEN, first_seed
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.placement.rollout.record import Recorder
from cluttergen_jax.rendering.figure import closed_loop_figure
from cluttergen_jax.rendering.gl import renderer_status
from cluttergen_jax.rendering.sheet import save_png

_TRIED_SCENES = 8


def measure(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """The picture of an object that failed twice or more on a crowded table, and stood in the end."""
    can_draw, message = renderer_status()
    if not can_draw:
        return Findings(notes=[f"not drawn: {message}"])
    notes = []
    for trial in trials:
        try:
            arrays = runner.arrays(trial)
        except MissingRowError as error:
            notes.append(f"{trial.method}: {error}")
            continue
        runner.begin(f"closed loop of {trial.title}")
        recorder = None
        for scene in _instructive(arrays)[:_TRIED_SCENES]:
            if recorder is None:
                resolved = runner.resolve(trial)
                sampler, world = runner.sampler(resolved), runner.world(resolved)
                recorder = Recorder(sampler, world, width_of(trial.trials))
            try:
                image = closed_loop_figure(recorder.record(trial.seed, int(scene)))
            except ConfigError:
                # Made again alone, a network's sums may differ in the last bit, and the episode with them.
                continue
            name = f"{stem.name}.png"
            save_png(image, stem.with_name(name))
            notes.append(f"{trial.method} on {trial.pool_name}, seed {trial.seed}, scene {scene}")
            return Findings(pictures=[name], notes=notes)
        notes.append(f"{trial.method}: in {trial.trials} scenes no object failed twice and then stood")
    return Findings(notes=notes)


def _instructive(arrays: dict[str, np.ndarray]) -> np.ndarray:
    """Scenes with an object that stood at its third attempt or later, those on the fullest tables first."""
    tells = arrays["attempt_is_stable"] & (arrays["attempt_ordinal"] >= LEAST_ATTEMPTS)
    scenes, slots = arrays["attempt_scene"][tells], arrays["attempt_slot"][tells]
    return np.array(list(dict.fromkeys(scenes[np.argsort(-slots, kind="stable")])), int)


def trials(scale: Scale) -> tuple[Trial, ...]:
    """The paper's method; others in its place where it is not trained, or never fails twice and stands."""
    wanted = (CLUTTERGEN, "policy", "random")
    pool = scale.chosen("office")[0]
    return tuple(
        trial
        for method in wanted
        for trial in first_seed(scale)
        if (trial.method, trial.pool) == (method, pool)
    )


CLOSED_LOOP = Study(
    "closed_loop",
    "One object on a crowded table: failed attempts ringed in red, until it stands",
    1000,
    trials,
    lambda result: [],
    measure,
)
