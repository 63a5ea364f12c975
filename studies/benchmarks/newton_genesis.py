"""How many saved scenes of a bank stand in Newton or in Genesis, loaded from their MJCF files.

It imports nothing of cluttergen_jax: each of the two wants an environment of its own. What counts as standing
is what `cluttergen verify` asks for. Newton steps with its MuJoCo solver on the CPU; Genesis with its own
rigid solver, told of the friction that the files state. Both compile for minutes the first time.

    python -m venv newton && newton/bin/pip install "newton[sim,importers]==1.8.0"
    newton/bin/python studies/benchmarks/newton_genesis.py newton BANK --num-scenes 50
    python -m venv genesis && genesis/bin/pip install torch genesis-world==1.4.5
    genesis/bin/python studies/benchmarks/newton_genesis.py genesis BANK --num-scenes 50
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

_SECONDS = 10.0
_STRIDE = 12
_MAX_SHIFT = 0.005
_MAX_TURN = np.radians(5.0)

Poses = tuple[np.ndarray, np.ndarray]
"""Positions f[N, 3] and unit quaternions f[N, 4] of all bodies."""


def newton_poses(path: Path, timestep: float) -> Iterator[Poses]:
    """Poses at the start and after every `_STRIDE` steps in Newton."""
    import newton

    builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(str(path), parse_visuals=False)
    model = builder.finalize()
    before = model.state()
    after = model.state()
    control = model.control()
    newton.eval_fk(model, model.joint_q, model.joint_qd, before)
    solver = newton.solvers.SolverMuJoCo(model, use_mujoco_cpu=True)
    while True:
        poses = before.body_q.numpy()
        yield poses[:, :3].copy(), poses[:, 3:].copy()
        for _ in range(_STRIDE):
            before.clear_forces()
            solver.step(before, after, control, None, timestep)
            before, after = after, before


def genesis_poses(path: Path, timestep: float) -> Iterator[Poses]:
    """Poses at the start and after every `_STRIDE` steps in Genesis."""
    import genesis

    options = genesis.options
    touch = options.RigidOptions(
        friction_cone=genesis.friction_cone.elliptic, enable_torsional_friction=True
    )
    scene = genesis.Scene(
        sim_options=options.SimOptions(dt=timestep), rigid_options=touch, show_viewer=False
    )
    entity = scene.add_entity(genesis.morphs.MJCF(file=str(path)))
    scene.build()
    while True:
        yield entity.get_links_pos().numpy().copy(), entity.get_links_quat().numpy().copy()
        for _ in range(_STRIDE):
            scene.step()


def stands(path: Path, engine: Callable[[Path, float], Iterator[Poses]]) -> bool:
    """Whether no object of a scene file moves by more than 5 mm or 5 degrees within 10 s."""
    timestep = float(mujoco.MjModel.from_xml_path(str(path)).opt.timestep)
    poses = engine(path, timestep)
    position, quat = next(poses)
    for _ in range(round(_SECONDS / timestep / _STRIDE)):
        now, turned = next(poses)
        shift = np.linalg.norm(now - position, axis=1)
        # Twice the angle between unit quaternions, of which q and -q are one.
        turn = 2 * np.arccos(np.clip(np.abs((turned * quat).sum(1)), 0.0, 1.0))
        # What is not a number is not below either.
        if not ((shift <= _MAX_SHIFT) & (turn <= _MAX_TURN)).all():
            return False
    return True


def _begin(name: str) -> tuple[str, Callable[[Path, float], Iterator[Poses]]]:
    """The engine's name with its version, and its poses, once it is set up for a CPU."""
    if name == "genesis":
        import genesis

        genesis.init(backend=genesis.cpu, precision="32", logging_level="error")
        return f"Genesis {genesis.__version__}", genesis_poses
    import newton
    import warp

    warp.set_device("cpu")
    return f"Newton {newton.__version__}", newton_poses


def main() -> None:
    """Prints a line for each bank."""
    as_written = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=as_written)
    parser.add_argument("engine", choices=("newton", "genesis"))
    parser.add_argument(
        "banks", nargs="+", type=Path, help="folders that `cluttergen generate` wrote"
    )
    parser.add_argument(
        "--num-scenes", type=int, default=50, help="the first so many files of each"
    )
    given: Any = parser.parse_args()
    name, engine = _begin(given.engine)
    for bank in given.banks:
        files = sorted((bank / "scenes").glob("*.xml"))[: given.num_scenes]
        began = time.process_time()
        number = 0
        for file in files:
            is_stable = stands(file, engine)
            number += is_stable
            if not is_stable:
                print(f"{file.name} does not stand", flush=True)
        seconds = time.process_time() - began
        print(
            f"{bank}: {number} of {len(files)} scenes stand 10 s in {name}, {seconds:.0f} CPU-s",
            flush=True,
        )


if __name__ == "__main__":
    main()
