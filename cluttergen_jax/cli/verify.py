"""`cluttergen verify`: every saved scene, loaded afresh in plain MuJoCo, for ten seconds."""

from __future__ import annotations

import json
import os
import sys
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
    from cluttergen_jax.bank.verify import Verification


@dataclass(frozen=True)
class Verify:
    """Check that saved scenes stand: plain MuJoCo, everything awake. Exit status 1 if one does not.

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
        from cluttergen_jax.bank.verify import scene_files, verify_scene

        check_workers("--jobs", self.jobs)
        files = scene_files(self.path)
        jobs = self.jobs or os.cpu_count() or 1
        with ThreadPoolExecutor(jobs) as pool:
            checks = pool.map(lambda file: verify_scene(file, self.check), files)
            try:
                results = list(tracked(checks, "verifying", len(files), "scene"))
            except BaseException:
                # Leaving the pool waits for what has begun; what has not is not to begin.
                pool.shutdown(wait=False, cancel_futures=True)
                raise
        print(report_of(results, self.check))
        if Path(self.path).is_dir():
            record = json.dumps([_record(each) for each in results], indent=1) + "\n"
            _keep(Path(self.path) / "verification.json", record.encode())
        return 0 if all(each.stands for each in results) else 1


def _keep(path: Path, record: bytes) -> None:
    """Writes the record beside the scenes; where nothing can be written, the verdict was still given."""
    try:
        write_atomically(path, record)
    except OSError as error:
        print(f"note: {path} was not written ({error.strerror})", file=sys.stderr)


def _record(result: Verification) -> dict:
    moved = {
        name: [float(shift), float(turn)]
        for name, shift, turn in zip(result.objects, result.shift, result.turn, strict=True)
    }
    return {"file": result.path.name, "stands": result.stands, "shift_m_and_turn_rad": moved}


def report_of(results: list[Verification], config: VerifyConfig) -> str:
    """Which scenes stand, and how far objects moved."""
    stands = np.array([each.stands for each in results])
    shift = np.concatenate([each.shift for each in results]) * 1000
    turn = np.degrees(np.concatenate([each.turn for each in results]))
    lines = [
        f"{stands.sum()} of {len(stands)} scenes stand for {config.seconds:g} s "
        f"(no object moved more than {config.max_shift * 1000:g} mm or {config.max_turn_deg:g} deg)",
        f"movement of {len(shift)} objects: median {np.median(shift):.3f} mm, "
        f"99th percentile {np.percentile(shift, 99):.3f} mm, "
        f"most {shift.max():.3f} mm and {turn.max():.2f} deg",
    ]
    for each in results:
        if not each.stands:
            lines.append(f"  {each.path.name}: {each.worst} moved {each.shift.max() * 1000:.1f} mm")
    return "\n".join(lines)
