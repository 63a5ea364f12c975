"""What was made before: bodies on disk, found by a digest of everything that they depend on.

Files that a source takes from outside its own folder are among that: they are followed, and noted.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import read_object, write_object
from cluttergen_jax.errors import ClutterGenError, first_names
from cluttergen_jax.files import blobs_of, cache_home, remove, scratch_folder
from cluttergen_jax.importing.limited import call_limited
from cluttergen_jax.importing.readers import ObjectFile
from cluttergen_jax.importing.readers.mesh_file import companions
from cluttergen_jax.importing.readers.opening import check_openable
from cluttergen_jax.importing.readers.pieces import ModelFile, model_file
from cluttergen_jax.importing.readers.read import public_path

BODY_VERSION = 11
"""Raised when the code makes another body of the same files, or of the modeller's same shapes: geometry,
masses, checks, colours or the files that hold them. Every cached body is then made again.
`test_bodies_are_those_of_this_version` fails where that was forgotten."""

_HASHING = 120
"""Seconds of a processor that all files of an object may take to be read."""
_LIBRARIES = (
    "mujoco",
    "coacd",
    "manifold3d",
    "trimesh",
    "numpy",
    "scipy",
    "fast-simplification",
    "pillow",
)

# Beside a mesh file, what may give it its colours.
_COMPANIONS = (".mtl", ".png", ".jpg", ".jpeg", ".bin")


def cache_root() -> Path:
    """The cache's folder: `$CLUTTERGEN_HOME/cache`, else the XDG cache home's."""
    return cache_home() / ("cache" if os.environ.get("CLUTTERGEN_HOME") else "objects")


def source_files(source: ObjectFile) -> set[Path]:
    """The real paths of a source's file and of all that it names and that is there.

    Raises:
      OSError: a file cannot be read.
    """
    files = {file.resolve() for file in (source.path, *source.parts)}
    if source.kind != "mesh" and isinstance(model := model_file(source.path, True), ModelFile):
        files |= (
            model.files
            | model.includes
            | model.shared
            | {source.path.parent.resolve() / "label.json"}
        )
    return files | {each.resolve() for file in files if file.is_file() for each in companions(file)}


def source_digest(source: ObjectFile) -> str:
    """Hex digest of every byte that reading the source may touch: files, materials and textures beside them.

    Raises:
      OSError: a file cannot be read.
    """
    files = source_files(source)
    for folder in {file.parent for file in files}:
        files |= {each for each in folder.iterdir() if each.suffix.lower() in _COMPANIONS}
    for file in files:
        check_openable(file)
    home = source.path.parent.resolve()
    digest = hashlib.sha256()
    for file in sorted(file for file in files if file.is_file()):
        digest.update(f"{os.path.relpath(file, home)}\n".encode())
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


def cache_key(source: ObjectFile, config: Any, is_whole: bool = False) -> str:
    """Hex digest that names the body of a source under a config (a dataclass).

    Args:
      is_whole: see `read_shape`.
    """
    provenance = None if source.provenance is None else source.provenance.record()
    said = [list(source.stretch), list(source.decisions), is_whole and source.kind == "mesh"]
    return _digest(
        call_limited(source.path, source_digest, source, seconds=_HASHING),
        source.path.name,
        source.kind,
        source.body,
        source.label,
        source.synset,
        list(source.notes),
        provenance,
        asdict(config),
        *([said] if said != [[1.0, 1.0, 1.0], [], False] else []),
    )


def shape_key(family: str, seed: int, config: Any) -> str:
    """Hex digest that names the body of a modeller's shape under a config (a dataclass)."""
    return _digest("modeller", family, seed, asdict(config))


def _digest(*parts: Any) -> str:
    """Of what a body is made of, and of the code that makes it."""
    made_by = [BODY_VERSION, [version(library) for library in _LIBRARIES]]
    return hashlib.sha256(json.dumps([*made_by, *parts], sort_keys=True).encode()).hexdigest()


def load(key: str, name: str) -> ObjectAsset | None:
    """The cached body, called `name`; None if there is none or it is damaged."""
    folder = cache_root() / key
    if not folder.is_dir():
        return None
    try:
        return replace(read_object(folder), name=name)
    except ClutterGenError:
        remove(folder)
        return None


def store(key: str, asset: ObjectAsset) -> None:
    """Puts a body into the cache: whole or not at all, whatever else writes the same."""
    root = cache_root()
    with scratch_folder(root / key) as scratch:
        write_object(scratch / key, asset)
        try:
            os.rename(scratch / key, root / key)
        except OSError:
            # Another run was first with the same body.
            if not (root / key).is_dir():
                raise


def drop(key: str) -> None:
    """Forgets a body."""
    remove(cache_root() / key)


_MARKS = ("package.xml", "manifest.xml", "model.config")
"""What lies in the uppermost folder of a package of ROS, or of a model of Gazebo."""
_INNER = ("urdf", "urdfs", "sdf", "mjcf", "xml", "xmls", "robots", "models", "objects")
"""Folders for model files, beside which folders for their meshes lie."""
_MOST_STEPS = 6
NOTE = "it takes files from outside its folder: "
_MOST_NAMED = 3


def files_outside(source: ObjectFile, given: Path) -> tuple[str, ...]:
    """The last steps of the paths of what a source takes from elsewhere, also by links; itself among them.

    Its own are those below the folder that the user gave, or beside the file, and below the source's package.

    Args:
      given: the folder or file that the user gave.
    """
    return call_limited(source.path, _files_outside, source, given)


def _files_outside(source: ObjectFile, given: Path) -> tuple[str, ...]:
    real = source.path.resolve()
    home = given.resolve() if given.is_dir() else given.absolute().parent
    own = {home, *blobs_of(home)}
    if not given.is_dir():
        own |= {home.resolve(), real.parent}
    if real.is_relative_to(home.resolve()):
        own.add(_package_of(real))
    files = source_files(source)
    outside = {
        each
        for each in files
        if each.is_file() and not any(each.is_relative_to(folder) for folder in own)
    }
    return tuple(sorted({public_path(each) for each in outside}))


def outside_note(outside: tuple[str, ...]) -> tuple[str, ...]:
    """What is said of an object that takes such files: one note, or none."""
    return (NOTE + first_names(outside, _MOST_NAMED, ", and {} more"),) if outside else ()


def _package_of(file: Path) -> Path:
    for folder in list(file.parents)[:_MOST_STEPS]:
        if any((folder / mark).is_file() for mark in _MARKS):
            return folder
    return file.parent.parent if file.parent.name.lower() in _INNER else file.parent
