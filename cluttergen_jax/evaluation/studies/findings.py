"""Findings of a study's measure: the successful scenes of its trials, and rows about them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.evaluation.cells import Row
from cluttergen_jax.evaluation.measures.arrangement import by_object
from cluttergen_jax.evaluation.resolved import MissingRowError
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.trial import Trial, row_name
from cluttergen_jax.placement.world import World

_ENOUGH = 2


@dataclass(frozen=True, eq=False)
class Successes:
    """The scenes of a trial that stand. N scenes, K objects in the world.

    Attributes:
      world: the trial's; region: its queried region before any change.
      index: i64[N], which of the trial's scenes they are.
      poses: f64[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].
      arrays: everything that was stored (`episodes.arrays_of`), failures included.
    """

    world: World
    region: Rectangle
    index: np.ndarray
    poses: np.ndarray
    is_placed: np.ndarray
    arrays: dict[str, np.ndarray]

    def __len__(self) -> int:
        return len(self.index)

    def first(self, number: int | None) -> Successes:
        """The first so many of them; all for None. `arrays` stay whole."""
        cut = {name: getattr(self, name)[:number] for name in ("index", "poses", "is_placed")}
        return replace(self, **cut)


def successes_of(runner: Runner, trial: Trial) -> Successes:
    """The trial's successful scenes; it is run if need be.

    Raises:
      MissingRowError: they cannot be made; most often its policy has not been trained.
    """
    arrays, resolved = runner.arrays(trial), runner.resolve(trial)
    world = runner.world(resolved)
    poses, is_placed, _ = by_object(
        arrays["object_index"], arrays["is_placed"], arrays["poses"], world.num_objects
    )
    good = arrays["is_success"]
    return Successes(
        world=world,
        region=resolved.region,
        index=np.flatnonzero(good),
        poses=poses[good],
        is_placed=is_placed[good],
        arrays=arrays,
    )


@dataclass(frozen=True)
class Findings:
    """What a measure found: rows for the tables, names of pictures, and notes below them."""

    rows: list[Row] = field(default_factory=list)
    pictures: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def each_standing(
    runner: Runner, trials: Sequence[Trial], rows: list[Row], least: Callable[[Trial], float] | None = None
) -> Iterator[tuple[Trial, Successes]]:
    """The trials with their successful scenes; a row says why where there are too few.

    Args:
      least: scenes that a trial must have; two if not given.
    """
    for trial in trials:
        try:
            scenes = successes_of(runner, trial)
        except MissingRowError as error:
            rows.append(row_of(trial, missing=error.given, hint=error.hint))
            continue
        count = f"{len(scenes)} of {trial.trials} scenes succeed"
        if len(scenes) < _ENOUGH:
            rows.append(row_of(trial, missing=count))
        elif least is not None and len(scenes) < least(trial):
            rows.append(row_of(trial, missing=f"{count}: too few"))
        else:
            yield trial, scenes


def row_of(trial: Trial, **figures: Any) -> Row:
    """A row of findings: what the trial asks, and what was found."""
    margin = {"min_margin": trial.min_margin} if trial.min_margin else {}
    head = {"pool": trial.pool_name, "support": trial.support_name, "method": row_name(asdict(trial))}
    return head | margin | figures
