"""Whether scenes stay put: saved ones, anybody's, and certificates of how firmly those of a bank stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from cluttergen_jax.config import (
    DETECTORS,
    Detector,
    VerifyConfig,
    check_names,
    check_range,
    check_seconds,
    check_workers,
)
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import check_folder
from cluttergen_jax.kept_folder import hold_folder

if TYPE_CHECKING:
    import numpy as np

    from cluttergen_jax.judging.certify import Certification
    from cluttergen_jax.judging.judge import JudgeReport
    from cluttergen_jax.judging.verify import VerificationReport
    from cluttergen_jax.scene.bank import Bank


def verify(
    path: str | Path,
    check: VerifyConfig | None = None,
    *,
    jobs: int = 0,
    cluster: str | None = None,
    workers: int = 0,
    allow_unchecked: bool = False,
) -> VerificationReport:
    """Checks that saved scenes are stable: plain MuJoCo, sleeping disabled (`cluttergen verify`).

    Of a bank, its files are compared with the digests in bank.json as well, and each scene's file with its
    row: a scene of which something was changed does not count. What was found is written to verification.json
    in the bank's folder.

    Args:
      path: a bank (its folder, or a URL), or one MJCF file with a keyframe called scene.
      check: how long, and what counts as standing; the defaults of `VerifyConfig` if not given.
      jobs: scenes simulated at a time; 0 takes every core.
      cluster: where it is done: "local", Ray on this machine; "auto", the Ray cluster that this machine
        belongs to; or a cluster's address (extra `ray`). In this process if not given. All machines have to
        see the files under the same path.
      workers: worker processes on the cluster; 0 takes as many as it has room for.
      allow_unchecked: simulate a bank that has no digests of its files, as those of older versions have none.

    Raises:
      BankError: there is nothing to verify, or the one file that is given cannot be loaded or simulated
        (of a bank, such a scene is not stable, and its `fault` says why), or a bank has no digests of its
        files.
      UnsafePathError: a file of a bank names files outside of that bank.
      ConfigError: `jobs` is out of range.
      MissingExtraError: a cluster without the extra `ray`.
    """
    from cluttergen_jax.cluster import cluster_of
    from cluttergen_jax.judging.verify import verify_files
    from cluttergen_jax.scene.bank import bank_folder

    return verify_files(
        bank_folder(path),
        check or VerifyConfig(),
        jobs,
        cluster_of(cluster, workers),
        allow_unchecked,
    )


def certify(
    bank: Bank | str | Path,
    *,
    seconds: float = 2.0,
    jobs: int = 0,
    force: bool = False,
    cluster: str | None = None,
    workers: int = 0,
) -> Certification:
    """Adds a stability certificate to each successful scene of a bank: a column for each measure.

    Args:
      bank: a bank's folder; in Python also a `Bank`.
      seconds: the horizon over which drift is measured, 3600 at most.
      jobs: scenes simulated at a time; 0 takes every core.
      force: measure again what has a certificate.
      cluster: where it is done: "local", Ray on this machine; "auto", the Ray cluster that this machine
        belongs to; or a cluster's address (extra `ray`). In this process if not given.
      workers: worker processes on the cluster; 0 takes as many as it has room for.
        Each has `jobs` cores, one if that is 0.

    Raises:
      BankError: the bank cannot be read or written, another process writes it, or it holds no success.
      ConfigError: a setting is outside its range.
      MissingExtraError: a cluster without the extra `ray`.
    """
    from cluttergen_jax.cluster import cluster_of
    from cluttergen_jax.judging.certify import certify_bank
    from cluttergen_jax.scene.bank import Bank, read_bank

    check_seconds("seconds", seconds)
    check_workers("jobs", jobs)
    bank = bank if isinstance(bank, Bank) else read_bank(bank)
    return certify_bank(bank, seconds, jobs, force, cluster_of(cluster, workers))


_MOST_STARTS = 1_000_000


def judge(
    paths: str | Path | Sequence[str | Path],
    states: str | Path | np.ndarray | None = None,
    *,
    out: str | Path | None = None,
    seconds: Sequence[float] = (1.0, 10.0, 60.0),
    max_shift: float = VerifyConfig.max_shift,
    max_turn_deg: float = VerifyConfig.max_turn_deg,
    max_penetration: float = 0.001,
    hold_joints: bool = False,
    detectors: Sequence[Detector] = DETECTORS,
    max_starts: int = 50,
    sense: bool | str | Path = False,
    jobs: int = 0,
) -> JudgeReport:
    """Judges anybody's scenes by one strict rule (`cluttergen judge`).

    Each free body of each start is simulated in the installed MuJoCo from rest, everything awake, with the
    file's own options; nothing is repaired. It is told what moves up to each horizon, what overlaps (by
    geometry, also where the file leaves contacts out) and what nothing carries at the start, and what falls;
    a simulation that diverges counts as moved. What is noted, such as a missing picture, is in `notes`.

    Args:
      paths: files of scenes (MJCF, URDF, MJB, SDF worlds; USD with the extra `usd`) and folders of them. An
        MJCF file starts at each of its keyframes, or where its bodies are; or at the states in an array of
        the same name beside it (scene.npz or scene.npy beside scene.xml).
      states: starts of a single file: an array, or its npz or npy file. Rows are qpos, or qpos and qvel,
        with or without the time before them; velocities count as zero. Numbers are real and finite,
        quaternions of unit length to within 0.01.
      out: a folder for report.csv, report.parquet and a picture of the worst scene; nothing is written if
        not given.
      seconds: horizons, ascending.
      max_shift: metres by which a body's centre of mass may be away from its start at any time.
      max_turn_deg: degrees that a body may have turned.
      max_penetration: metres by which two bodies may overlap at the start.
      hold_joints: keep joints other than free ones where they start. If not, actuators hold their initial
        controls, and an arm whose motors are given no torque falls.
      detectors: of MuJoCo's detectors of convex collisions: "native", "libccd", or both.
      max_starts: of a file that has more starts, so many are judged, evenly spread.
      sense: score, too, how much sense the starts make by a table of what is usually on, in and beside what
        (`SceneSpec.sense`): the share of carried pairs that are usual, of box-like bodies along the edges of
        what carries them, and of bodies near a usual neighbour; kinds follow from the names of bodies. In
        Python also the file of a table of your own.
      jobs: simulations at a time; 0 takes every core.

    Returns:
      The report; printed, a table and the worst scenes. What cannot be read is in `unread`, with the reason.

    Raises:
      ConfigError: a setting is outside its range, a path does not exist, or no file is a scene.
      BankError: another process writes to `out`.
    """
    from cluttergen_jax.assets.sense import read_sense
    from cluttergen_jax.judging.judge import JudgeConfig, judge_scenes
    from cluttergen_jax.judging.scene_files import find_scenes

    check_workers("jobs", jobs)
    check_folder(out)
    check_range("max_starts", max_starts, 1, _MOST_STARTS, 50)
    check_names(detectors, "detectors")
    if not detectors or set(detectors) - set(DETECTORS):
        raise ConfigError(
            f"detectors = {tuple(detectors)}", " ".join(DETECTORS), "detectors=('native',)"
        )
    paths = [paths] if isinstance(paths, str | Path) else list(paths)
    table = read_sense("" if sense is True else sense) if sense else None
    config = JudgeConfig(
        tuple(seconds), max_shift, max_turn_deg, max_penetration, hold_joints, table
    )
    if states is not None and len(find_scenes(paths)[0]) > 1:
        raise ConfigError(
            "`states` of several files", "of one file", "arrays of their names beside them"
        )
    with hold_folder(None if out is None else Path(out)):
        report = judge_scenes(paths, states, config, tuple(detectors), max_starts, jobs)
        return (
            report
            if out is None
            else replace(report, notes=(*report.notes, report.write(Path(out))))
        )
