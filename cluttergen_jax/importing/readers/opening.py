"""Strangers' files are opened here: regular files alone, of limited size; and text, whatever its encoding."""

from __future__ import annotations

import codecs
from pathlib import Path

from cluttergen_jax.errors import AssetError
from cluttergen_jax.files import fault_of_file

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
