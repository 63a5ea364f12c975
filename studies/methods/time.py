"""Wall time per valid scene, each trial in a process of its own from start to finish."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from cluttergen_jax.evaluation.comparison import Column, request_columns
from cluttergen_jax.evaluation.records import Row
from cluttergen_jax.evaluation.resolved import MissingCheckpointError
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.trial import Trial, grid
from studies.cells import number_column
from studies.methods.table1 import ALL_METHODS
from studies.rankings import by_question, ranking
from studies.rules import RULES, own_rules
from studies.study import Findings, Scale, Study, row_of


def trials(scale: Scale) -> tuple[Trial, ...]:
    """All methods by their own rules, one after another."""
    rows = grid(scale.trial(256, 8), pool=scale.pools_or("dining"), method=ALL_METHODS)
    return tuple(map(own_rules, rows))


def measure(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """On one core, and on all of them."""
    rows = []
    for trial in trials:
        try:
            checkpoint = runner.checkpoints.find(trial)
        except MissingCheckpointError as error:
            rows.append(row_of(trial, missing=error.given, hint=error.hint))
            continue
        for cores in dict.fromkeys((1, os.cpu_count() or 1)):
            runner.begin(f"time of {trial.title} on {cores} cores")
            order = {"trial": trial.fields(), "cores": cores, "engine": runner.engine}
            order["checkpoint"] = checkpoint and str(checkpoint.path)
            rows.append(row_of(trial, _run_apart(json.dumps(order))))
    return Findings(rows)


def _run_apart(order: str) -> Row:
    """What `timing.main` prints, run in a process that sees so many cores."""
    command = [sys.executable, "-m", "studies.timing", order]
    # This checkout's folder is found wherever the program was begun.
    paths = [str(Path(__file__).parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])]
    found = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    done = subprocess.run(command, env=found, capture_output=True, text=True, check=False)
    if done.returncode:
        said = "".join(done.stderr.strip().splitlines()[-1:])
        return {"missing": f"the timed process failed: {said}", "hint": "the same command again"}
    return json.loads(done.stdout.splitlines()[-1])


def _notes(rows: list[Row]) -> list[str]:
    by_cores = by_question([row for row in rows if "cores" in row], lambda row: str(row["cores"]))
    ranks = (
        f"s per valid scene without start, cores {cores}, least first: "
        f"{ranking(group, 'running_seconds_per_valid_scene', 4, falls=False)}"
        for cores, group in by_cores.items()
    )
    return [
        "wall time of a process of its own, from its first import to its last scene; the last column leaves "
        "out imports, models and compilation; rejected work is included in both",
        *RULES,
        *ranks,
    ]


TIME = Study(
    "time",
    "Time per valid scene, end to end",
    256,
    trials,
    (
        *request_columns("pool", "method"),
        Column("cores", lambda row: str(row.get("cores", "-")), is_asked=True),
        Column("valid scenes", lambda row: f"{row['valid']} of {row['scenes']}"),
        number_column("whole process, s", "seconds"),
        number_column("s per valid scene", "seconds_per_valid_scene", 4),
        number_column("without start, s", "running_seconds_per_valid_scene", 4),
    ),
    _notes,
    measure,
    says_margin=True,
    measured_as="timing",
)
