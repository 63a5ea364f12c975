"""Runs of suites and their studies: trials, measures, pictures; a result is plain JSON."""

from __future__ import annotations

import hashlib
import json
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from cluttergen_jax.assets.pool import find_pool, list_pools
from cluttergen_jax.cluster import Cluster
from cluttergen_jax.config import Engine
from cluttergen_jax.evaluation.cells import is_failed, made_rows
from cluttergen_jax.evaluation.comparison import open_runner
from cluttergen_jax.evaluation.machine import origin, origins_of
from cluttergen_jax.evaluation.records import Measured, Result
from cluttergen_jax.evaluation.report import document, write_report
from cluttergen_jax.evaluation.resolved import MissingCheckpointError
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.store import FORMAT
from cluttergen_jax.evaluation.studies.study import Findings, Scale, Study
from cluttergen_jax.evaluation.studies.table1 import IMPORTED, OBJECTS
from cluttergen_jax.evaluation.studies.time import TIME
from cluttergen_jax.evaluation.suites import find_suite
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.files import inside, write_atomically
from cluttergen_jax.numerics import fast_compilation

_SHOWN = ("trial", "policy", "figures", "missing", "hint")
Show = Callable[[Result], None]


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
    show: Show,
) -> list[Result]:
    """The results of a suite of methods, each written as it is done; see `cluttergen_jax.evaluate_suite`.

    Args:
      place: a cluster that makes the rows; this process if None.
    """
    scale = replace(scale, imported=imported_pools())
    planned = find_suite(suite, scale, only)
    rows = [trial for each in planned if each.study is not TIME for trial in each.trials]
    runner = open_runner(folder, rows, checkpoint, checkpoints, engine, num_threads, fresh)
    if place is not None:
        runner.make_on(place, rows)
    made = (
        run_study(
            runner,
            each.study,
            each.trials,
            folder,
            suite,
            command_of(suite, each.name, scale, runner),
            scale.quick,
        )
        for each in planned
    )
    with fast_compilation(scale.quick):
        return write_each(made, folder, show)


def write_each(results: Iterable[Result], folder: Path, show: Show) -> list[Result]:
    """Writes each result as it is made, and at last the page of all of them."""
    written = []
    for result in results:
        write_report(result, folder)
        show(result)
        written.append(result)
    write_atomically(folder / "all.md", document(written, link="").encode())
    return written


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
    return command_with(options)


def command_with(options: Mapping[str, Any]) -> str:
    """The command `cluttergen evaluate` with those of the options that are given."""
    words = ["cluttergen evaluate"]
    for name, value in options.items():
        if value:
            values = value if isinstance(value, tuple) else () if value is True else (value,)
            words.append(" ".join([f"--{name}", *(shlex.quote(str(each)) for each in values)]))
    return " ".join(words)


def run_study(
    runner: Runner,
    study: Study,
    trials: Sequence[Trial],
    folder: Path,
    suite: str,
    command: str,
    quick: bool,
) -> Result:
    """Runs what was not kept from before.

    Args:
      folder: where pictures go; findings of measures lie in its `results`, beside the rows of trials.
      command: what a reader would type to make the study again.
      quick: fewer trials were made than the study asks for, on purpose.
    """
    runner.say(f"{study.name}: {study.title}")
    rows = [] if study.measure else [runner.row(trial) for trial in trials]
    findings, measured = _findings(runner, study, trials, folder)
    made = made_rows(rows)
    latest, *others = origins_of(made or measured) or [origin()]
    plots = study.plot(made, folder / study.name) if study.plot and made else []
    shown: Any = [{name: value for name, value in row.items() if name in _SHOWN} for row in rows]
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
        "records": shown,
        "measure": findings,
        "pictures": [*(findings["pictures"] if findings else []), *plots],
    }


def num_failed(results: Sequence[Result]) -> int:
    """Rows of studies that could not be made (`cells.is_failed`)."""
    measured = [result["measure"]["rows"] for result in results if result.get("measure")]  # type: ignore
    return sum(
        is_failed(row)
        for rows in (*measured, *(each["records"] for each in results))
        for row in rows
    )


def _findings(
    runner: Runner, study: Study, trials: Sequence[Trial], folder: Path
) -> tuple[Measured | None, list[Any]]:
    """The measure's findings: those that were kept if they are of the same trials, else made now.

    Returns:
      The findings, None of a study without a measure, and when and where they were made.
    """
    stem = folder / study.name
    measure = study.measure or study.renders
    if measure is None:
        return None, []
    if study.keeps_each:
        runner.measured_at.clear()
        return _plain(measure(runner, trials, stem)), list(runner.measured_at)
    key = _findings_key(runner, study, trials)
    title = f"measure {study.name}"
    stored = None if runner.is_fresh else runner.store.read(title, key)
    if stored and all(inside(folder, name).is_file() for name in stored["figures"]["pictures"]):
        return stored["figures"], [stored]
    runner.begin(f"measuring {study.name}")
    found = _plain(measure(runner, trials, stem))
    made = origin()
    return runner.store.keep(title, key, found, made), [made]


def _plain(findings: Findings) -> Any:
    return asdict(findings)


def _findings_key(runner: Runner, study: Study, trials: Sequence[Trial]) -> str:
    """Equal for equal trials of equal content, checkpoints that are missing included."""
    parts: list[Any] = [study.measured_as or study.name]
    for trial in trials:
        try:
            parts.append(runner.resolve(trial).key)
        except MissingCheckpointError as error:
            parts.append([trial.fields(), str(error)])
        parts.append(study.depends_on(runner, trial))
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:20]
