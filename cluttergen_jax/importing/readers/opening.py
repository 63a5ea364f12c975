"""Strangers' files: found where others name them, opened if regular and of limited size, read as text.

Many files name a place on their author's machine: it is looked for by the last parts of its path as well.
"""

from __future__ import annotations

import codecs
import gzip
import io
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import unquote

from cluttergen_jax.errors import AssetError
from cluttergen_jax.files import MOST_WORDS, fault_of_file

MOST_MESH = 4 << 30
"""Bytes of a mesh file."""
MOST_XML = 256 << 20
"""Bytes of a URDF, SDF or MJCF file, and of a COLLADA file."""
MOST_PIXELS = 1 << 28
"""Pixels of an image: 16384 by 16384."""


def check_openable(path: Path, most: int = MOST_MESH) -> None:
    """Refuses what is no regular file, such as a named pipe or a device, where a link leads too.

    Args:
      most: bytes that it may have.

    Raises:
      AssetError: it is none, or too large. A file that is not there passes: its reader says so.
    """
    if fault := fault_of_file(path, most):
        raise AssetError(
            f"{str(path)!r} cannot be read: {fault}", f"regular files of up to {most:,} bytes"
        )


def read_file(path: Path, most: int = MOST_MESH) -> bytes:
    """The bytes of a regular file; see `check_openable`."""
    check_openable(path, most)
    return path.read_bytes()


def gunzip(data: bytes, most: int = MOST_WORDS) -> bytes:
    """What a gzip file holds.

    Raises:
      ValueError: it is more than `most` bytes.
    """
    with gzip.open(io.BytesIO(data)) as file:
        found = file.read(most + 1)
    if len(found) > most:
        raise ValueError(f"it holds more than {most:,} bytes")
    return found


def as_utf8(data: bytes) -> bytes:
    """Text in UTF-8: what is UTF-8 or UTF-16 stays as it is, all else is read as Windows-1252 or Latin-1."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", errors="replace").encode()
    for encoding in ("utf-8-sig", "cp1252"):
        try:
            return data.decode(encoding).encode()
        except UnicodeDecodeError:
            continue
    return data.decode("latin-1").encode()


# In MTL a file name may stand behind options: map_Kd -s 1 1 1 -clamp on label.png
OPTIONS = re.compile(r"(?:-[a-z]+\s+(?:(?:[-+.\de]+|on|off)\s+)*)+")
_FOLDERS = (".", "textures", "../textures", "../materials/textures")
_SCHEME = re.compile(r"^(file|package|model)://")
_DRIVE = re.compile(r"/?[A-Za-z]:/")
_LONGEST = 1024
"""Letters of a path in a file; a longer one is none."""
_MESH_FOLDERS = ("meshes", "../meshes", *_FOLDERS)


def find_named(folder: Path, name: str) -> Path | None:
    """The file that a file in `folder` calls `name`; None if there is none.

    Looked for where it is said to be, then by its last part alone beside it and in folders called `textures`:
    many files name a place on their author's machine.
    """
    if len(name) > _LONGEST:
        return None
    plain = unquote(OPTIONS.sub("", name.strip(), count=1).strip('"').removeprefix("file://"))
    plain = plain.replace("\\", "/")
    last = plain.rpartition("/")[2]
    places = (plain, *(f"{each}/{last}" for each in _FOLDERS))
    return next(
        (found for each in places if last and _is(Path.is_file, found := folder / each)), None
    )


def folder_place(model: Path, name: str) -> Path | None:
    """The folder that a model names, looked for as `mesh_place` does; None if it is not there."""
    return mesh_place(model, name, Path.is_dir)


def mesh_place(
    model: Path, name: str, is_there: Callable[[Path], bool] = Path.is_file
) -> Path | None:
    """The file that a URDF or SDF names, None if it is not there.

    Looked for as it is named, beside the model and in four folders above, where `package://` or `model://`
    ask for that; then by the last parts of its path, as many as fit: it may be a place on its author's
    machine.

    Args:
      is_there: whether a place has what is looked for; a file if not given.
    """
    if len(name) > _LONGEST:
        return None
    return next((each for each in _candidates(model, name) if _is(is_there, each)), None)


def _candidates(model: Path, name: str) -> Iterator[Path]:
    """Where `mesh_place` looks, one by one: most files lie where they are said to be."""
    for text in dict.fromkeys((name, unquote(name))):
        plain = _plain_path(text)
        if plain:
            yield model.parent / plain
        in_package = plain.partition("/")[2] if text.startswith(("package://", "model://")) else ""
        parts = [part for part in plain.split("/") if part not in ("", ".", "..")]
        shorter = ["/".join(parts[start:]) for start in range(1, len(parts) - 1)]
        roots = (model.parent, *list(model.resolve().parents)[1:5])
        yield from (root / tail for root in roots for tail in (plain, in_package) if tail)
        yield from (root / tail for tail in shorter for root in roots)
        yield from (model.parent / each / parts[-1] for each in _MESH_FOLDERS if parts)


def is_found_elsewhere(name: str, file: Path) -> bool:
    """Whether a file bears the last part alone of the path by which a URDF names it."""
    return len(parts := _plain_path(unquote(name)).split("/")) > 1 and file.parts[-2:-1] != (
        parts[-2],
    )


def _plain_path(name: str) -> str:
    """A path with slashes, without scheme and drive."""
    plain = _SCHEME.sub("", name.strip(), count=1).replace("\\", "/")
    return plain[drive.end() :] if (drive := _DRIVE.match(plain)) else plain


def _is(kind: Callable[[Path], bool], path: Path) -> bool:
    try:
        return kind(path)
    except (OSError, ValueError):
        return False
