"""An export as a folder that stands by itself, written whole or not at all.

Scenes for a program that opens them:

README.txt                  how to open it
MANIFEST.json LICENSES.txt  origin, poses and terms
assets/objects/NAME/ assets/support/   meshes and models, once
scenes/000000.ENDING        a file per scene

A bank with a script for a program that pins another MuJoCo or JAX: it reads the bank by `bank_reader.py`.

README.txt MANIFEST.json    how to use it; which scenes
LICENSES.txt                the terms of what is in it
SCRIPTS bank_reader.py      to be imported from here; they need nothing of cluttergen_jax
cluttergen_env/ environment/    of `lerobot`: the environment of a robot, and the robot
bank/                       bank.json, scenes-*.parquet, assets, README.md with the terms
"""

from __future__ import annotations

import importlib.resources
import json
import shutil
import tempfile
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import IO, Any

import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import object_hash
from cluttergen_jax.assets.shape import Provenance
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.assets.support_file import support_hash
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import folder_whole, inside
from cluttergen_jax.kept_folder import lock_beside
from cluttergen_jax.robot_environments import write_environment
from cluttergen_jax.scene import Scene, scene_cameras
from cluttergen_jax.scene.collection import check_alike
from cluttergen_jax.scene.export.formats import (
    FORMATS,
    HOST_CHECKS,
    Format,
    find_format,
    own_record,
)
from cluttergen_jax.scene.export.molmospaces import read_grasps, write_grasps
from cluttergen_jax.scene.export.scene_json import cameras_record, objects_record
from cluttergen_jax.scene.export.shapes import SUPPORT_FOLDER

_READER = "bank_reader.py"
_PARTS = ("bank.json", "README.md", _READER, "scenes-*.parquet", "assets")
MANIFEST = "MANIFEST.json"
LICENCES = "LICENSES.txt"


def export_scenes(
    scenes: Iterable[Scene],
    out: str | Path,
    format: str | Format = "mjcf",
    *,
    overwrite: bool = False,
    cameras: Sequence[str] = (),
    grasps: str | Path | None = None,
) -> Path:
    """Writes scenes as a self-contained folder.

    Args:
      scenes: at least one; they share support, contact parameters and time step.
      out: a folder that does not exist yet.
      format: a key of `FORMATS`; `FILE.py:NAME` or `MODULE:NAME`; or a `Format` of your own.
      overwrite: replace an earlier export that is there.
      cameras: of `scene.CAMERAS`, to be added to every scene; `scene.scene_cameras` says where they stand.
      grasps: a file of `cluttergen robot grasps --out`, for formats that have grasps: "molmospaces".

    Returns:
      The folder.

    Raises:
      ConfigError: no such format, no such camera, no scenes, scenes that do not go together, or `out` exists,
        or has a folder in its path that the format's program takes for its own;
        grasps that the format does not take, that cannot be read, or that are of other objects.
      BankError: another export is being written there.
      MissingExtraError: the format needs a package that is not installed.
      UnsafePathError: an object's name is a path that leads out of the folder.
    """
    kind = find_format(format)
    out = Path(out)
    _check_path(out, kind)
    if grasps is not None and not kind.takes_grasps:
        allowed = ", ".join(each.name for each in FORMATS.values() if each.takes_grasps)
        raise ConfigError(f"grasps in the format {kind.name!r}", f"grasps with: {allowed}")
    transforms = {} if grasps is None else read_grasps(grasps)
    if cameras:
        scenes = (replace(each, cameras=scene_cameras(each.support, cameras)) for each in scenes)
    with _export_folder(out, overwrite) as fresh:
        folder = _Folder(fresh, kind, transforms)
        folder.write(scenes)
        if grasps is not None and not folder.num_grasped:
            given = f"grasps {str(grasps)!r}, of none of the objects in these scenes"
            raise ConfigError(
                given, "grasps of the same objects", "`cluttergen robot grasps` of their pool"
            )
    return out


@contextmanager
def _export_folder(out: Path, overwrite: bool) -> Iterator[Path]:
    """A folder that takes the place of `out` after the block, which one export at a time may."""
    check_place(out, overwrite)
    with lock_beside(out):
        # The process that held the lock may have made it meanwhile.
        check_place(out, overwrite)
        with folder_whole(out) as fresh:
            yield fresh
            # Where the file system knows no locks, another export may have been faster.
            check_place(out, overwrite)


def generator_version() -> str:
    """This package's own."""
    try:
        return version("cluttergen_jax")
    except PackageNotFoundError:
        return "unknown"


def check_place(out: Path, overwrite: bool) -> None:
    """Refuses a place where something is, but for an earlier export that is to be replaced (ConfigError)."""
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return
    if not overwrite:
        raise ConfigError(
            f"{out} exists", "a new folder", "another `out`, or `overwrite` for an earlier export"
        )
    if not (out / MANIFEST).is_file():
        raise ConfigError(
            f"{out} exists and is no export", "a new folder, or an earlier export", "another `out`"
        )


def _check_path(out: Path, kind: Format) -> None:
    """Refuses a place where the format's program would look for files of its own (ConfigError)."""
    reserved = kind.reserved_folder
    if reserved and reserved in out.resolve().parts:
        raise ConfigError(
            f"an export as {kind.name} in {out.resolve()}",
            f"a path without a folder called {reserved!r}, which leads the program to its own files",
            f"out='in_{kind.name}'",
        )


class _Folder:
    """The folder while it grows."""

    def __init__(self, path: Path, kind: Format, grasps: Mapping[str, np.ndarray]) -> None:
        self._path = path
        self._kind = kind
        self._grasps = grasps
        self.num_grasped = 0
        self._assets: dict[str, ObjectAsset] = {}
        self._num_scenes = 0
        self._taken: set[int] = set()
        self._first: Scene | None = None

    def write(self, scenes: Iterable[Scene]) -> None:
        """Writes everything."""
        (self._path / "scenes").mkdir(parents=True)
        # Records wait on disk, as there may be a million; they come last in the manifest.
        with tempfile.TemporaryFile("w+", encoding="utf-8", dir=self._path) as records:
            for scene in check_alike(scenes):
                record = self._add(scene)
                records.write(",\n" if self._num_scenes else "\n")
                records.write(textwrap.indent(json.dumps(record, indent=1), "  "))
                self._num_scenes += 1
            if self._first is None:
                raise ConfigError("an export of no scenes", "one scene or more")
            records.seek(0)
            self._add_papers(self._first, records)

    def _add(self, scene: Scene) -> dict[str, object]:
        """Writes a scene; returns its entry in the manifest."""
        if self._first is None:
            self._first = scene
            if self._kind.write_support:
                place = self._make_folder(SUPPORT_FOLDER)
                self._kind.write_support(place, scene.support, scene.contact)
        for asset in scene.assets.values():
            self._assets.setdefault(asset.name, asset)
            folder = self._kind.object_folder(asset)
            is_there = inside(self._path, folder).exists()
            if self._kind.write_object and not is_there:
                self._kind.write_object(self._make_folder(folder), asset, scene.contact)
                if (transforms := self._grasps.get(object_hash(asset))) is not None:
                    write_grasps(self._path / folder, transforms)
                    self.num_grasped += 1
        # The scene's own number, or the next that is free.
        number = (
            scene.origin.index if scene.origin.index not in self._taken else max(self._taken) + 1
        )
        self._taken.add(number)
        file = f"scenes/{number:06d}.{self._kind.ending}"
        self._kind.write_scene(self._path / file, scene)
        return {"file": file, **asdict(scene.origin), "objects": objects_record(scene)}

    def _make_folder(self, folder: str) -> Path:
        path = inside(self._path, folder)
        path.mkdir(parents=True)
        return path

    def _add_papers(self, first: Scene, records: IO[str]) -> None:
        """Writes what is about all scenes.

        Args:
          records: the scenes' entries in the manifest, as JSON.
        """
        assets = list(self._assets.values())
        head = json.dumps(manifest(self._kind, generator_version(), assets, first), indent=1)
        with (self._path / MANIFEST).open("w", encoding="utf-8") as file:
            file.write(head.removesuffix("\n}") + ',\n "scenes": [')
            shutil.copyfileobj(records, file)
            file.write("\n ]\n}\n")
        self._save(LICENCES, licences_text(first.support, assets, self._kind.scripts))
        self._save("README.txt", _readme(self._kind, self._num_scenes, first))
        for script, text in _read_scripts(self._kind.scripts).items():
            self._save(script, text)

    def _save(self, name: str, text: str) -> None:
        (self._path / name).write_text(text, encoding="utf-8")


def _read_scripts(names: Iterable[str]) -> dict[str, str]:
    folder = importlib.resources.files("cluttergen_jax.scene.export") / "scripts"
    return {name: (folder / name).read_text(encoding="utf-8") for name in names}


def _readme(kind: Format, num_scenes: int, first: Scene) -> str:
    cameras = ", ".join(camera.name for camera in first.cameras)
    return (
        f"{num_scenes} tabletop scenes, exported by cluttergen_jax as {kind.name}.\n\n"
        f"Open with {kind.opens_in}\n\n"
        + (f"{kind.notes}\n\n" if kind.notes else "")
        + f"{MANIFEST}: how each scene came about, poses, masses and hashes. {LICENCES}: terms.\n"
        "Metres, kilograms, z up, origin on the floor below the support.\n"
        + (
            f"Cameras: {cameras}. {MANIFEST}: where; they look along their own -z, +y is up.\n"
            if cameras
            else ""
        )
    )


def num_exported(folder: Path) -> int:
    """How many scenes an export has, as its README.txt says; its manifest, which may be huge, is not read."""
    with (folder / "README.txt").open(encoding="utf-8") as file:
        return int(file.readline().split()[0])


def manifest(
    kind: Format,
    generator: str,
    assets: Sequence[ObjectAsset],
    first: Scene,
) -> dict[str, object]:
    """The manifest but for its scenes, which come last, as JSON values.

    Args:
      generator: this package's version.
      first: any of the scenes.
    """
    support = first.support
    return {
        "format": 1,
        "kind": "cluttergen export",
        "export_format": kind.name,
        **own_record(kind),
        "generator": {"cluttergen_jax": generator},
        "conventions": "metres, kilograms, seconds; quaternions wxyz; z up; origin on the floor",
        "physics": {"timestep": first.stability.timestep, **asdict(first.contact)},
        "support": {
            "name": support.name,
            "label": support.label,
            "folder": SUPPORT_FOLDER,
            **support.provenance.record(),
            "hash": support_hash(support),
            "top": support.top,
            "region": asdict(support.region),
        },
        "assets": [
            {
                "name": asset.name,
                "label": asset.label,
                "folder": kind.object_folder(asset),
                **asset.provenance.record(),
                "hash": object_hash(asset),
                "tier": asset.tier,
                "mass": float(asset.mass),
                "flags": list(asset.flags),
            }
            for asset in assets
        ],
        **cameras_record(first),
    }


def licences_text(
    support: SupportAsset, assets: Sequence[ObjectAsset], scripts: Sequence[str]
) -> str:
    """Who made what and on which terms, in words, by licence."""
    things = [(f"support {support.name} ({support.label})", support.provenance)]
    things += [(f"object {asset.name} ({asset.label})", asset.provenance) for asset in assets]
    by_licence: dict[str, list[tuple[str, Provenance]]] = {}
    for name, provenance in things:
        by_licence.setdefault(provenance.licence or "not stated", []).append((name, provenance))
    lines = [
        "Terms on which the contents of this folder may be passed on, as far as they are known.",
        "",
    ]
    for licence, members in sorted(by_licence.items()):
        lines.append(f"Licence: {licence}")
        for name, provenance in members:
            lines.append(f"  {name}: from {provenance.source or 'an unknown source'}")
            if provenance.attribution:
                lines.append(f"    attribution: {provenance.attribution}")
        lines.append("")
    for script in scripts:
        lines += [f"The script {script} is part of cluttergen_jax. Licence: Apache-2.0", ""]
    if "not stated" in by_licence:
        lines += ["Where no licence is stated, ask the owner before you pass it on.", ""]
    return "\n".join(lines)


@dataclass(frozen=True)
class BankFormat:
    """One program that takes a whole bank.

    Attributes:
      name: as on the command line.
      opens_in: who reads it, and how, in a sentence.
      scripts: in `export/scripts`.
      has_robot: the environment of a robot goes with it.
    """

    name: str
    opens_in: str
    scripts: tuple[str, ...]
    has_robot: bool = False


_ALL = (
    BankFormat(
        "mjlab",
        "mjlab 1.6: from cluttergen_mjlab import Clutter; its entities(), events() and simulation() go into "
        "the configuration of an environment. Or: python cluttergen_mjlab.py train Cluttergen-Lift-Yam.",
        ("cluttergen_mjlab.py",),
    ),
    BankFormat(
        "playground",
        "MuJoCo Playground 0.2, beside cluttergen_jax with its extra robot (in a checkout: pip install "
        "playground==0.2.0 '.[robot]'): import cluttergen_playground, "
        "cluttergen_playground.register('ClutterPick'), then mujoco_playground.registry.load('ClutterPick').",
        ("cluttergen_playground.py", HOST_CHECKS),
    ),
    BankFormat(
        "lerobot",
        "LeRobot: push the folder to a hub as a model repository, then from lerobot.envs.factory import "
        "make_env; make_env('OWNER/NAME', n_envs=4, trust_remote_code=True). Without it: import env, then "
        "env.single('grasp') or gymnasium.make('cluttergen/Grasp-v1').",
        ("env.py",),
        has_robot=True,
    ),
)
BANK_FORMATS = {each.name: each for each in _ALL}
"""Every such format by name."""


def export_bank(
    bank: Path,
    support: SupportAsset,
    objects: Sequence[ObjectAsset],
    indices: Sequence[int],
    out: str | Path,
    format: str,
    overwrite: bool,
    robot: Any = None,
) -> Path:
    """Writes a bank with the script of a format of `BANK_FORMATS`, whole or not at all.

    Args:
      support, objects: that are in it. indices: of its scenes that succeeded.
      overwrite: replace an earlier export.
      robot: whose environment goes with it, where the format has one (`BankFormat.has_robot`).

    Returns:
      The folder.

    Raises:
      ConfigError: `out` exists, or there is no such robot. BankError: another export is being written there.
      MissingExtraError: an extra that the robot needs is not installed.
    """
    kind = BANK_FORMATS[format]
    out = Path(out)
    package = importlib.resources.files("cluttergen_jax")
    with _export_folder(out, overwrite) as fresh:
        (fresh / "bank").mkdir(parents=True)
        for pattern in _PARTS:
            for path in bank.glob(pattern):
                copy = shutil.copytree if path.is_dir() else shutil.copy2
                copy(path, fresh / "bank" / path.name)
        terms = licences_text(support, objects, kind.scripts)
        if kind.has_robot:
            terms += f"{write_environment(fresh, robot)}\n"
        record = {
            "format": 1,
            "kind": "cluttergen export",
            "export_format": kind.name,
            "generator": {"cluttergen_jax": generator_version()},
            "scenes": [int(index) for index in indices],
        }
        about = f"{len(indices)} scenes, exported by cluttergen_jax as {kind.name}."
        files = {
            _READER: (package / _READER).read_text(encoding="utf-8"),
            **_read_scripts(kind.scripts),
            LICENCES: terms,
            MANIFEST: json.dumps(record) + "\n",
            "README.txt": f"{about}\n\nOpen with {kind.opens_in}\n",
        }
        for name, text in files.items():
            (fresh / name).write_text(text, encoding="utf-8")
    return out
