"""Studies: their trials at some scale, what is measured of them, and how it is shown."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.evaluation.cells import Row
from cluttergen_jax.evaluation.measures.arrangement import by_object
from cluttergen_jax.evaluation.resolved import MissingCheckpointError
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.placement.world import World
from cluttergen_jax.tables import Table


@dataclass(frozen=True, eq=False)
class Successes:
    """The scenes of a trial that stand. N scenes, K objects in the world.

    Attributes:
      world: the trial's; region: its queried region before any change.
      index: i64[N], which of the trial's scenes they are.
      poses: f64[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].
      arrays: everything that was stored (`row.arrays_of`), failures included.
    """

    world: World
    region: Rectangle
    index: np.ndarray
    poses: np.ndarray
    is_placed: np.ndarray
    arrays: dict[str, np.ndarray]

    def __len__(self) -> int:
        return len(self.index)


def successes_of(runner: Runner, trial: Trial) -> Successes:
    """The trial's successful scenes; it is run if need be.

    Raises:
      MissingCheckpointError: its policy has not been trained.
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


Result = dict[str, Any]
"""A study's result as it is stored (`running.run_study`)."""
_ENOUGH = 2


@dataclass(frozen=True)
class Scale:
    """How much is to be done.

    Attributes:
      quick: few trials, for a look at everything within minutes.
      trials: of every row, whatever the suite says; None leaves it to the suite.
      seeds: training seeds of the learned methods where a table asks for several; 3 if None, 1 if quick.
      pools: names or folders; the embedded ones if empty.
      methods: whose rows are made; all if empty.
      seed: of the scenes.
      imported: pools of the authors' own objects that are at hand (`table1.IMPORTED`), and how many
        objects a scene of each has.
    """

    quick: bool = False
    trials: int | None = None
    seeds: int | None = None
    pools: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    seed: int = 0
    imported: tuple[tuple[str, int], ...] = ()

    @property
    def training_seeds(self) -> range:
        """Of learned methods."""
        return range(self.seeds or (1 if self.quick else 3))

    def trial(self, full: int, quick: int, **asked: Any) -> Trial:
        """A row of so many trials in the whole study and in a quick one."""
        number = (quick if self.quick else full) if self.trials is None else self.trials
        return Trial(trials=number, seed=self.seed, **asked)

    def counted_twice(self, full: int, quick: int, **asked: Any) -> Trial:
        """A row by both counts, whose attempts run to step 240 as the paper's do."""
        return self.trial(full, quick, whole_attempts=True, paper_count=True, **asked)

    def chosen(self, *default: str) -> tuple[str, ...]:
        """The pools of a study: those that were asked for, else its own."""
        return self.pools or default


def grid(base: Trial, **varied: Iterable[Any]) -> tuple[Trial, ...]:
    """The trial with every combination of the given fields' values; the last field's vary fastest."""
    return tuple(replace(base, **dict(zip(varied, each, strict=True))) for each in product(*varied.values()))


def of_methods(trials: Iterable[Trial], *methods: str) -> tuple[Trial, ...]:
    """Those of the trials that are of some methods."""
    return tuple(trial for trial in trials if trial.method in methods)


@dataclass(frozen=True)
class Findings:
    """What a measure found: rows for the tables, names of pictures, and notes below them."""

    rows: list[Row] = field(default_factory=list)
    pictures: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


Measure = Callable[[Runner, Sequence[Trial], Path], Findings]
"""Of a study's trials; pictures are called like the path, with an ending."""


@dataclass(frozen=True)
class Study:
    """One table or figure.

    Attributes:
      name: for `only` and files; title: for people.
      size: trials of each row of the whole study; stated where fewer were made.
      trials: its rows, in order.
      tables: of a result.
      measure: what is shown in place of the trials' own figures.
      plot: names of the pictures of the trials' rows, written beside the path.
      renders: what is drawn of the trials' scenes beside their rows.
      measured_as: under which name findings are kept; the study's if "".
      keeps_each: the measure keeps its findings trial by trial (`Runner.measured`), not all together.
      depends_on: what else beside a trial decides the findings.
    """

    name: str
    title: str
    size: int
    trials: Callable[[Scale], tuple[Trial, ...]]
    tables: Callable[[Result], list[Table]]
    measure: Measure | None = None
    plot: Callable[[list[Row], Path], list[str]] | None = None
    renders: Measure | None = None
    measured_as: str = ""
    keeps_each: bool = False
    depends_on: Callable[[Runner, Trial], Any] = lambda runner, trial: None


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
        except MissingCheckpointError as error:
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
    head = {"pool": trial.pool_name, "support": trial.support_name, "method": trial.method}
    return head | margin | figures
