"""What a scene costs in steps of MuJoCo, in this version and in an earlier one: a ratio for any machine.

    python -m studies.benchmarks.scene_steps [--write]

CPU-seconds of whole commands, files included, one thread: 1,024 dining scenes less 256, so that neither
compiling nor the start counts. A step is one of MuJoCo's, 1/240 s, with all ten objects of a scene awake.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import tyro

from studies.benchmarks.section import ROOT, prose, report, table
from studies.benchmarks.waiting import Version, checkout

_FEW = 256
_MANY = 1024
_STEP = 1 / 240
_AWAKE_STEPS = 300
_AWAKE_SCENES = 40


@dataclass(frozen=True)
class SceneSteps:
    """What is compared.

    Attributes:
      before: a commit.
      methods: that make the scenes.
      rounds: in which the versions take turns.
      write: put the table into reports/benchmarks.md.
    """

    before: str = "6db047c"
    methods: tuple[str, ...] = ("clear", "guided")
    rounds: int = 3
    write: bool = False


def scene_seconds(version: Version, method: str) -> float:
    """CPU-seconds of a scene."""
    used = []
    for number in (_FEW, _MANY):
        shutil.rmtree(version.folder / "out", ignore_errors=True)
        words = (
            "--num-scenes",
            str(number),
            "--max-files",
            str(number),
            "--threads",
            "1",
            "--no-render",
        )
        seconds = version.seconds(("generate", "--method", method, *words, "--out", "OUT"))
        if seconds is None:
            raise SystemExit(f"{method}: the command failed")
        used.append(seconds)
    return (used[1] - used[0]) / (_MANY - _FEW)


def step_seconds(folder: Path) -> float:
    """CPU-seconds of a step of the scenes in a folder, everything awake and at rest."""
    seconds = 0.0
    files = sorted(folder.glob("*.xml"))[:_AWAKE_SCENES]
    for file in files:
        model = mujoco.MjModel.from_xml_path(str(file))
        model.opt.timestep = _STEP
        model.opt.enableflags = 0
        model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, model.key("scene").id)
        mujoco.mj_step(model, data, _AWAKE_STEPS // 5)
        began = time.process_time()
        mujoco.mj_step(model, data, _AWAKE_STEPS)
        seconds += time.process_time() - began
    return seconds / (_AWAKE_STEPS * len(files))


def main(config: SceneSteps) -> None:
    """Prints the table."""
    rows: dict[tuple[str, str], list[float]] = {}
    steps: list[float] = []
    with checkout(config.before) as code, tempfile.TemporaryDirectory() as name:
        versions = {}
        for told, each in ((config.before, code), ("now", ROOT)):
            folder = Path(name, told)
            folder.mkdir()
            versions[told] = Version(each, folder)
            for method in config.methods:
                # Compiles, and is not counted.
                scene_seconds(versions[told], method)
        for _ in range(config.rounds):
            for told, version in versions.items():
                for method in config.methods:
                    rows.setdefault((told, method), []).append(scene_seconds(version, method))
                    print(told, method, rows[told, method][-1], file=sys.stderr, flush=True)
            steps.append(step_seconds(versions["now"].folder / "out" / "scenes"))
    step = float(np.median(steps))
    body = [
        [told, method, f"{1e3 * np.median(each):.1f}", f"{np.median(each) / step:.0f}"]
        for (told, method), each in rows.items()
    ]
    text = prose(f"""
        Medians of {config.rounds} rounds in which the versions take turns. A step costs {1e6 * step:.0f} us.
        Since {config.before} every scene is checked with the second of MuJoCo's detectors, too.
    """)
    header = ["version", "method", "CPU ms a scene", "steps a scene"]
    report(
        "scene_steps", f"## A scene in steps\n\n{text}\n\n{table(header, body)}", write=config.write
    )


if __name__ == "__main__":
    main(tyro.cli(SceneSteps))
