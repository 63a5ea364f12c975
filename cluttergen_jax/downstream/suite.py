"""The suite `downstream`: what scenes are good for, as studies that stand on the page of results."""

from __future__ import annotations

import datetime
import shlex
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from cluttergen_jax.downstream.perception.pose.icp import need_gicp
from cluttergen_jax.downstream.robot.model import panda_folder
from cluttergen_jax.downstream.studies.cameras import CAMERAS
from cluttergen_jax.downstream.studies.noise import NOISE
from cluttergen_jax.downstream.studies.perception import PERCEPTION
from cluttergen_jax.downstream.studies.placement import PLACEMENT
from cluttergen_jax.downstream.studies.pretrained import PRETRAINED
from cluttergen_jax.downstream.studies.protocol import PROTOCOL
from cluttergen_jax.downstream.studies.rearrangement import REARRANGEMENT, REARRANGEMENT_ABLATIONS
from cluttergen_jax.downstream.studies.robot import ROBOT
from cluttergen_jax.downstream.studies.set_size import SET_SIZE
from cluttergen_jax.downstream.studies.source import SOURCE
from cluttergen_jax.downstream.studies.study import SETS, DownstreamStudy, Found, Scale, SuiteFolder
from cluttergen_jax.downstream.studies.training_seeds import TRAINING_SEEDS
from cluttergen_jax.downstream.studies.transfer import TRANSFER
from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.evaluation.machine import machine
from cluttergen_jax.evaluation.report import Result, document, write_report
from cluttergen_jax.evaluation.store import FORMAT
from cluttergen_jax.files import write_atomically
from cluttergen_jax.scene.bank import read_bank

NAME = "downstream"
STUDIES = {
    study.name: study
    for study in (
        PLACEMENT,
        NOISE,
        CAMERAS,
        SET_SIZE,
        SOURCE,
        TRAINING_SEEDS,
        TRANSFER,
        PRETRAINED,
        PROTOCOL,
        PERCEPTION,
        ROBOT,
        REARRANGEMENT,
        REARRANGEMENT_ABLATIONS,
    )
}
"""By name, in the order of the page."""


def run_downstream(
    folder: Path,
    only: Sequence[str],
    scale: Scale,
    num_threads: int,
    fresh: bool,
    show: Callable[[Result], None],
) -> list[Result]:
    """The studies of the suite, each written as it is done; see `cluttergen_jax.evaluate_suite`.

    Raises:
      ConfigError: there is no such study, or no set of one of the scale's pools.
      BankError: the scale's bank cannot be read.
      MissingExtraError: a study of the robot or of perception is asked for without their extras.
    """
    for name in only:
        if name not in STUDIES:
            raise ConfigError(
                f"only = {name!r} in suite {NAME!r}", ", ".join(STUDIES), meant=closest(name, list(STUDIES))
            )
    known = list(dict.fromkeys(one.pool for one in SETS))
    for name in scale.pools:
        if name not in known:
            raise ConfigError(
                f"pools = {name!r} with suite {NAME!r}", ", ".join(known), meant=closest(name, known)
            )
    if scale.bank is not None:
        read_bank(scale.bank)
    if any(STUDIES[name].needs_robot for name in only or STUDIES):
        panda_folder()
        need_gicp()
    suite, results = SuiteFolder(folder, scale, num_threads, fresh), []
    for name in only or STUDIES:
        found = STUDIES[name].run(suite)
        result = result_of(STUDIES[name], found, command_of(name, scale), scale.quick)
        write_report(result, folder)
        show(result)
        results.append(result)
    write_atomically(folder / "all.md", document(results, link="").encode())
    return results


def command_of(study: str, scale: Scale) -> str:
    """The command that makes one study."""
    words = ["cluttergen", "evaluate", "--suite", NAME, "--only", study]
    given = {
        "--pools": scale.pools,
        "--heads": scale.heads,
        "--trials": scale.num_scenes,
        "--num-pairs": scale.num_pairs,
        "--seeds": scale.seeds,
        "--bank": None if scale.bank is None else scale.bank.name,
        "--seed": scale.seed or None,
    }
    words += ["--quick"] if scale.quick else []
    for flag, value in given.items():
        if value is not None and value != ():
            words += [flag, *(map(str, value) if isinstance(value, tuple) else [str(value)])]
    return shlex.join(words)


def result_of(study: DownstreamStudy, found: Found, command: str, quick: bool) -> Result:
    """A study as the page of results has it, its tables made already."""
    return {
        "format": FORMAT,
        "suite": NAME,
        "name": study.name,
        "title": study.title,
        "place": list(STUDIES).index(study.name),
        "command": command,
        "quick": quick,
        "size": 1,
        "trials": sorted({_size(row) for row in found.records}),
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "machine": machine(),
        "records": found.records,
        "measure": None,
        "pictures": [],
        "tables": [asdict(table) for table in found.tables],
    }


def _size(row: dict) -> int:
    """Trials of a row: queries, chains of them, episodes, or moments."""
    trial = row["trial"]
    return next(trial[name] for name in ("chains", "queries", "episodes", "moments") if name in trial)
