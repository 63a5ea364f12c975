"""Layouts with noise, repaired: how many are stable, what moved by how much, and CPU-seconds.

Scenes of a bank are disturbed: every object is shifted by so many millimetres in a random direction, and
turned by so many degrees about a random axis.

    python -m studies.benchmarks.repair --bank out/dining --write
"""

from __future__ import annotations

import json
import resource
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

import cluttergen_jax as cg
from cluttergen_jax.geometry import product
from cluttergen_jax.placement.world import base_name
from studies.benchmarks.section import prose, report, table


@dataclass(frozen=True)
class Repairing:
    """What is repaired.

    Attributes:
      banks: of stable scenes.
      number: of layouts of each.
      noise: millimetres and degrees, pairs.
      seed: of the noise.
      verified: so many of the repaired scenes are simulated for 10 s, with both detectors.
      write: put the table into reports/benchmarks.md.
    """

    banks: tuple[Path, ...]
    number: int = 100
    noise: tuple[tuple[float, float], ...] = ((10.0, 10.0),)
    seed: int = 0
    verified: int = 20
    write: bool = False


def disturb(poses: np.ndarray, shift: float, turn: float, draw: np.random.Generator) -> np.ndarray:
    """f64[N, 7]: poses shifted by so many metres and turned by so many radians, in random directions."""
    way, axis = draw.normal(size=(2, len(poses), 3))
    way, axis = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in (way, axis))
    turns = np.c_[np.full(len(poses), np.cos(turn / 2)), np.sin(turn / 2) * axis]
    return np.c_[poses[:, :3] + shift * way, product(turns, poses[:, 3:])]


def write_disturbed(
    scenes: Sequence[cg.Scene],
    folder: Path,
    support: str,
    millimetres: float,
    degrees: float,
    seed: int,
) -> None:
    """Writes scenes with noise as files that `cluttergen repair` reads."""
    draw = np.random.default_rng(seed)
    for number, scene in enumerate(scenes):
        poses = disturb(scene.poses, millimetres / 1000, np.radians(degrees), draw)
        objects = [
            {
                "name": name,
                "asset": base_name(name),
                "position": pose[:3].tolist(),
                "quaternion_wxyz": pose[3:].tolist(),
            }
            for name, pose in zip(scene.names, poses, strict=True)
        ]
        record = {"pool": scene.origin.pool, "support": support, "objects": objects}
        (folder / f"{number:04d}.json").write_text(json.dumps(record))


def rests_on(scene: cg.Scene) -> set[tuple[str, str]]:
    """Which object lies on which, told by contacts that carry."""
    from cluttergen_jax.config import StabilityConfig
    from cluttergen_jax.physics.margin import OverlapProbe
    from cluttergen_jax.placement.world import make_world

    world = make_world(scene.objects, scene.support, StabilityConfig(), scene.contact)
    probe = OverlapProbe(world.layout)
    probe.depths(scene.poses, np.ones(len(scene.names), bool))
    return {
        (scene.names[place], scene.names[below])
        for place in range(len(scene.names))
        for below in np.flatnonzero(probe.bearers(place))
    }


def _cpu() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def row_of(bank: cg.Bank, millimetres: float, degrees: float, config: Repairing) -> list[str]:
    """One bank with one noise."""
    scenes = list(cg.read_scenes(bank))[: config.number]
    with tempfile.TemporaryDirectory() as name:
        noisy, first, out = (Path(name, each) for each in ("noisy", "first", "out"))
        for folder, chosen in ((noisy, scenes), (first, scenes[:1])):
            folder.mkdir()
            write_disturbed(
                chosen, folder, bank.recipe["support"], millimetres, degrees, config.seed
            )
        # What has to be compiled is compiled before.
        cg.repair(first, Path(name, "warm"))
        before = _cpu()
        found = cg.repair(noisy, out)
        seconds = (_cpu() - before) / len(scenes)
        rows = cg.read_bank(out).rows(range(len(scenes)))
        kept = asked = 0
        for number, (scene, layout) in enumerate(zip(scenes, found.layouts, strict=True)):
            if rows[number].is_success:
                wanted = rests_on(scene)
                now = rests_on(_moved(scene, layout.poses))
                kept = kept + len(wanted & now)
                asked = asked + len(wanted)
        files = sorted((out / "scenes").glob("*.xml"))[: config.verified]
        stands = [cg.verify(file).is_sound for file in files]
    shift = 1000 * np.concatenate([each.shift[each.is_placed] for each in found.layouts])
    turn = np.degrees(np.concatenate([each.turn[each.is_placed] for each in found.layouts]))
    return [
        f"{bank.path.name}, {millimetres:g} mm, {degrees:g} deg",
        f"{len(scenes)}",
        f"{np.mean([each.is_stable for each in found.layouts]):.3f}",
        f"{sum(stands)} of {len(stands)}",
        f"{np.median(shift):.1f}",
        f"{np.percentile(shift, 99):.1f}",
        f"{shift.max():.1f}",
        f"{np.median(turn):.1f}",
        f"{kept} of {asked}",
        f"{seconds:.2f}",
    ]


def _moved(scene: cg.Scene, poses: np.ndarray) -> cg.Scene:
    return cg.Scene(
        scene.names, scene.objects, poses, scene.support, scene.stability, scene.contact
    )


def main(config: Repairing) -> None:
    """Repairs every bank with every noise."""
    rows = [
        row_of(cg.read_bank(path), millimetres, degrees, config)
        for path in config.banks
        for millimetres, degrees in config.noise
    ]
    header = [
        "",
        "layouts",
        "stable",
        "10 s",
        "median mm",
        "99 %",
        "most",
        "median deg",
        "lies on",
        "CPU-s",
    ]
    text = prose("""
        `cluttergen repair` of scenes that were disturbed: every object shifted and turned by so much, in
        random directions. Stable: all objects placed, and the final check passed; 10 s: of the first ones,
        by `cluttergen verify`. Motion is from the disturbed poses. Lies on: contacts by which one object
        carried another before the noise that are there after the repair. CPU-s: of a layout, in a process
        in which all is compiled, files written included.
    """)
    report("repair", f"## Repair\n\n{text}\n\n{table(header, rows)}", write=config.write)


if __name__ == "__main__":
    main(tyro.cli(Repairing))
