"""An export as a folder that stands by itself, written whole or not at all.

README.txt                  how to open it
MANIFEST.json LICENSES.txt  origin, poses and terms
assets/objects/NAME/ assets/support/   meshes and models, once
scenes/000000.ENDING        a file per scene
"""

from __future__ import annotations

import importlib.resources
import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import folder_whole, inside
from cluttergen_jax.kept_folder import lock_beside
from cluttergen_jax.scene import Scene, scene_cameras
from cluttergen_jax.scene.collection import check_alike
from cluttergen_jax.scene.export.formats import Format, find_format
from cluttergen_jax.scene.export.manifest import (
    LICENCES,
    MANIFEST,
    licences_text,
    manifest,
    scene_record,
)
from cluttergen_jax.scene.export.meshes import SUPPORT_FOLDER, object_folder


def export_scenes(
    scenes: Iterable[Scene],
    out: str | Path,
    format: str = "mjcf",
    *,
    overwrite: bool = False,
    cameras: Sequence[str] = (),
) -> Path:
    """Writes scenes as a self-contained folder.

    Args:
      scenes: at least one; they share support, contact parameters and time step.
      out: a folder that does not exist yet.
      format: a key of `FORMATS`.
      overwrite: replace an earlier export that is there.
      cameras: of `scene.CAMERAS`, to be added to every scene; `scene.scene_cameras` says where they stand.

    Returns:
      The folder.

    Raises:
      ConfigError: no such format, no such camera, no scenes, scenes that do not go together, or `out` exists.
      BankError: another export is being written there.
      MissingExtraError: the format needs a package that is not installed.
      UnsafePathError: an object's name is a path that leads out of the folder.
    """
    kind, out = find_format(format), Path(out)
    _check_place(out, overwrite)
    with lock_beside(out):
        # Whoever held the lock may have made it meanwhile.
        _check_place(out, overwrite)
        with folder_whole(out) as fresh:
            if cameras:
                scenes = (replace(each, cameras=scene_cameras(each.support, cameras)) for each in scenes)
            _Folder(fresh, kind).write(scenes)
            # Where the file system knows no locks, another export may have been faster.
            _check_place(out, overwrite)
    return out


def _check_place(out: Path, overwrite: bool) -> None:
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


class _Folder:
    """The folder while it grows."""

    def __init__(self, path: Path, kind: Format) -> None:
        self._path, self._kind = path, kind
        self._assets: dict[str, ObjectAsset] = {}
        self._records: list[dict[str, Any]] = []
        self._taken: set[int] = set()
        self._first: Scene | None = None

    def write(self, scenes: Iterable[Scene]) -> None:
        """Writes everything."""
        (self._path / "scenes").mkdir(parents=True)
        for scene in check_alike(scenes):
            self._add(scene)
        if self._first is None:
            raise ConfigError("an export of no scenes", "one scene or more")
        self._add_papers(self._first)

    def _add(self, scene: Scene) -> None:
        if self._first is None:
            self._first = scene
            if self._kind.write_support:
                folder = self._made(SUPPORT_FOLDER)
                self._kind.write_support(folder, scene.support, scene.contact)
        for asset in scene.assets.values():
            self._add_asset(asset, scene)
        file = f"scenes/{self._number(scene):06d}.{self._kind.ending}"
        self._kind.write_scene(self._path / file, scene)
        self._records.append(scene_record(scene, file))

    def _number(self, scene: Scene) -> int:
        """The scene's own number, or the next that is free."""
        number = scene.origin.index if scene.origin.index not in self._taken else max(self._taken) + 1
        self._taken.add(number)
        return number

    def _add_asset(self, asset: ObjectAsset, scene: Scene) -> None:
        self._assets.setdefault(asset.name, asset)
        folder = inside(self._path, object_folder(asset.name))
        if self._kind.write_object and not folder.exists():
            self._kind.write_object(self._made(object_folder(asset.name)), asset, scene.contact)

    def _made(self, folder: str) -> Path:
        path = inside(self._path, folder)
        path.mkdir(parents=True)
        return path

    def _add_papers(self, first: Scene) -> None:
        assets = list(self._assets.values())
        record = manifest(self._kind.name, _version(), assets, first, self._records)
        self._save(MANIFEST, json.dumps(record, indent=1) + "\n")
        self._save(LICENCES, licences_text(first.support, assets, self._kind.script))
        self._save("README.txt", _readme(self._kind, len(self._records), first))
        if self._kind.script:
            scripts = importlib.resources.files("cluttergen_jax.scene.export") / "scripts"
            self._save(self._kind.script, (scripts / self._kind.script).read_text(encoding="utf-8"))

    def _save(self, name: str, text: str) -> None:
        (self._path / name).write_text(text, encoding="utf-8")


def _version() -> str:
    try:
        return version("cluttergen_jax")
    except PackageNotFoundError:
        return "unknown"


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
