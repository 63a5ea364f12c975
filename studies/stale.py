"""Which rows of reports/results a change may have moved, and which it has.

    python -m studies.stale                  rows whose inputs have changed since their commit
    python -m studies.stale --probe          of these the first scenes are made again and compared
    python -m studies.stale --studies front

A row's inputs are its pool, support and checkpoint, by their hashes, and the code that makes scenes. The exit
status is 1 if a row may have moved, or if it does not say by which code it was made.
"""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import tyro

from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.evaluation.records import CHANGED, Row
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.store import Store
from cluttergen_jax.evaluation.trial import Trial, trial_of
from cluttergen_jax.numerics import with_kept_programs
from studies.pages import PAGES, ROOT
from studies.report import read_results
from studies.results import Result, made_rows

MAKES_SCENES = (
    "assets",
    "config.py",
    "geometry.py",
    "learning",
    "numerics.py",
    "physics",
    "placement",
    "spec.py",
    "types.py",
)
"""Of the package, what decides the scenes of a row; the rest counts and shows them."""
_SOURCES = ("pool", "support", "checkpoint", "method", "start")

MOVED = "moved"
MAY_HAVE = "may have moved"
SAME = "the first scenes are the same"
CURRENT = "nothing has changed"
UNKNOWN = "does not say by which code it was made"


@dataclass(frozen=True)
class Stale:
    """What is looked at.

    Attributes:
      studies: by name; those whose tables stand in the READMEs if none.
      probe: make the first scenes of rows that may have moved again, and compare.
    """

    studies: tuple[str, ...] = ()
    probe: bool = False


@dataclass(frozen=True)
class State:
    """What is known of a row.

    Attributes:
      study, title: for people; state: one of the words above; why: what has changed.
    """

    study: str
    title: str
    state: str
    why: str = ""

    @property
    def is_fine(self) -> bool:
        """Whether the row is what it would be now, as far as that was looked at."""
        return self.state in (SAME, CURRENT)


@cache
def changed_code(commit: str) -> tuple[str, ...] | None:
    """Files that make scenes and differ from a commit; None where git does not know it."""
    paths = [f"cluttergen_jax/{name}" for name in MAKES_SCENES]
    words = ["git", "-C", str(ROOT), "diff", "--name-only", commit, "--", *paths]
    done = subprocess.run(words, capture_output=True, text=True)
    return tuple(done.stdout.split()) if done.returncode == 0 else None


def state_of(row: Row, study: str, runner: Runner, probe: bool) -> State:
    """Whether a row may have moved."""
    trial = trial_of(row)
    commit = row.get("commit") or ""
    if not commit:
        return State(study, trial.title, UNKNOWN)
    try:
        now = runner.resolve(trial).sources
    except ClutterGenError as error:
        return State(study, trial.title, MAY_HAVE, str(error))
    then = row["sources"]
    others = [name for name in _SOURCES if now.get(name) != then.get(name)]
    if others:
        return State(study, trial.title, MOVED, f"another {', '.join(others)}")
    files = changed_code(commit.removesuffix(CHANGED))
    if files is None:
        return State(study, trial.title, UNKNOWN, f"commit {commit} is not in this repository")
    if not files and not commit.endswith(CHANGED):
        return State(study, trial.title, CURRENT)
    why = f"since {commit}: {', '.join(files[:3])}{' and others' if len(files) > 3 else ''}"
    if not probe or "first" not in row:
        return State(study, trial.title, MAY_HAVE, why)
    return State(study, trial.title, *_compare(row, trial, runner))


def _compare(row: Row, trial: Trial, runner: Runner) -> tuple[str, str]:
    """The first scenes of a row as they are now beside those of then."""
    try:
        now = runner.first_scenes(trial)
    except ClutterGenError as error:
        return MAY_HAVE, str(error)
    if now == row["first"]:
        return SAME, ""
    then = row["first"]["success"]
    return MOVED, f"of the first {len(then)} scenes {sum(then)} succeeded, {sum(now['success'])} do"


def states(results: Sequence[Result], config: Stale) -> Iterator[State]:
    """Of all rows of trials, one after another."""
    runner = Runner(Store(None))
    names = config.studies or tuple({name for blocks in PAGES.values() for name in blocks})
    for result in results:
        if result["name"] in names:
            for row in made_rows(result["records"]):
                if "trial" in row:
                    yield state_of(row, result["name"], runner, config.probe)


@with_kept_programs
def main(config: Stale, folder: Path = ROOT / "reports" / "results") -> int:
    """Prints what may have moved, and how many rows are as they were; the exit status."""
    counts: Counter[str] = Counter()
    for each in states(read_results(folder), config):
        counts[each.state] += 1
        if not each.is_fine:
            why = f" ({each.why})" if each.why else ""
            print(f"{each.study}: {each.title}: {each.state}{why}", flush=True)
    for state, number in counts.items():
        print(f"{number} rows: {state}")
    return int(any(state not in (SAME, CURRENT) for state in counts))


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Stale)))
