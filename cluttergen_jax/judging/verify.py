"""The independent check: a saved file, loaded afresh in plain MuJoCo, everything awake, for ten seconds."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

from cluttergen_jax.cluster import Cluster, each_on
from cluttergen_jax.config import DETECTORS, StabilityConfig, VerifyConfig, check_workers
from cluttergen_jax.errors import BankError, UnsafePathError
from cluttergen_jax.files import check_utf8, inside, write_atomically
from cluttergen_jax.physics.log import silent_log
from cluttergen_jax.physics.standing import StandingCheck, check_standing
from cluttergen_jax.progress import track
from cluttergen_jax.scene.bank import (
    AGAIN,
    INDEX,
    Bank,
    Change,
    changes_of,
    changes_to_scene,
    fetch_scenes,
    read_bank,
)
from cluttergen_jax.types import small_length

_SHORTEST_STEP = 1e-4
_LONGEST_STEP = 0.05
_GIVEN = "the folder of a bank with files, or one MJCF file"
_FOLDERS = ("meshdir", "texturedir", "assetdir")
_SHOWN = 20
_OURS = "files written by `cluttergen generate`"


@dataclass(frozen=True, eq=False, kw_only=True)
class Verification(StandingCheck):
    """How a saved scene behaved, by the detector of MuJoCo's two with which it moved the most.

    Attributes:
      path: the file.
      fault: why it could not be simulated, in words; there are no objects then.
    """

    path: Path
    fault: str = ""


@dataclass(frozen=True, eq=False)
class VerificationReport:
    """What `verify` found; printed, it says which scenes stand, how far objects moved, and what was changed.

    Attributes:
      path: what was verified.
      config: how long it was simulated, and what counts as standing.
      scenes: how each file behaved.
      changes: the files of a bank that are not what was written; None if it has no digests of them.
      changed_files: for each scene, those of its files that were changed.
      is_unchecked: it is a bank without digests of its files.
      has_own_limits: the limits are those that the bank was asked for, not the usual ones.
      unwritten: why verification.json could not be written into the bank's folder; "" if it is there.
    """

    path: Path
    config: VerifyConfig
    scenes: tuple[Verification, ...]
    changes: tuple[Change, ...] | None
    changed_files: tuple[tuple[str, ...], ...]
    is_unchecked: bool = False
    unwritten: str = ""
    has_own_limits: bool = False

    @property
    def stands(self) -> np.ndarray:
        """bool[N]: the scene stands, and is the one that was written."""
        pairs = zip(self.scenes, self.changed_files, strict=True)
        return np.array([scene.stands and not changed for scene, changed in pairs])

    @property
    def is_sound(self) -> bool:
        """Whether every scene stands and no file was changed."""
        return bool(self.stands.all()) and not self.changes

    def as_json(self) -> list[dict[str, object]]:
        """A record for each scene, as verification.json holds them."""
        return [
            {
                "file": scene.path.name,
                "stands": bool(stands),
                "detector": scene.detector,
                "changed_files": list(changed),
                **({"fault": scene.fault} if scene.fault else {}),
                "shift_m_and_turn_rad": {
                    # JSON has no numbers for what diverged.
                    name: [float(each) if np.isfinite(each) else None for each in moved]
                    for name, *moved in zip(scene.objects, scene.shift, scene.turn, strict=True)
                },
            }
            for scene, stands, changed in zip(
                self.scenes, self.stands, self.changed_files, strict=True
            )
        ]

    def __str__(self) -> str:
        shift = np.concatenate([each.shift for each in self.scenes])
        turn = np.degrees(np.concatenate([each.turn for each in self.scenes]))
        limits = f"{self.config.max_shift * 1000:g} mm or {self.config.max_turn_deg:g} deg"
        lines = [
            *self._of_files(),
            f"{self.stands.sum()} of {len(self.scenes)} scenes stand for {self.config.seconds:g} s "
            f"(no object moved more than {limits}, by either detector of MuJoCo's)",
        ]
        if self.has_own_limits:
            lines.append("limits of the bank's own recipe (`stability`), not the usual ones")
        if len(shift):
            lines.append(
                f"movement of {len(shift)} objects: median {small_length(np.median(shift))}, "
                f"99th percentile {small_length(np.percentile(shift, 99))}, "
                f"most {small_length(shift.max())} and {turn.max():.2f} deg"
            )
        if num_changed := sum(map(bool, self.changed_files)):
            lines.append(
                f"  {num_changed} scenes do not count: files that they are made of were changed"
            )
        for each in self.scenes:
            if each.fault:
                lines.append(f"  {each.path.name}: {each.fault}")
            elif not each.stands:
                far = small_length(each.shift.max())
                moved = f"{each.worst} moved {far} with the detector {each.detector}"
                lines.append(f"  {each.path.name}: {moved}")
        return "\n".join(lines)

    def _of_files(self) -> Iterator[str]:
        if self.is_unchecked:
            yield f"note: {self.path} has no digests of its files (made before they were kept)"
        if self.changes:
            number = len(self.changes)
            yield f"files of {self.path} that are not what `cluttergen generate` wrote ({number}):"
            yield from (f"  {change.name}: {change.what}" for change in self.changes[:_SHOWN])
            if number > _SHOWN:
                yield f"  and {number - _SHOWN} more"
            yield "  the same `cluttergen generate` again mends them; what is not in bank.json, remove"


def verify_files(
    path: Path,
    check: VerifyConfig,
    jobs: int = 0,
    cluster: Cluster | None = None,
    allow_unchecked: bool = False,
) -> VerificationReport:
    """How the files of a bank, or one file, behave; see `cluttergen_jax.verify`."""
    check_workers("jobs", jobs)
    check_utf8(path)
    fetch_scenes(path)
    files = scene_files(path)
    bank = read_bank(path) if (path / INDEX).is_file() else None
    is_unchecked = bank is not None and bank.files is None
    if is_unchecked and not allow_unchecked:
        raise BankError(
            f"{path}: bank.json has no digests of the bank's files",
            "a bank that knows its files",
            f"{AGAIN}; or `allow_unchecked`, to simulate the files as they are",
        )
    limits = _limits_of(path, bank, check)
    has_own_limits = limits != check
    check = limits
    changes = [] if bank is None else changes_of(bank)
    if cluster is None:
        checks = _check_here(files, check, jobs)
    else:
        checks = each_on(cluster, partial(_checker, check), files, "file")
    with closing(checks):
        found = dict(track(checks, "verifying", len(files), "scene"))
    scenes = tuple(found[place] for place in range(len(files)))
    changed = tuple(
        tuple(changes_to_scene(changes or [], each.path.name, each.objects)) for each in scenes
    )
    kept = None if changes is None else tuple(changes)
    report = VerificationReport(
        path, check, scenes, kept, changed, is_unchecked, has_own_limits=has_own_limits
    )
    file = path / "verification.json"
    try:
        if path.is_dir():
            write_atomically(file, (json.dumps(report.as_json(), indent=1) + "\n").encode())
    except OSError as error:
        return replace(report, unwritten=f"{file} was not written ({error.strerror})")
    return report


def _limits_of(path: Path, bank: Bank | None, check: VerifyConfig) -> VerifyConfig:
    """The check with the limits that a bank, or a scene file's bank, was asked for in place of usual ones."""
    if bank is None and (path.parent.parent / INDEX).is_file():
        with suppress(BankError):
            bank = read_bank(path.parent.parent)
    if bank is None:
        return check
    usual = StabilityConfig()
    asked = bank.stability
    if (
        check.max_shift == VerifyConfig.max_shift
        and asked.stand_full_shift != usual.stand_full_shift
    ):
        check = replace(check, max_shift=asked.stand_full_shift)
    if (
        check.max_turn_deg == VerifyConfig.max_turn_deg
        and asked.stand_full_turn != usual.stand_full_turn
    ):
        check = replace(check, max_turn_deg=math.degrees(asked.stand_full_turn))
    return check


def _check_here(
    files: Sequence[Path], check: VerifyConfig, jobs: int
) -> Generator[tuple[int, Verification], None, None]:
    """Each file's place and how it behaves, in threads of this process."""
    with ThreadPoolExecutor(jobs or os.cpu_count() or 1) as pool:
        try:
            yield from enumerate(pool.map(_checker(check), files))
        finally:
            # Leaving the pool waits for what has begun; what has not is not to begin.
            pool.shutdown(wait=False, cancel_futures=True)


def _checker(check: VerifyConfig) -> Callable[[Path], Verification]:
    # MuJoCo keeps meshes that it has read, and takes a file of the same second for the one that it knows.
    mujoco.mj_clearCache(mujoco.mj_getCache())
    return partial(_verify_or_report, config=check)


def _verify_or_report(path: Path, config: VerifyConfig) -> Verification:
    """As `verify_scene`; a file of a bank that cannot be simulated is reported as not stable (`fault`)."""
    try:
        return verify_scene(path, config)
    except BankError as error:
        if not (path.parent.parent / INDEX).is_file():
            raise
        return Verification(
            path=path,
            shift=np.zeros(0),
            turn=np.zeros(0),
            stands=False,
            fault=error.given.removeprefix(f"{path}: "),
        )


def verify_scene(path: str | Path, config: VerifyConfig | None = None) -> Verification:
    """Simulates one MJCF file from its keyframe `scene`, at rest, with each of MuJoCo's detectors of convex
    collisions: with native CCD on, and off.

    Raises:
      BankError: the file cannot be loaded, has no such keyframe, or its bodies and keyframe disagree.
      UnsafePathError: the file is one of a bank, and names files outside of that bank.
    """
    config = config or VerifyConfig()
    path = Path(path)
    if (path.parent.parent / INDEX).is_file():
        _check_links(path, path.parent.parent)
    try:
        with silent_log():
            model, key = _load_model(path)
            found = [
                check_standing(model, key, config.seconds, config.limits, detector)
                for detector in DETECTORS
            ]
    except mujoco.FatalError as error:
        raise BankError(f"{path} cannot be simulated: {error}", _OURS) from error
    worst = max(found, key=lambda each: (not each.stands, float(each.shift.max())))
    return Verification(path=path, **vars(worst))


def _check_links(path: Path, bank: Path) -> None:
    """Refuses a bank's scene file that makes MuJoCo read what is not the bank's."""
    try:
        elements = list(ET.parse(path).iter())
    except (OSError, ET.ParseError):
        # What cannot be parsed is for MuJoCo to explain.
        return
    if any(element.tag == "include" for element in elements):
        raise UnsafePathError(f"{path} includes another file", _OURS)
    folders = {element.get(name, ".") for element in elements for name in _FOLDERS}
    for folder in (path.parent / each for each in folders):
        if not Path(os.path.realpath(folder)).is_relative_to(os.path.realpath(bank)):
            raise UnsafePathError(f"{path} names the folder {folder}", f"folders of {bank}")
        for element in elements:
            for attribute in element.attrib:
                if attribute.startswith("file"):
                    inside(folder, element.get(attribute))


def _load_model(path: Path) -> tuple[mujoco.MjModel, int]:
    """The model of a scene file, and its keyframe `scene`."""
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
        model.names.decode()
    except (ValueError, OSError) as error:
        reason = " ".join(str(error).split())
        raise BankError(
            f"{path} cannot be loaded: {reason}", _OURS, "generating the bank again"
        ) from error
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "scene")
    if key < 0:
        raise BankError(f"{path} has no keyframe called 'scene'", _OURS)
    if not model.njnt or (model.jnt_type != mujoco.mjtJoint.mjJNT_FREE).any():
        raise BankError(f"{path} holds no free bodies, or joints of another kind", _OURS)
    if not np.allclose(model.key_qpos[key], model.qpos0, atol=1e-6):
        raise BankError(f"{path}: the bodies' poses and the keyframe 'scene' differ")
    if not _SHORTEST_STEP <= model.opt.timestep <= _LONGEST_STEP:
        allowed = f"{_SHORTEST_STEP} to {_LONGEST_STEP} s"
        raise BankError(f"{path}: its time step is {model.opt.timestep:g} s", allowed)
    return model, key


def scene_files(path: str | Path) -> list[Path]:
    """The MJCF files of a bank, or the one that is given (BankError: there is nothing to verify)."""
    path = Path(path)
    if path.suffix in (".parquet", ".json"):
        raise BankError(f"{path} is a part of a bank", _GIVEN, f"cluttergen verify {path.parent}")
    if path.is_file():
        return [path]
    files = sorted((path / "scenes").glob("*.xml"))
    if not files:
        raise BankError(
            f"{path} holds no scene files",
            _GIVEN,
            "cluttergen generate --out DIR, which writes files unless it is told otherwise",
        )
    return files
