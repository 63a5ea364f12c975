"""Binary STL files: how many triangles one holds, where its length says otherwise than its count.

The format is a head of 80 bytes, a count, and 50 bytes for each triangle. Some programs write something of
their own after the last triangle; those that do not know the number beforehand leave it at 0 or at its
greatest.
"""

from __future__ import annotations

import numpy as np

_HEAD = 84
_RECORD = np.dtype([("normal", "<3f4"), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_UNKNOWN = (0, 2**31 - 1, 2**32 - 1)
"""Counts that stand for none."""


def is_text_stl(data: bytes, size: int) -> bool:
    """Whether a file of `size` bytes is of text, by its length and its first thousand bytes or more.

    The free head of a binary file may begin with the first word of text files.
    """
    if size < _HEAD or size == _HEAD + _RECORD.itemsize * announced(data):
        return size < _HEAD
    head = data[:1084]
    return b"facet" in head.lower() and b"\0" not in head


def announced(data: bytes) -> int:
    """The count that a binary file begins with."""
    return int.from_bytes(data[80:84], "little")


def num_triangles(data: bytes, count: int) -> int | None:
    """How many triangles there are after the head of a binary file; None if some have been cut off.

    All that fit, where the count stands for none, or where they close the surface and those of the count do
    not; else the first `count`.

    Args:
      data: the whole file; count: what it announces.
    """
    held = (len(data) - _HEAD) // _RECORD.itemsize
    if count == held:
        return held
    is_whole = (len(data) - _HEAD) % _RECORD.itemsize == 0
    if count in _UNKNOWN:
        return held or None
    if count > held:
        return held if is_whole and _is_closed(data, held) else None
    return held if _is_closed(data, held) and not _is_closed(data, count) else count


def sound_stl(data: bytes) -> tuple[bytes, tuple[str, ...]]:
    """A binary file with a true count and nothing after its triangles, and what was wrong with it."""
    count = announced(data)
    number = None if is_text_stl(data, len(data)) or len(data) < _HEAD else num_triangles(data, count)
    if number is None:
        return data, ()
    end, notes = _HEAD + _RECORD.itemsize * number, []
    if count != number:
        notes.append(f"its head announces {count:,} triangles: the {number:,} that it holds are taken")
    if rest := len(data) - end:
        notes.append(f"{rest:,} bytes after its last triangle are left out")
    return (data[:80] + number.to_bytes(4, "little") + data[_HEAD:end], tuple(notes)) if notes else (data, ())


def _is_closed(data: bytes, number: int) -> bool:
    """Whether the first `number` triangles pass each edge as often in one direction as in the other."""
    corners = np.frombuffer(data, _RECORD, number, _HEAD)["corners"].reshape(-1, 3)
    if not number or not np.isfinite(corners).all():
        return False
    _, named = np.unique(corners + np.float32(0), axis=0, return_inverse=True)
    faces = named.reshape(-1, 3).astype(np.int64)
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    size = int(faces.max()) + 1
    _, edge = np.unique(np.minimum(start, end) * size + np.maximum(start, end), return_inverse=True)
    return not np.bincount(edge.reshape(-1), np.sign(end - start)).any()
