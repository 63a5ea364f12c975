"""`cluttergen evaluate`: methods side by side, or a whole suite of tables and figures."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from cluttergen_jax.cli.parse import refuse_given
from cluttergen_jax.config import Change, Engine, Method, Suite

_ARGUMENTS = {"attempts": "max_attempts", "threads": "num_threads"}
_OF_SUITES = ("only", "quick", "seeds")
_OF_COMPARISONS = ("exclude", "supports", "num_objects", "attempts", "repeat", "change")


@dataclass(frozen=True)
class Evaluate:
    """Compare methods on pools and supports, or make a suite of tables and figures (`--suite`).

    A comparison writes table.md, table.csv, table.tex and results.json; a suite writes Markdown, CSV, LaTeX,
    JSON and pictures for each of its studies. Every row is kept under `results` in that folder: the same
    command takes an interrupted one up again.

    Example: `cluttergen evaluate --methods clear drop --supports table table-0.40x0.50 --trials 200`

    Attributes:
      methods: random, clear, drop (these three if not given), and trained policies: policy, policy-clear,
        ranked, beta, normal, open_loop, short_memory. Of a suite, the rows that are made; all if not given.
      checkpoint: the policy's folder, for learned methods; else the embedded ones are taken.
      checkpoints: a folder of training runs, POOL-VARIANT[-attemptsA][-SEED], instead of the embedded ones.
      pools: names or folders, or several joined by +; dining if not given, and what each study asks for in a
        suite.
      exclude: names of objects to leave out of each pool; --exclude mug is the same as --pools dining~mug.
      supports: names or folders; table-0.40x0.50 is a cuboid of that size, all of it the queried region.
      num_objects: objects per scene.
      trials: scenes per row; 1000 if not given, and what each study asks for in a suite.
      seed: of the scenes.
      attempts: per object.
      repeat: let objects stand there more than once.
      change: how the queried region is changed at random in every episode: none, translation, rotation,
        shrinkage, expansion or all.
      suite: paper (its tables and figures) or extended (what it does not ask); supports, num_objects,
        attempts, repeat and change are then the studies' own.
      only: names of studies of the suite; all of them if not given.
      quick: a few trials a row: the whole paper suite in minutes.
      seeds: training seeds where a table asks for several, 3 if not given, 1 if quick; those without a
        checkpoint are left out.
      engine: auto, native, warp or jax.
      threads: simulation threads; 0 takes every core.
      fresh: make rows again that are at hand.
      out: where everything goes; out/evaluation, or out/SUITE, if not given.
    """

    methods: tuple[Method, ...] = ()
    checkpoint: str | None = None
    checkpoints: str | None = None
    pools: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    supports: tuple[str, ...] = ("table",)
    num_objects: int = 10
    trials: int | None = None
    seed: int = 0
    attempts: int = 5
    repeat: bool = False
    change: Change = "none"
    suite: Suite | None = None
    only: tuple[str, ...] = ()
    quick: bool = False
    seeds: int | None = None
    engine: Engine = "auto"
    threads: int = 0
    fresh: bool = False
    out: str | None = None

    def run(self) -> int:
        """Runs the command; the exit status."""
        if self.suite is None:
            refuse_given(self, _OF_SUITES, "without a suite", "--suite paper or --suite extended")
        else:
            refuse_given(self, _OF_COMPARISONS, "with a suite", "leaving it out: each study has its own")
        return self._compare() if self.suite is None else self._make_suite()

    def _given(self, without: Sequence[str]) -> dict[str, Any]:
        """The options as keyword arguments."""
        names = (each.name for each in dataclasses.fields(self) if each.name not in without)
        return {_ARGUMENTS.get(name, name): getattr(self, name) for name in names}

    def _compare(self) -> int:
        from cluttergen_jax.evaluation.comparison import evaluate

        given = self._given(("suite", *_OF_SUITES)) | {"out": self.out or "out/evaluation"}
        print(evaluate(**given).table.markdown())
        return 0

    def _make_suite(self) -> int:
        from cluttergen_jax.evaluation.report import markdown
        from cluttergen_jax.evaluation.running import evaluate_suite, suite_folder

        given = self._given(_OF_COMPARISONS)
        results = evaluate_suite(**given, show=lambda result: print(markdown(result), flush=True))
        out = self.out or suite_folder(str(self.suite), self.quick)
        print(f"done       {len(results)} studies in {out}")
        return 0
