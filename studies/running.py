"""Runs of suites and their studies: trials, measures, pictures; a result is plain JSON."""

from __future__ import annotations

import hashlib
import json
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cluttergen_jax.assets.pool import find_pool, list_pools
from cluttergen_jax.evaluation.records import origin
from cluttergen_jax.evaluation.resolved import MissingCheckpointError
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.store import FORMAT
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.files import inside, write_atomically
from studies.cells import is_failed
from studies.downstream.suite_folder import SuiteFolder
from studies.methods.table1 import IMPORTED, OBJECTS
from studies.report import document, write_report
from studies.results import Measured, Result, made_rows, origins_of
from studies.study import Findings, Study
from studies.suites import PlannedStudy

_SHOWN = (
    "trial",
    "sources",
    "policy",
    "rules",
    "first",
    "date",
    "commit",
    "figures",
    "missing",
    "hint",
)
Show = Callable[[Result], None]


def make_suite(
    suite: str,
    planned: Sequence[PlannedStudy],
    maker: Runner | SuiteFolder,
    folder: Path,
    options: Mapping[str, Any],
    show: Show,
) -> list[Result]:
    """The results of a suite's studies, each written as it is done; see `studies.api.evaluate_suite`.

    Args:
      maker: makes and keeps the rows.
      options: of the command that makes the suite again; `quick` is one.
    """
    results = (
        run_study(
            maker,
            each.study,
            each.trials,
            folder,
            suite,
            command_with({"suite": suite, "only": each.name, **options}),
            bool(options["quick"]),
        )
        for each in planned
    )
    return write_each(results, folder, show)


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


def command_with(options: Mapping[str, Any]) -> str:
    """The command `python evaluate.py` with those of the options that are given."""
    words = ["python evaluate.py"]
    for name, value in options.items():
        if value:
            values = value if isinstance(value, tuple) else () if value is True else (value,)
            words.append(" ".join([f"--{name}", *(shlex.quote(str(each)) for each in values)]))
    return " ".join(words)


def run_study(
    maker: Runner | SuiteFolder,
    study: Study,
    trials: Sequence[Any],
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
    if study.brings_tables:
        assert study.measure is not None
        found = study.measure(maker, trials, folder / study.name)
        title = f"{study.title} (quick: fewer rows, few trials)" if quick else study.title
        told: Any = {
            "title": title,
            "trials": sorted({_size(row) for row in found.rows}),
            **origin(),
            "records": found.rows,
            "measure": None,
            "pictures": [],
            "tables": [asdict(table) for table in found.tables],
        }
    else:
        assert isinstance(maker, Runner)
        told = {"title": study.title, **_told_by_rows(maker, study, trials, folder)}
    asked: Any = {"suite": suite, "name": study.name, "command": command, "quick": quick}
    return {"format": FORMAT, **asked, "size": study.size, **told}


def _told_by_rows(
    runner: Runner, study: Study, trials: Sequence[Trial], folder: Path
) -> dict[str, Any]:
    """What trials' rows and their measure tell; the tables are made of it when they are read."""
    runner.say(f"{study.name}: {study.title}")
    rows = [] if study.measure else [runner.row(trial) for trial in trials]
    findings, measured = _findings(runner, study, trials, folder)
    made = made_rows(rows)
    latest, *others = origins_of(made or measured) or [origin()]
    plots = study.plot(made, folder / study.name) if study.plot and made else []
    return {
        "trials": sorted({trial.trials for trial in trials}),
        **latest,
        **({"also_made": others} if others else {}),
        "records": [_shown(row) for row in rows],
        "measure": findings,
        "pictures": [*(findings["pictures"] if findings else []), *plots],
    }


def _shown(row: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in row.items() if name in _SHOWN}


def _size(row: Mapping[str, Any]) -> int:
    """Trials of a row: queries, chains of them, episodes, or moments."""
    trial = row["trial"]
    return next(
        trial[name] for name in ("chains", "queries", "episodes", "moments") if name in trial
    )


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
    return {name: value for name, value in asdict(findings).items() if name != "tables"}


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
