"""Studies: one table or figure each, its trials at some scale, what is measured of them, how it is shown."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from cluttergen_jax.evaluation.cells import Row
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.studies.findings import Findings
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.tables import Table

Result = dict[str, Any]
"""A study's result as it is stored (`running.run_study`)."""


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
      question: what a row asks of all methods alike, where it is about success; a page then counts where
        another method is as good as `guided`.
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
    question: Callable[[Row], str] | None = None
    depends_on: Callable[[Runner, Trial], Any] = lambda runner, trial: None
