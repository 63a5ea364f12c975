"""Which files a source takes from outside its own folder: paths that lead there are followed, and noted."""

from __future__ import annotations

from pathlib import Path

from cluttergen_jax.files import blobs_of
from cluttergen_jax.importing.cache import source_files
from cluttergen_jax.importing.limited import call_limited
from cluttergen_jax.importing.readers import ObjectFile
from cluttergen_jax.importing.readers.read import public_path

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
    more = f", and {len(outside) - _MOST_NAMED} more" if len(outside) > _MOST_NAMED else ""
    return (f"{NOTE}{', '.join(outside[:_MOST_NAMED])}{more}",) if outside else ()


def _package_of(file: Path) -> Path:
    for folder in list(file.parents)[:_MOST_STEPS]:
        if any((folder / mark).is_file() for mark in _MARKS):
            return folder
    return file.parent.parent if file.parent.name.lower() in _INNER else file.parent
