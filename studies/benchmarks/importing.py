"""What importing an object costs, by kind, in this version and an earlier one, and how good the bodies are.

Both import the same files with `cluttergen import`, one worker, whose lines tell the cost of each object. The
earlier version is a commit of this repository. Ten minutes on two quiet cores; `--only` takes some kinds,
`--folder` your own files.
"""

from __future__ import annotations

import json
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import manifold3d
import numpy as np
import trimesh
import tyro

from cluttergen_jax.assets.modeller.catalog import make_shape
from studies.benchmarks.section import ROOT, prose, report, table
from studies.benchmarks.waiting import checkout

Manifold = manifold3d.Manifold
_LINE = re.compile(r"(\S+): (?:made in|failed after) [\d.]+ s, ([\d.]+) CPU-seconds")
_FAMILIES = (
    *("mug", "bowl", "bottle", "soup_can", "stapler", "camera", "scissors", "teapot", "wine_glass"),
    *("toaster", "hardback_book", "eyeglasses", "letter_tray", "toy_car"),
)
_HEADER = (
    *("", "objects", "CPU-s, median", "CPU-s, largest", "not made", "deviation, median"),
    *("deviation, largest", "parts, median", "stable in 99 %", "MB"),
)


@dataclass(frozen=True)
class Importing:
    """What is imported.

    Attributes:
      before: a commit.
      only: kinds, by name; all if empty.
      folder: import this instead.
      limit: CPU-seconds that an object may take.
      write: put the table into reports/benchmarks.md.
    """

    before: str = "b668d852"
    only: tuple[str, ...] = ()
    folder: Path | None = None
    limit: int = 120
    write: bool = False

    def __post_init__(self) -> None:
        if unknown := set(self.only) - KINDS.keys():
            raise SystemExit(f"no kinds {sorted(unknown)}: {', '.join(KINDS)}")


def box(x: float, y: float, z: float) -> Manifold:
    """A cuboid, millimetres."""
    return Manifold.cube((x / 1000, y / 1000, z / 1000), True)


def rod(radius: float, height: float, sides: int = 64) -> Manifold:
    """A cylinder about the z axis, millimetres."""
    return Manifold.cylinder(height / 1000, radius / 1000, radius / 1000, sides, True)


def _moved(solid: Manifold, x: float, y: float, z: float) -> Manifold:
    return solid.translate((x / 1000, y / 1000, z / 1000))


def gear(teeth: int, radius: float, height: float, bore: float) -> Manifold:
    """A disc with square teeth and a hole."""
    angle = np.linspace(0, 2 * np.pi, 4 * teeth, endpoint=False)
    radii = np.where(np.arange(4 * teeth) % 4 < 2, radius, 0.85 * radius) / 1000
    outline = np.column_stack([radii * np.cos(angle), radii * np.sin(angle)])
    return Manifold.extrude(manifold3d.CrossSection([outline]), height / 1000) - rod(
        bore, 3 * height
    )


def simple() -> dict[str, Manifold]:
    """Boxes, rods, and a few of them together."""
    return {
        "box": box(80, 50, 40),
        "plate": box(150, 100, 4),
        "rod": rod(30, 90),
        "disc": rod(50, 20),
        "prism": rod(25, 40, 6),
        "ball": Manifold.sphere(0.035, 32),
        "cone": Manifold.cylinder(0.08, 0.035, 0.005, 48),
        "l_shape": box(100, 30, 20) + _moved(box(20, 30, 80), -40, 0, 30),
        "t_shape": box(100, 30, 20) + _moved(box(20, 30, 80), 0, 0, 50),
        "u_channel": box(100, 60, 40) - _moved(box(120, 40, 40), 0, 0, 10),
        "cross": box(100, 30, 30) + box(30, 100, 30),
        "stairs": box(90, 50, 20)
        + _moved(box(60, 50, 20), 15, 0, 20)
        + _moved(box(30, 50, 20), 30, 0, 40),
    }


def fitting() -> dict[str, Manifold]:
    """Pegs, and what they go into."""
    four = [_moved(rod(6, 50), x, y, 0) for x in (-25, 25) for y in (-25, 25)]
    return {
        "peg": rod(8, 50),
        "flanged_peg": rod(4, 40) + _moved(rod(12, 5), 0, 0, -20),
        "bolt": rod(6, 40) + _moved(rod(12, 8, 6), 0, 0, -24),
        "hole_8mm": box(40, 40, 30) - rod(4.05, 50),
        "hole_16mm": box(50, 50, 30) - rod(8.05, 50),
        "socket": box(50, 50, 50) - _moved(rod(12.1, 50), 0, 0, 10),
        "square_hole": box(50, 50, 30) - box(16.5, 16.5, 50),
        "four_holes": box(80, 80, 20) - Manifold.batch_boolean(four, manifold3d.OpType.Add),
        "washer": rod(20, 3) - rod(10.5, 10),
        "nut": rod(12, 10, 6) - rod(6.5, 30),
        "tube": rod(20, 60) - rod(15, 100),
        "gear_12": gear(12, 15, 10, 4),
        "gear_20": gear(20, 30, 12, 5),
    }


def _union(solids: Iterable[Manifold]) -> Manifold:
    return Manifold.batch_boolean(list(solids), manifold3d.OpType.Add)


def basket() -> Manifold:
    """A round basket with twelve slots in its wall."""
    wall = Manifold.cylinder(0.12, 0.09, 0.11, 48)
    wall -= Manifold.cylinder(0.12, 0.084, 0.104, 48).translate((0, 0, 0.006))
    slots = [box(300, 12, 70).rotate((0, 0, 15 * k)).translate((0, 0, 0.065)) for k in range(12)]
    return wall - _union(slots)


def dish_rack() -> Manifold:
    """Rods of 6 mm, crossing, with two rows of upright ones."""
    places = np.linspace(-150, 150, 9)
    rods = [_moved(rod(3, 250, 12).rotate((90, 0, 0)), x, 0, 0) for x in places]
    rods += [_moved(rod(3, 300, 12).rotate((0, 90, 0)), 0, y, 0) for y in (-125, 125)]
    rods += [_moved(rod(3, 90, 12), x, y, 45) for x in places for y in (-60, 60)]
    return _union(rods)


def knot() -> Manifold:
    """A trefoil of a round cord."""
    turn = np.linspace(0, 2 * np.pi, 51)
    x = np.sin(turn) + 2 * np.sin(2 * turn)
    y = np.cos(turn) - 2 * np.cos(2 * turn)
    balls = [
        _moved(Manifold.sphere(0.012, 16), *each)
        for each in 25 * np.column_stack([x, y, -np.sin(3 * turn)])
    ]
    return _union(Manifold.batch_hull(list(pair)) for pair in pairwise(balls))


def brick() -> Manifold:
    """A toy brick of two by four studs, hollow below, with three tubes."""
    shell = box(64, 32, 20) - _moved(box(60, 28, 20), 0, 0, -2)
    studs = [_moved(rod(5, 4), x, y, 12) for x in (-24, -8, 8, 24) for y in (-8, 8)]
    tubes = [_moved(rod(6.5, 18) - rod(5, 20), x, 0, -1) for x in (-16, 0, 16)]
    return shell + _union(studs) + _union(tubes)


def shell_of_a_bowl() -> trimesh.Trimesh:
    """A rough surface of 3,500 triangles without thickness, as an open scan has."""
    ball = trimesh.creation.icosphere(4, 0.08)
    noise = np.random.default_rng(0).standard_normal((len(ball.vertices), 1))
    vertices = ball.vertices * (1 + 0.02 * noise)
    is_low = vertices[ball.faces].mean(1)[:, 2] < 0.03
    return trimesh.Trimesh(vertices, ball.faces[is_low], process=False)


def _save_intricate(folder: Path) -> None:
    """Thin walls, many holes, rods, and a surface that is open."""
    many_teeth = gear(48, 60, 12, 20) + gear(24, 30, 30, 8)
    made = {"basket": basket(), "dish_rack": dish_rack(), "knot": knot(), "brick": brick()}
    _save(made | {"double_gear": many_teeth}, folder)
    shell_of_a_bowl().export(folder / "open_bowl.obj")


def _save(made: dict[str, Manifold], folder: Path) -> None:
    for name, solid in made.items():
        raw = solid.to_mesh64()
        trimesh.Trimesh(raw.vert_properties[:, :3], raw.tri_verts).export(folder / f"{name}.obj")


def _save_modelled(folder: Path) -> None:
    """Surfaces of the modeller's objects, whose parts nobody tells the import."""
    for seed, family in enumerate(_FAMILIES, 1000):
        pieces = make_shape(family, seed).pieces
        meshes = [
            trimesh.Trimesh(each.mesh.vertices, each.mesh.faces, process=False) for each in pieces
        ]
        trimesh.util.concatenate(meshes).export(folder / f"{family}.obj")


def _save_random(folder: Path) -> None:
    """Twenty of PyBullet's thousand random objects, each of several convex pieces."""
    import pybullet_data

    root = Path(pybullet_data.getDataPath()) / "random_urdfs"
    for number in range(0, 1000, 50):
        (folder / f"random_{number:03}").symlink_to(root / f"{number:03}", target_is_directory=True)


KINDS: dict[str, Callable[[Path], None]] = {
    "simple": lambda folder: _save(simple(), folder),
    "fitting": lambda folder: _save(fitting(), folder),
    "modelled": _save_modelled,
    "random": _save_random,
    "intricate": _save_intricate,
}
"""By name, what fills a folder."""


@dataclass
class Outcome:
    """What an import of a folder cost and made."""

    seconds: dict[str, float] = field(default_factory=dict)  # Of the processor, by object.
    megabytes: float = 0.0  # The most that one process held.
    qualities: list[dict[str, float]] = field(default_factory=list)
    parts: list[int] = field(default_factory=list)


def run_import(code: Path, folder: Path, home: Path, limit: int) -> Outcome:
    """Imports a folder with the version of the package that lies in `code`."""
    import subprocess

    words = ("import", str(folder), "--pool", "made", "--jobs", "1", "--time-limit", str(limit))
    env = os.environ | {
        "PYTHONPATH": str(code),
        "CLUTTERGEN_HOME": str(home),
        "JAX_PLATFORMS": "cpu",
    }
    log = home / "log"
    home.mkdir()
    with log.open("w") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "cluttergen_jax", *words],
            env=env,
            cwd=home,
            stdout=file,
            stderr=file,
        )
        _, _, used = os.wait4(process.pid, 0)
    lines = _LINE.finditer(log.read_text())
    records = [
        json.loads(each.read_text()) for each in sorted((home / "pools/made").glob("*/object.json"))
    ]
    return Outcome(
        {line.group(1): float(line.group(2)) for line in lines},
        used.ru_maxrss / 1000,
        [record["quality"] for record in records],
        [len(record["parts"]) for record in records],
    )


def row_of(name: str, outcome: Outcome) -> list[str]:
    """A line of the table."""
    cpu = list(outcome.seconds.values())
    of = outcome.qualities
    deviations = [100 * each["deviation"] for each in of]
    stable = sum(each["solo_rate"] >= 0.99 for each in of)
    return [
        name,
        f"{len(cpu)}",
        *(f"{np.percentile(cpu, share):.1f}" for share in (50, 100)),
        f"{len(cpu) - len(of)}",
        f"{np.median(deviations):.1f} %",
        f"{max(deviations):.1f} %",
        f"{np.median(outcome.parts):.0f}",
        f"{stable} of {len(of)}",
        f"{outcome.megabytes:,.0f}",
    ]


def folders_of(config: Importing, root: Path) -> Iterable[tuple[str, Path]]:
    """Names and folders of what is imported."""
    if config.folder is not None:
        yield config.folder.name, config.folder.resolve()
        return
    for kind in config.only or KINDS:
        folder = root / kind
        folder.mkdir()
        KINDS[kind](folder)
        yield kind, folder


def main(config: Importing) -> None:
    """Imports each folder with one version, then with the other."""
    rows = []
    with checkout(config.before) as code, tempfile.TemporaryDirectory() as name:
        root = Path(name)
        for kind, folder in folders_of(config, root):
            for when, version in ((config.before, code), ("now", ROOT)):
                outcome = run_import(version, folder, root / f"{kind}-{when}", config.limit)
                rows.append(row_of(f"{kind}, {when}", outcome))
                print(rows[-1], file=sys.stderr, flush=True)
    text = prose(f"""
        CPU-seconds of each object by the import's own lines, start of the worker aside; what was not made
        after {config.limit} CPU-seconds counts with what it cost. Deviation is of the parts from the
        surface, over the diagonal. MB are the most that a process held.
    """)
    report("importing", f"## Import\n\n{text}\n\n{table(_HEADER, rows)}", write=config.write)


if __name__ == "__main__":
    main(tyro.cli(Importing))
