"""`cluttergen verify`: every saved scene, loaded afresh in plain MuJoCo, for ten seconds."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import tyro

from cluttergen_jax.config import VerifyConfig, check_workers
from cluttergen_jax.files import write_atomically
from cluttergen_jax.progress import tracked

if TYPE_CHECKING:
    from cluttergen_jax.bank.digests import Change
    from cluttergen_jax.bank.verify import Verification

_SHOWN = 20


@dataclass(frozen=True)
class Verify:
    """Check that saved scenes stand: plain MuJoCo, everything awake. Exit status 1 if one does not.

    Of a bank, its files are compared with the digests in bank.json as well: a scene of which a file was
    changed does not count.

    Example: `cluttergen verify out`

    Attributes:
      path: a bank, or one MJCF file with a keyframe called scene.
      check: how long, and what counts as standing.
      jobs: scenes simulated at a time; 0 takes every core.
    """

    path: tyro.conf.Positional[str]
    check: VerifyConfig = field(default_factory=VerifyConfig)
    jobs: int = 0

    def run(self) -> int:
        """Runs the command; the exit status."""
        import mujoco

        from cluttergen_jax.bank.digests import touched
        from cluttergen_jax.bank.verify import scene_files, verify_scene

        check_workers("--jobs", self.jobs)
        files = scene_files(self.path)
        changes = _changes(Path(self.path))
        # MuJoCo keeps meshes that it has read, and takes a file of the same second for the one that it knows.
        mujoco.mj_clearCache(mujoco.mj_getCache())
        jobs = self.jobs or os.cpu_count() or 1
        with ThreadPoolExecutor(jobs) as pool:
            checks = pool.map(lambda file: verify_scene(file, self.check), files)
            try:
                results = list(tracked(checks, "verifying", len(files), "scene"))
            except BaseException:
                # Leaving the pool waits for what has begun; what has not is not to begin.
                pool.shutdown(wait=False, cancel_futures=True)
                raise
        records = [_record(each, touched(changes, each.path.name, each.objects)) for each in results]
        print(report_of(results, self.check, [bool(each["changed_files"]) for each in records]))
        if Path(self.path).is_dir():
            _keep(Path(self.path) / "verification.json", (json.dumps(records, indent=1) + "\n").encode())
        return 0 if all(each["stands"] for each in records) and not changes else 1


def _changes(path: Path) -> list[Change]:
    """The changed files of a bank, and says them; none for a single file."""
    from cluttergen_jax.bank import read_bank
    from cluttergen_jax.bank.bank import INDEX
    from cluttergen_jax.bank.digests import changes_of

    if not (path / INDEX).is_file():
        return []
    changes = changes_of(read_bank(path))
    if changes is None:
        print(f"note: {path} has no digests of its files (made before they were kept)")
    elif changes:
        shown = "".join(f"\n  {change.name}: {change.what}" for change in changes[:_SHOWN])
        more = f"\n  and {len(changes) - _SHOWN} more" if len(changes) > _SHOWN else ""
        print(f"files of {path} that are not what `cluttergen generate` wrote ({len(changes)}):{shown}{more}")
        print("  the same `cluttergen generate` again mends them; what is not in bank.json, remove")
    return changes or []


def _keep(path: Path, record: bytes) -> None:
    """Writes the record beside the scenes; where nothing can be written, the verdict was still given."""
    try:
        write_atomically(path, record)
    except OSError as error:
        print(f"note: {path} was not written ({error.strerror})", file=sys.stderr)


def _record(result: Verification, changed: list[str]) -> dict:
    moved = {
        name: [float(shift), float(turn)]
        for name, shift, turn in zip(result.objects, result.shift, result.turn, strict=True)
    }
    return {
        "file": result.path.name,
        "stands": result.stands and not changed,
        "changed_files": changed,
        "shift_m_and_turn_rad": moved,
    }


def report_of(results: list[Verification], config: VerifyConfig, is_changed: Sequence[bool]) -> str:
    """Which scenes stand, and how far objects moved; those of changed files do not count."""
    from cluttergen_jax.types import small_length

    stands = np.array([each.stands for each in results]) & ~np.array(is_changed)
    shift = np.concatenate([each.shift for each in results])
    turn = np.degrees(np.concatenate([each.turn for each in results]))
    lines = [
        f"{stands.sum()} of {len(stands)} scenes stand for {config.seconds:g} s "
        f"(no object moved more than {config.max_shift * 1000:g} mm or {config.max_turn_deg:g} deg)",
        f"movement of {len(shift)} objects: median {small_length(np.median(shift))}, "
        f"99th percentile {small_length(np.percentile(shift, 99))}, "
        f"most {small_length(shift.max())} and {turn.max():.2f} deg",
    ]
    if any(is_changed):
        lines.append(f"  {sum(is_changed)} scenes do not count: files that they are made of were changed")
    for each in results:
        if not each.stands:
            lines.append(f"  {each.path.name}: {each.worst} moved {small_length(each.shift.max())}")
    return "\n".join(lines)
