"""Runs of suites and their studies: trials, measures, pictures; a result is plain JSON."""

from __future__ import annotations

import hashlib
import json
import shlex
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from cluttergen_jax.assets.pool import find_pool, list_pools
from cluttergen_jax.cluster import Cluster
from cluttergen_jax.config import Engine
from cluttergen_jax.evaluation.cells import is_failed
from cluttergen_jax.evaluation.comparison import open_runner
from cluttergen_jax.evaluation.machine import origin, origins_of
from cluttergen_jax.evaluation.report import document, write_report
from cluttergen_jax.evaluation.resolved import MissingCheckpointError
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.store import FORMAT
from cluttergen_jax.evaluation.studies.study import Measure, Result, Scale, Study
from cluttergen_jax.evaluation.studies.table1 import IMPORTED, OBJECTS
from cluttergen_jax.evaluation.studies.time import TIME
from cluttergen_jax.evaluation.suites import FORMER_NAMES, PlannedStudy, find_suite
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.files import inside, write_atomically

_SHOWN = ("trial", "policy", "figures", "missing", "hint")


def make_suite(
    suite: str,
    only: Sequence[str],
    scale: Scale,
    folder: Path,
    *,
    checkpoint: str | Path | None,
    checkpoints: str | Path | None,
    engine: Engine,
    place: Cluster | None,
    num_threads: int,
    fresh: bool,
    show: Callable[[Result], None],
) -> list[Result]:
    """The results of a suite of methods; see `cluttergen_jax.evaluate_suite`.

    Args:
      place: a cluster that makes the rows; this process if None.
    """
    scale = replace(scale, imported=imported_pools())
    planned = find_suite(suite, scale, only)
    rows = [trial for each in planned if each.study is not TIME for trial in each.trials]
    runner = open_runner(folder, rows, checkpoint, checkpoints, engine, num_threads, fresh)
    if place is not None:
        runner.make_on(place, rows)
    return run_suite(runner, suite, planned, scale, folder, show)


def run_suite(
    runner: Runner,
    suite: str,
    planned: Sequence[PlannedStudy],
    scale: Scale,
    folder: Path,
    show: Callable[[Result], None],
) -> list[Result]:
    """The results of a suite's studies, each written as it is done; see `cluttergen_jax.evaluate_suite`."""
    if suite in FORMER_NAMES:
        suite = FORMER_NAMES[suite]
        runner.say(f"note: this suite is now called {suite}; its former name is understood in this release")
    results = []
    for each in planned:
        command = command_of(suite, each.name, scale, runner)
        result = run_study(runner, each.study, each.trials, folder, suite, command, scale.quick)
        write_report(result, folder)
        show(result)
        results.append(result)
    write_atomically(folder / "all.md", document(results, link="").encode())
    return results


def suite_folder(suite: str, quick: bool) -> Path:
    """Where a suite goes if nothing else is said."""
    return Path("out", f"{suite}-quick" if quick else suite)


def imported_pools() -> tuple[tuple[str, int], ...]:
    """Pools of the paper's own objects that are at hand, and how many a scene of each has."""
    names = [name for name in list_pools() if name.startswith(IMPORTED)]
    return tuple((name, min(OBJECTS, len(find_pool(name)))) for name in names)


def command_of(suite: str, study: str, scale: Scale, runner: Runner) -> str:
    """The command that makes one study again."""
    options = {
        "methods": scale.methods,
        "checkpoint": runner.checkpoints.path,
        "checkpoints": runner.checkpoints.folder,
        "pools": scale.pools,
        "trials": scale.trials,
        "seed": scale.seed,
        "suite": suite,
        "quick": scale.quick,
        "seeds": scale.seeds,
        "engine": None if runner.engine == "auto" else runner.engine,
        "threads": runner.num_threads,
        "only": study,
    }
    words = ["cluttergen evaluate"]
    for name, value in options.items():
        if value:
            values = value if isinstance(value, tuple) else () if value is True else (value,)
            words.append(" ".join([f"--{name}", *(shlex.quote(str(each)) for each in values)]))
    return " ".join(words)


def run_study(
    runner: Runner, study: Study, trials: Sequence[Trial], folder: Path, suite: str, command: str, quick: bool
) -> Result:
    """Runs what was not kept from before.

    Args:
      folder: where pictures go; findings of measures lie in its `results`, beside the rows of trials.
      command: what a reader would type to make the study again.
      quick: fewer trials were made than the study asks for, on purpose.
    """
    runner.say(f"{study.name}: {study.title}")
    rows = [] if study.measure else [runner.row(trial) for trial in trials]
    measure = study.measure or study.renders
    findings, measured = _findings(runner, study, trials, folder, measure) if measure else (None, [])
    made = [row for row in rows if "figures" in row]
    latest, *others = origins_of(made or measured) or [origin()]
    plots = study.plot(made, folder / study.name) if study.plot and made else []
    return {
        "format": FORMAT,
        "suite": suite,
        "name": study.name,
        "title": study.title,
        "command": command,
        "quick": quick,
        "size": study.size,
        "trials": sorted({trial.trials for trial in trials}),
        **latest,
        **({"also_made": others} if others else {}),
        "records": [{name: row[name] for name in _SHOWN if name in row} for row in rows],
        "measure": findings,
        "pictures": [*(findings["pictures"] if findings else []), *plots],
    }


def num_failed(results: Sequence[Result]) -> int:
    """Rows of studies that could not be made (`cells.is_failed`)."""
    measured = (result["measure"]["rows"] for result in results if result.get("measure"))
    rows = [row for each in (*(result["records"] for result in results), *measured) for row in each]
    return sum(map(is_failed, rows))


def _findings(
    runner: Runner, study: Study, trials: Sequence[Trial], folder: Path, measure: Measure
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The measure's findings: those that were kept if they are of the same trials, else made now.

    Returns:
      The findings, and when and where they were made.
    """
    stem = folder / study.name
    if study.keeps_each:
        runner.measured_at.clear()
        return asdict(measure(runner, trials, stem)), list(runner.measured_at)
    key, title = _findings_key(runner, study, trials), f"measure {study.name}"
    stored = None if runner.is_fresh else runner.store.read(title, key)
    if stored and all(inside(folder, name).is_file() for name in stored["figures"]["pictures"]):
        return stored["figures"], [stored]
    runner.begin(f"measuring {study.name}")
    found = asdict(measure(runner, trials, stem))
    made = origin()
    return runner.store.keep(title, key, found, made), [made]


def _findings_key(runner: Runner, study: Study, trials: Sequence[Trial]) -> str:
    """Equal for equal trials of equal content, checkpoints that are missing included."""
    parts: list[Any] = [study.measured_as or study.name]
    for trial in trials:
        try:
            parts.append(runner.resolve(trial).key)
        except MissingCheckpointError as error:
            parts.append([asdict(trial), str(error)])
        parts.append(study.depends_on(runner, trial))
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:20]
