"""Strangers' files are opened here: regular files alone, of limited size; and text, whatever its encoding."""

from __future__ import annotations

import codecs
import gzip
import io
import os
import stat
from pathlib import Path

from cluttergen_jax.errors import AssetError

MOST_MESH = 4 << 30
"""Bytes of a mesh file."""
MOST_XML = 256 << 20
"""Bytes of a URDF, SDF or MJCF file, and of a COLLADA file."""
MOST_WORDS = 64 << 20
"""Bytes of a file that says something about objects: materials, settings, tables, also once unpacked."""
MOST_PIXELS = 1 << 28
"""Pixels of an image: 16384 by 16384."""


def check_openable(path: Path, most: int = MOST_MESH) -> None:
    """Refuses what is no regular file, such as a named pipe or a device, where a link leads too.

    Args:
      most: bytes that it may have.

    Raises:
      AssetError: it is none, or too large. A file that is not there passes: its reader says so.
    """
    try:
        found = os.stat(path)
    except OSError:
        return
    except ValueError as error:
        raise AssetError(f"the path {str(path)!r}, which no file can have ({error})", "a file's path") from error
    if stat.S_ISDIR(found.st_mode):
        raise AssetError(f"{path} is a folder", "a file")
    if not stat.S_ISREG(found.st_mode):
        raise AssetError(f"{path} is no regular file but {_kind(found.st_mode)}", "regular files")
    if found.st_size > most:
        raise AssetError(
            f"{path} has {found.st_size:,} bytes", f"up to {most:,} bytes", "a smaller file, or several"
        )


def _kind(mode: int) -> str:
    if stat.S_ISFIFO(mode):
        return "a named pipe"
    return "a socket" if stat.S_ISSOCK(mode) else "a device"


def read_file(path: Path, most: int = MOST_MESH) -> bytes:
    """The bytes of a regular file; see `check_openable`."""
    check_openable(path, most)
    return path.read_bytes()


def unpacked(data: bytes, most: int = MOST_WORDS) -> bytes:
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
