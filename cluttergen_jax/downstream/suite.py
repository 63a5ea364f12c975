"""The suite `downstream`: what scenes are good for, as studies that stand on the page of results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from cluttergen_jax.downstream.perception.pose.icp import need_gicp
from cluttergen_jax.downstream.robot.description import find_robot
from cluttergen_jax.downstream.studies.perception import PERCEPTION
from cluttergen_jax.downstream.studies.placement import CAMERAS, NOISE, PLACEMENT
from cluttergen_jax.downstream.studies.robot import REARRANGEMENT, REARRANGEMENT_ABLATIONS, ROBOT
from cluttergen_jax.downstream.studies.study import SETS, DownstreamScale, Found, SuiteFolder
from cluttergen_jax.downstream.studies.trained import (
    PROTOCOL,
    SET_SIZE,
    SOURCE,
    TRAINING_SEEDS,
    TRANSFER,
)
from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.evaluation.machine import origin
from cluttergen_jax.evaluation.records import Result
from cluttergen_jax.evaluation.running import Show, command_with, write_each
from cluttergen_jax.evaluation.store import FORMAT
from cluttergen_jax.evaluation.studies.study import Study
from cluttergen_jax.evaluation.suites import check_only
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
    scale: DownstreamScale,
    num_threads: int,
    fresh: bool,
    show: Show,
) -> list[Result]:
    """The studies of the suite, each written as it is done; see `cluttergen_jax.evaluate_suite`.

    Raises:
      ConfigError: there is no such study, or no set of one of the scale's pools.
      BankError: the scale's bank cannot be read.
      MissingExtraError: a study of the robot or of perception is asked for without their extras.
    """
    check_only(only, list(STUDIES), NAME)
    known = list(dict.fromkeys(one.pool for one in SETS))
    for name in scale.pools:
        if name not in known:
            raise ConfigError(
                f"pools = {name!r} with suite {NAME!r}",
                ", ".join(known),
                meant=closest(name, known),
            )
    if scale.bank is not None:
        read_bank(scale.bank)
    studies = [STUDIES[name] for name in only or STUDIES]
    if any(study.needs_robot for study in studies):
        find_robot()
        need_gicp()
    suite = SuiteFolder(folder, scale, num_threads, fresh)
    return write_each((run_study(study, suite) for study in studies), folder, show)


def run_study(study: Study, suite: SuiteFolder) -> Result:
    """A study's result: what is there is not made again."""
    assert study.measure is not None
    found = study.measure(suite, study.trials(suite.scale), suite.folder / study.name)
    assert isinstance(found, Found)
    return result_of(study, found, command_of(study.name, suite.scale), suite.scale.quick)


def command_of(study: str, scale: DownstreamScale) -> str:
    """The command that makes one study."""
    return command_with(
        {
            "suite": NAME,
            "only": study,
            "quick": scale.quick,
            "pools": scale.pools,
            "heads": scale.heads,
            "trials": scale.trials,
            "num-pairs": scale.num_pairs,
            "seeds": scale.seeds,
            "bank": None if scale.bank is None else scale.bank.name,
            "seed": scale.seed,
        }
    )


def result_of(study: Study, found: Found, command: str, quick: bool) -> Result:
    """A study as the page of results has it, its tables made already."""
    return {
        "format": FORMAT,
        "suite": NAME,
        "name": study.name,
        "title": f"{study.title} (quick: fewer rows, few trials)" if quick else study.title,
        "place": list(STUDIES).index(study.name),
        "command": command,
        "quick": quick,
        "size": study.size,
        "trials": sorted({_size(row) for row in found.rows}),
        **origin(),
        "records": found.rows,
        "measure": None,
        "pictures": [],
        "tables": [asdict(table) for table in found.tables],
    }


def _size(row: dict) -> int:
    """Trials of a row: queries, chains of them, episodes, or moments."""
    trial = row["trial"]
    return next(
        trial[name] for name in ("chains", "queries", "episodes", "moments") if name in trial
    )
