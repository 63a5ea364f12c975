"""Damaged mesh files: cut short, announcing more than they hold, or naming what they lack."""

from __future__ import annotations

import json
import math
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.gltf import DTYPES, WIDTHS, Json, buffer_file
from cluttergen_jax.importing.readers.xml_tree import parse_numbers, parse_xml, plain_tag

_HEAD = 84
_RECORD = np.dtype([("normal", "<3f4"), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_UNKNOWN = (0, 2**31 - 1, 2**32 - 1)
"""Counts that stand for none."""


def is_text_stl(data: bytes) -> bool:
    """Whether a file is of text, by its length and its first thousand bytes.

    The free head of a binary file may begin with the first word of text files.
    """
    size = len(data)
    if size < _HEAD or size == _HEAD + _RECORD.itemsize * announced_count(data):
        return size < _HEAD
    head = data[:1084]
    return b"facet" in head.lower() and b"\0" not in head


def announced_count(data: bytes) -> int:
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
        return held if is_whole and _is_closed_surface(data, held) else None
    return held if _is_closed_surface(data, held) and not _is_closed_surface(data, count) else count


def sound_stl(data: bytes) -> tuple[bytes, tuple[str, ...]]:
    """A binary file with a true count and nothing after its triangles, and what was wrong with it."""
    count = announced_count(data)
    if is_text_stl(data) or (number := num_triangles(data, count)) is None:
        return data, ()
    end = _HEAD + _RECORD.itemsize * number
    notes = []
    if count != number:
        notes.append(
            f"its head announces {count:,} triangles: the {number:,} that it holds are taken"
        )
    if rest := len(data) - end:
        notes.append(f"{rest:,} bytes after its last triangle are left out")
    if notes:
        data = data[:80] + number.to_bytes(4, "little") + data[_HEAD:end]
    return data, tuple(notes)


def _is_closed_surface(data: bytes, number: int) -> bool:
    """Whether the first `number` triangles pass each edge as often in one direction as in the other."""
    corners = np.frombuffer(data, _RECORD, number, _HEAD)["corners"].reshape(-1, 3)
    if not number or not np.isfinite(corners).all():
        return False
    _, named = np.unique(corners + np.float32(0), axis=0, return_inverse=True)
    faces = named.reshape(-1, 3).astype(np.int64)
    start = faces.reshape(-1)
    end = np.roll(faces, -1, axis=1).reshape(-1)
    size = int(faces.max()) + 1
    _, edge = np.unique(np.minimum(start, end) * size + np.maximum(start, end), return_inverse=True)
    return not np.bincount(edge.reshape(-1), np.sign(end - start)).any()


_POINTER = b"version https://git-lfs.github.com/spec/"
_PAGES = (b"<!doctype html", b"<html")


def stand_in(path: Path) -> tuple[str, str] | None:
    """What lies in place of a file, and what to do about it; None if it is the file, or cannot be opened."""
    try:
        with path.open("rb") as file:
            head = file.read(512).removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    except OSError:
        return None
    if head.startswith(_POINTER):
        return (
            "a pointer of Git LFS in place of the file",
            "`git lfs pull` in the repository that it is from",
        )
    if head.startswith(_PAGES):
        return (
            "a page of HTML in place of the file",
            "fetching it again; a browser shows what the page says",
        )
    return None


def refuse_stand_in(path: Path) -> None:
    """Raises AssetError if something lies in place of the file."""
    if found := stand_in(path):
        raise AssetError(f"{path} is {found[0]}", hint=found[1])


_AGAIN = "fetching or exporting the file again"
# OBJ counts from one (or backwards from -1); a zero would be taken for the last vertex.
_OBJ_ZERO = re.compile(rb"^[ \t]*f[^\n]*[ \t][+-]?0+(?=[/\s]|$)", re.MULTILINE)
_MOST_ZEROS = 16_000_000
"""Elements of an accessor without data of its own, which stands for zeros or for what is compressed."""

_PLY_BYTES = {"char": 1, "uchar": 1, "int8": 1, "uint8": 1, "short": 2, "ushort": 2, "int16": 2, "uint16": 2,
              "double": 8, "float64": 8}  # fmt: skip


def check_whole(path: Path) -> None:
    """Looks for damage that the parsers pass over.

    Raises:
      AssetError: the file is empty, is too short for what its header announces, or has a face with vertex 0.
    """
    data = path.read_bytes()
    if not data:
        raise AssetError(f"{path} is empty", "a mesh file with triangles", _AGAIN)
    refuse_stand_in(path)
    try:
        if check := _CHECKS.get(path.suffix.lower()):
            check(path, data)
    except RecursionError as error:
        raise AssetError(
            f"{path} cannot be read as a mesh: its header is nested too deeply"
        ) from error
    except (TypeError, LookupError, AttributeError, ValueError, struct.error) as error:
        raise AssetError(
            f"{path} cannot be read as a mesh: its header is damaged ({error!r})"
        ) from error


def unreadable(path: Path, error: Exception) -> AssetError:
    """What to raise where a parser failed with `error`; a parser's slip says nothing to a user."""
    reason = _obj_fault(path) if path.suffix.lower() == ".obj" else ""
    if str(error) == "PLY is unexpected length!":
        return ply_of_polygons(path)
    if not reason:
        is_slip = isinstance(
            error, LookupError | AttributeError | TypeError | NameError | AssertionError
        )
        slip = "it is damaged, cut short or of another format"
        said = re.sub(r"^(\w+Error: )+", "", " ".join(str(error).split())).rstrip(".!")
        reason = slip if is_slip else said or slip
    return AssetError(f"{path} cannot be read as a mesh: {reason}", "a whole file", _AGAIN)


def ply_of_polygons(path: Path) -> AssetError:
    """What to raise of a binary PLY file that does not hold what equal faces would take."""
    return AssetError(
        f"{path} cannot be read as a mesh: it is cut short, or its faces differ in their number of corners",
        "a whole file; in a binary one all faces have as many corners",
        "exporting it again with triangulated faces, or as text",
    )


def _check_obj(path: Path, data: bytes) -> None:
    if found := _OBJ_ZERO.search(data):
        line = data.count(b"\n", 0, found.start()) + 1
        raise AssetError(
            f"{path} is damaged: line {line} has a face with vertex 0",
            "vertices counted from 1",
            _AGAIN,
        )


_NO_NUMBER = re.compile(r"(?<!\S)\S*(?:nan|inf)\S*", re.IGNORECASE)


def _check_dae(path: Path, data: bytes) -> None:
    """pycollada puts a zero where a coordinate is no number."""
    tree = parse_xml(path)
    elements = [] if tree is None else list(tree.iter())
    places = {
        each.get("source", "").removeprefix("#")
        for each in elements
        if plain_tag(each) == "input" and each.get("semantic") == "POSITION"
    }
    for source in elements:
        if plain_tag(source) != "source" or source.get("id") not in places:
            continue
        for array in source:
            is_array = plain_tag(array) == "float_array"
            if is_array and (found := _NO_NUMBER.search(array.text or "")):
                raise AssetError(
                    f"{path} is damaged: a vertex at {found[0]!r}", "finite numbers", _AGAIN
                )


def _obj_fault(path: Path) -> str:
    """The first line of an OBJ file that cannot be meant; empty if all can."""
    lines = [line.split() for line in path.read_bytes().decode(errors="replace").splitlines()]
    num_vertices = sum(line[:1] == ["v"] for line in lines)
    for number, words in enumerate(lines, 1):
        if words[:1] == ["v"] and (
            word := next((each for each in words[1:] if not _is_finite(each)), None)
        ):
            return f"line {number} has a vertex at {word!r}, which is no finite number"
        if words[:1] != ["f"]:
            continue
        for word in words[1:]:
            index = word.partition("/")[0]
            if not re.fullmatch(r"[+-]?\d+", index):
                return f"line {number} has a face with vertex {index!r}, which is no number"
            if not 1 <= abs(int(index)) <= num_vertices:
                return (
                    f"line {number} has a face with vertex {int(index)}, of {num_vertices} vertices"
                )
    return ""


def _is_finite(word: str) -> bool:
    return all(map(math.isfinite, parse_numbers(word) or [math.nan]))


def _too_short(path: Path, what: str, needed: int, held: int) -> AssetError:
    return AssetError(
        f"{path} is damaged: {what} needs {needed:,} bytes, and there are {held:,}",
        hint="exporting or downloading the file again",
    )


def _check_glb(path: Path, data: bytes) -> None:
    size = len(data)
    magic, _, length, json_length, kind = struct.unpack("<4sIII4s", data[:20])
    if magic != b"glTF" or kind != b"JSON":
        raise ValueError("it does not begin as a GLB file does")
    if max(length, 20 + json_length) > size:
        raise _too_short(path, "what its header announces", max(length, 20 + json_length), size)
    document = json.loads(data[20 : 20 + json_length])
    head = data[20 + json_length : 28 + json_length]
    binary = struct.unpack("<I4s", head)[0] if len(head) == 8 else 0
    if 28 + json_length + binary > size and binary:
        raise _too_short(path, "its binary chunk", binary, size - 28 - json_length)
    _check_document(path, document, binary)


def _check_gltf(path: Path, data: bytes) -> None:
    _check_document(path, json.loads(data), 0)


def _check_document(path: Path, document: Json, binary: int) -> None:
    """Every accessor lies in its view, every view in its buffer, and every buffer in what is there."""
    buffers = []
    for index, buffer in enumerate(document.get("buffers", [])):
        needed = _count(buffer["byteLength"])
        held = _buffer_size(path, buffer.get("uri"), binary)
        if needed > held and not buffer.get("extensions"):
            raise _too_short(path, f"buffer {index}", needed, held)
        buffers.append(needed)
    views = document.get("bufferViews", [])
    for index, view in enumerate(views):
        end = _count(view.get("byteOffset", 0)) + _count(view["byteLength"])
        held = buffers[view["buffer"]]
        if end > held:
            raise _too_short(path, f"view {index} of buffer {view['buffer']}", end, held)
    for index, accessor in enumerate(document.get("accessors", [])):
        _check_accessor(path, f"accessor {index}", accessor, views)


def _check_accessor(path: Path, name: str, accessor: Json, views: list[Json]) -> None:
    count = _count(accessor["count"])
    if sparse := accessor.get("sparse"):
        # Each of its elements takes at least a byte, of indices as of values.
        held = min(
            views[sparse[part]["bufferView"]]["byteLength"] for part in ("indices", "values")
        )
        if _count(sparse["count"]) > held:
            raise _too_short(path, f"sparse {name}", sparse["count"], held)
    if "bufferView" not in accessor:
        if count > _MOST_ZEROS:
            raise AssetError(
                f"{path}: {name} of {count:,} elements", f"up to {_MOST_ZEROS:,} without data"
            )
        return
    view = views[accessor["bufferView"]]
    element = np.dtype(DTYPES[accessor["componentType"]]).itemsize * WIDTHS[accessor["type"]]
    stride = _count(view.get("byteStride", 0)) or element
    needed = _count(accessor.get("byteOffset", 0)) + (
        stride * (count - 1) + element if count else 0
    )
    if needed > view["byteLength"]:
        raise _too_short(path, f"{name} of {count:,} elements", needed, view["byteLength"])


def _count(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"{value!r} where a number of bytes or elements is expected")
    return value


def _buffer_size(path: Path, uri: str | None, binary: int) -> int:
    """Bytes behind a buffer: the file's own chunk, those in the text itself, or those of another file."""
    if uri is None:
        return binary
    if uri.startswith("data:"):
        return len(uri.partition(",")[2]) * 3 // 4
    return buffer_file(path, uri).stat().st_size


def _check_stl(path: Path, data: bytes) -> None:
    size = len(data)
    if size >= _HEAD and not is_text_stl(data):
        count = announced_count(data)
        if num_triangles(data, count) is None:
            what = f"a binary STL file of {count:,} triangles"
            raise _too_short(path, what, _HEAD + _RECORD.itemsize * count, size)
    if b"\0" not in data[:512] and data.count(b"endfacet") < data.count(b"facet normal"):
        raise AssetError(f"{path} is cut short: its last triangle has no end", hint=_AGAIN)


def _check_ply(path: Path, data: bytes) -> None:
    """A row takes at least the bytes of its properties, or in text a digit and a space for each."""
    text, end, body = data.partition(b"end_header")
    if not end:
        return
    is_text = re.search(rb"format\s+ascii", text) is not None
    needed = 0
    count = 0
    promised = 0
    for line in text.decode("latin-1").splitlines():
        words = line.split()
        if words[:1] == ["element"]:
            count = _count(int(words[2]))
            promised += count
        elif words[:1] == ["property"]:
            # An empty list is still its own length.
            kind = words[2 if words[1] == "list" else 1]
            needed += count * (2 if is_text else _PLY_BYTES.get(kind, 4))
    held = len(data) - len(text)
    if needed > held:
        raise _too_short(path, "what its header announces", needed, held)
    num_rows = sum(bool(line.strip()) for line in body.splitlines()) if is_text else promised
    if num_rows < promised:
        raise AssetError(
            f"{path} is cut short: its head promises {promised:,} vertices and faces, it has {num_rows:,}",
            hint=_AGAIN,
        )


_CHECKS = {
    ".glb": _check_glb,
    ".gltf": _check_gltf,
    ".stl": _check_stl,
    ".ply": _check_ply,
    ".obj": _check_obj,
    ".dae": _check_dae,
}
