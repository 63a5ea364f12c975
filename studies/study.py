"""Studies: one table or figure each, a grid of trials, columns, and at most one measure of their scenes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.evaluation.comparison import Column, table_of
from cluttergen_jax.evaluation.records import Row
from cluttergen_jax.evaluation.resolved import MissingRowError
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.judging.scene_models import by_object
from cluttergen_jax.placement.world import World
from cluttergen_jax.tables import Table
from studies.rankings import Question
from studies.results import Result, made_rows
from studies.rules import margin_of

_LEAST_SCENES = 2
T = TypeVar("T")


@dataclass(frozen=True)
class Scale:
    """How much is to be done.

    Attributes:
      quick: a look at every table within minutes, at some of its rows; its figures say nothing.
      trials: of every row, whatever the suite says; None leaves it to the suite.
      seeds: training seeds where a table asks for several; 3 if None, 1 if quick.
      pools: names or folders; each study's own if empty.
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

    def number(self, full: int, quick: int) -> int:
        """Trials of a row that has so many in the whole study and in a quick one."""
        return (quick if self.quick else full) if self.trials is None else self.trials

    def trial(self, full: int, quick: int, **fields: Any) -> Trial:
        """A row of so many trials in the whole study and in a quick one."""
        return Trial.of(trials=self.number(full, quick), seed=self.seed, **fields)

    def trial_by_both_counts(self, full: int, quick: int, **fields: Any) -> Trial:
        """A row by both counts, whose attempts run to step 240 as the paper's do."""
        return self.trial(full, quick, whole_attempts=True, paper_count=True, **fields)

    def pools_or(self, *default: str) -> tuple[str, ...]:
        """The pools that were asked for, else a study's own; the first of these alone if quick."""
        return self.pools or default[: self.values(None, 1)]

    def values(self, full: T, quick: T) -> T:
        """What rows differ in, in the whole study and in a quick one."""
        return quick if self.quick else full


def of_methods(trials: Iterable[Trial], *methods: str) -> tuple[Trial, ...]:
    """Those of the trials that are of some methods."""
    return tuple(trial for trial in trials if trial.method in methods)


@dataclass(frozen=True)
class Findings:
    """What a measure found: rows for the tables, names of pictures, and notes below them.

    Attributes:
      tables: made already; of a study with `brings_tables`.
    """

    rows: list[Any] = field(default_factory=list)
    pictures: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)


Measure = Callable[[Any, Sequence[Any], Path], Findings]
"""Of the maker of a study's rows (a `Runner`, say) and its trials; pictures are called like the path."""


def _nothing(*arguments: object) -> None:
    """What decides the findings of a study beside its trials."""


@dataclass(frozen=True)
class Study:
    """One table or figure.

    Attributes:
      name: for `only` and files; title: for people.
      size: trials of each row of the whole study; stated where fewer were made.
      trials: its rows at some `Scale`, in order.
      columns, notes: of its table, or what makes them of the rows; says_margin: its title says which support
        margin was asked for.
      prepare: the lines of its table from the rows; these themselves unless given.
      make_tables: where one such table does not do.
      measure: what is shown in place of the trials' own figures.
      plot: names of the pictures of the trials' rows, written beside the path.
      renders: what is drawn of the trials' scenes beside their rows.
      measured_as: under which name findings are kept; the study's if "".
      keeps_each: the measure keeps its findings trial by trial (`Runner.measure`), not all together.
      brings_tables: the measure makes and keeps the study's rows, and makes its tables.
      question: what a row asks of all methods alike, where it is about success; a page then counts where
        another method is as good as `guided`.
      depends_on: what else beside a trial decides the findings.
      needs_robot: the extras `robot` and `perception` must be there.
    """

    name: str
    title: str
    size: int
    trials: Callable[[Any], Sequence[Any]]
    columns: Sequence[Column] | Callable[[list[Row]], Sequence[Column]] = ()
    notes: Sequence[str] | Callable[[list[Row]], Iterable[str]] = ()
    measure: Measure | None = None
    says_margin: bool = False
    prepare: Callable[[list[Row]], list[Row]] = list
    make_tables: Callable[[Result], list[Table]] | None = None
    plot: Callable[[list[Row], Path], list[str]] | None = None
    renders: Measure | None = None
    measured_as: str = ""
    keeps_each: bool = False
    brings_tables: bool = False
    question: Question | None = None
    depends_on: Callable[[Any, Any], object] = _nothing
    needs_robot: bool = False

    def tables(self, result: Result) -> list[Table]:
        """The tables of a result."""
        if self.make_tables is not None:
            return self.make_tables(result)
        rows = self.prepare(measured_rows(result) if self.measure else result["records"])
        columns = self.columns(rows) if callable(self.columns) else self.columns
        notes = self.notes(rows) if callable(self.notes) else self.notes
        margin = margin_of(rows if self.measure else made_rows(rows)) if self.says_margin else ""
        return [table_of(result["title"] + margin, columns, rows, notes)] if columns else []


def measured_rows(result: Result) -> list[Row]:
    """The rows of a measure's findings."""
    return result["measure"]["rows"] if result["measure"] else []


@dataclass(frozen=True, eq=False)
class Successes:
    """The scenes of a trial that stand. N scenes, K objects in the world.

    Attributes:
      world: the trial's; region: its queried region before any change.
      index: i64[N], which of the trial's scenes they are.
      poses: f64[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].
      arrays: everything that was stored (`runner.arrays_of`), failures included.
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
    arrays = runner.arrays(trial)
    resolved = runner.resolve(trial)
    world = runner.world(resolved)
    good = arrays["is_success"]
    index, filled, slot_poses = (
        arrays[name][good] for name in ("object_index", "is_placed", "poses")
    )
    poses, is_placed, _ = by_object(index, filled, slot_poses, world.num_objects)
    return Successes(world, resolved.region, np.flatnonzero(good), poses, is_placed, arrays)


def each_success(
    runner: Runner, trials: Sequence[Trial], rows: list[Row], least_share: float = 0.0
) -> Iterator[tuple[Trial, Successes]]:
    """The trials with their successful scenes; a row says why where there are fewer than two.

    Args:
      least_share: of its scenes that must succeed.
    """
    for trial in trials:
        try:
            scenes = successes_of(runner, trial)
        except MissingRowError as error:
            rows.append(row_of(trial, missing=error.given, hint=error.hint))
            continue
        count = f"{len(scenes)} of {trial.trials} scenes succeed"
        if len(scenes) < _LEAST_SCENES:
            rows.append(row_of(trial, missing=count))
        elif len(scenes) < least_share * trial.trials:
            rows.append(row_of(trial, missing=f"{count}: too few"))
        else:
            yield trial, scenes


def measure_each(
    find: Callable[[Runner, Trial, Successes], Iterable[Mapping[str, Any]]],
) -> Measure:
    """The measure that finds rows of each trial's successful scenes by themselves."""

    def measure(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
        rows: list[Row] = []
        for trial, scenes in each_success(runner, trials, rows):
            rows += [row_of(trial, figures) for figures in find(runner, trial, scenes)]
        return Findings(rows)

    return measure


def row_of(trial: Trial, /, *found: Mapping[str, Any], **more: Any) -> Row:
    """A row of findings: what the trial asks, and what was found."""
    row: Any = {"pool": trial.pool_name, "support": trial.support_name, "method": trial.row_name}
    row |= {"min_margin": trial.spec.min_margin} if trial.spec.min_margin else {}
    for each in found:
        row |= each
    return row | more
