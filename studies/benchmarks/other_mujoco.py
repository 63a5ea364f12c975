"""How many saved scenes of a bank stand in the MuJoCo of this interpreter, whatever its version is.

It imports nothing of cluttergen_jax, which needs a recent MuJoCo: an environment with `mujoco` alone will do.
What counts as standing is what `cluttergen verify` asks for. Each file says which of MuJoCo's two detectors
of convex collisions it wants; `--libccd` and `--native` take the older and the newer one instead.

    python -m venv other && other/bin/pip install mujoco==3.10.0
    other/bin/python studies/benchmarks/other_mujoco.py BANK ...
"""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import mujoco
import numpy as np

_SECONDS = 10.0
_STRIDE = 12
_MAX_SHIFT = 0.005
_MAX_TURN = np.radians(5.0)


def _bit(kind: type, name: str) -> int:
    """A flag, 0 in a MuJoCo that does not know it."""
    return int(getattr(kind, name, 0))


def stands(path: Path, detector: str) -> bool:
    """Whether no object of a scene file moves by more than 5 mm or 5 degrees within 10 s, all awake."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.enableflags &= ~_bit(mujoco.mjtEnableBit, "mjENBL_SLEEP")
    model.opt.disableflags |= _bit(mujoco.mjtDisableBit, "mjDSBL_AUTORESET")
    if detector == "libccd":
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
    elif detector == "native":
        model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("scene").id)
    data.qvel[:] = 0
    start = data.qpos.reshape(-1, 7).copy()
    for _ in range(round(_SECONDS / model.opt.timestep / _STRIDE)):
        mujoco.mj_step(model, data, _STRIDE)
        poses = data.qpos.reshape(-1, 7)
        shift = np.linalg.norm(poses[:, :3] - start[:, :3], axis=1)
        # Twice the angle between unit quaternions, of which q and -q are one.
        turn = 2 * np.arccos(np.clip(np.abs((poses[:, 3:] * start[:, 3:]).sum(1)), 0.0, 1.0))
        if not ((shift <= _MAX_SHIFT) & (turn <= _MAX_TURN)).all():
            return False
    return True


def main() -> None:
    """Prints a line for each bank."""
    as_written = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=as_written)
    parser.add_argument(
        "banks", nargs="+", type=Path, help="folders that `cluttergen generate` wrote"
    )
    parser.add_argument("--threads", type=int, default=2)
    for name in ("libccd", "native"):
        parser.add_argument(
            f"--{name}", action="store_const", const=name, default="", dest="detector"
        )
    given = parser.parse_args()
    check = partial(stands, detector=given.detector)
    for bank in given.banks:
        files = sorted((bank / "scenes").glob("*.xml"))
        number = 0
        with ThreadPoolExecutor(given.threads) as threads:
            for place, (file, is_stable) in enumerate(
                zip(files, threads.map(check, files), strict=True), 1
            ):
                number += is_stable
                if not is_stable or place % 50 == 0:
                    text = (
                        f"{number} of {place} stand" if is_stable else f"{file.name} does not stand"
                    )
                    print(text, file=sys.stderr, flush=True)
        print(f"{bank}: {number} of {len(files)} scenes stand 10 s in MuJoCo {mujoco.__version__}")


if __name__ == "__main__":
    main()
