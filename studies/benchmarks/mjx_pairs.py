"""Engine `jax` on a CPU: one collision function for all pairs beside MJX's own, a function a pair.

Scenes of the objects in a row, let go and watched to the end of an attempt and of the last check, each case
in a process of its own; nothing is taken from a compilation cache.

    python -m studies.benchmarks.mjx_pairs [--write]
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from mujoco import mjx

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.physics import mjx_scenes
from cluttergen_jax.physics.mjx_pairs import faces_first
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.problem import ProblemConfig, compose
from studies.benchmarks.section import prose, report, table

ONE_HULL = ("soup_can", "cereal_box", "hardback_book")
_LONGEST = 3600.0


@dataclass(frozen=True)
class MjxPairs:
    """Time the compilation and the run of engine `jax`.

    Attributes:
      num_scenes: side by side.
      write: renew this program's section of reports/benchmarks.md.
      case: what a child process does; for this program's own use.
    """

    num_scenes: int = 16
    write: bool = False
    case: str = ""


class _OwnOfMjx:
    """MJX's collisions in place of `Pairs`."""

    def __init__(self, *given: object) -> None:
        del given

    def replacing_mjx(self) -> AbstractContextManager[None]:
        return faces_first()

    def has_overflowed(self, model: mjx.Model, data: mjx.Data) -> jax.Array:
        del model, data
        return jnp.asarray(False)

    def find_contacts(self, model: mjx.Model, data: mjx.Data) -> mjx.Data:
        return mjx.collision(model, data)


def measure(case: str, num_scenes: int) -> dict[str, Any]:
    """Seconds of compilation and run, and the verdicts, of one case."""
    jax.config.update("jax_enable_compilation_cache", False)
    engine, objects = case.split(":")
    if engine == "own":
        mjx_scenes.Pairs = _OwnOfMjx  # type: ignore[assignment,misc]
    pool = find_pool("all")
    chosen = (
        tuple(pool[name] for name in ONE_HULL)
        if objects == "three"
        else find_pool("dining").objects
    )
    config = ProblemConfig(
        engine="native" if engine == "native" else "jax",
        placement=PlacementConfig(num_objects=len(chosen)),
    )
    physics = compose(chosen, find_support("table"), config).rules.physics
    layout: Any = getattr(physics, "layout", None) or physics._engine.layout  # type: ignore[attr-defined]
    rng = np.random.default_rng(0)
    poses = np.tile(layout.parked.astype(np.float32), (num_scenes, 1, 1))
    is_placed = np.zeros(poses.shape[:2], bool)
    for k, asset in enumerate(chosen[:3]):
        poses[:, k, :2] = rng.uniform(-0.02, 0.02, (num_scenes, 2)) + np.array([0.2 * (k - 1), 0.0])
        poses[:, k, 2] = layout.top + asset.half_extents[2] + 0.001
        poses[:, k, 3:] = (1, 0, 0, 0)
        is_placed[:, k] = True
    focus = np.zeros(num_scenes, int)
    is_active = np.ones(num_scenes, bool)
    told: dict[str, Any] = {"parts": layout.model.ngeom - 1}
    settle = jax.vmap(physics.settle)
    stand = jax.vmap(physics.stand)
    for name, function, given in (
        ("attempt", settle, (poses, is_placed, focus, is_active)),
        ("last check", stand, (poses, is_placed, is_active)),
    ):
        start = time.monotonic()
        arrays = [jnp.asarray(each) for each in given]
        compiled = jax.jit(function).lower(*arrays).compile()
        told[f"{name}: compile s"] = time.monotonic() - start
        start = time.monotonic()
        found = jax.block_until_ready(compiled(*arrays))
        told[f"{name}: run s"] = time.monotonic() - start
        told[f"{name}: stable"] = int((np.asarray(found.verdict) == 0).sum())
    return told


def main(config: MjxPairs) -> None:
    """Runs every case in a process of its own."""
    if config.case:
        print(json.dumps(measure(config.case, config.num_scenes)))
        return
    cases = ("own:three", "one:three", "native:three", "one:ten", "native:ten")
    rows = []
    for case in cases:
        number = str(config.num_scenes)
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.mjx_pairs", "--case", case, "--num-scenes", number],
            env=os.environ | {"JAX_PLATFORMS": "cpu"},
            capture_output=True,
            text=True,
            check=True,
            timeout=_LONGEST,
        )
        told = json.loads(done.stdout.splitlines()[-1])
        engine = {
            "own": "MJX's own functions",
            "one": "one for all pairs",
            "native": "engine native",
        }
        kind, objects = case.split(":")
        rows.append([f"{objects} objects, {told.pop('parts')} parts", engine[kind], *_cells(told)])
        print(rows[-1], file=sys.stderr, flush=True)
    header = [
        "scenes",
        "collisions",
        *(f"{a}: {b}" for a in ("attempt", "last check") for b in _COLUMNS),
    ]
    text = prose(f"""
        {config.num_scenes} scenes of three objects in a row (of ten dining objects seven are parked), let go
        once; everything is compiled anew. MJX's own functions are not compiled for ten dining objects: there
        are thousands of pairs.
    """)
    body = f"## Engine jax on a CPU\n\n{text}\n\n{table(header, rows)}"
    report("mjx_pairs", body, write=config.write, packages=("mujoco", "mujoco-mjx", "jax"))


_COLUMNS = ("compile s", "run s", "stable")


def _cells(told: dict[str, Any]) -> list[str]:
    return [f"{value}" if isinstance(value, int) else f"{value:.2f}" for value in told.values()]


if __name__ == "__main__":
    main(tyro.cli(MjxPairs))
