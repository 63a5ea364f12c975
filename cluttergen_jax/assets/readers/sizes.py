"""Files that announce more than they hold, refused before anything is made of that size."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from cluttergen_jax.errors import AssetError

_COMPONENT_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_MOST_ZEROS = 16_000_000
"""Elements of an accessor without data of its own, which stands for zeros or for what is compressed."""

_PLY_BYTES = {"char": 1, "uchar": 1, "int8": 1, "uint8": 1, "short": 2, "ushort": 2, "int16": 2, "uint16": 2,
              "double": 8, "float64": 8}  # fmt: skip


def check_sizes(path: Path) -> None:
    """Looks at the counts in a file's header; files of formats without such counts pass.

    Raises:
      AssetError: the file is too short for what it announces.
    """
    check = {".glb": _check_glb, ".gltf": _check_gltf, ".stl": _check_stl, ".ply": _check_ply}
    if (look := check.get(path.suffix.lower())) is None:
        return
    try:
        look(path)
    except (
        TypeError,
        KeyError,
        AttributeError,
        ValueError,
        IndexError,
        struct.error,
        RecursionError,
    ) as error:
        raise AssetError(f"{path} cannot be read as a mesh: its header is damaged ({error!r})") from error


def _too_short(path: Path, what: str, needed: int, held: int) -> AssetError:
    return AssetError(
        f"{path} is damaged: {what} needs {needed:,} bytes, and there are {held:,}",
        hint="exporting or downloading the file again",
    )


def _check_glb(path: Path) -> None:
    size = path.stat().st_size
    with path.open("rb") as file:
        magic, _, length, json_length, kind = struct.unpack("<4sIII4s", file.read(20))
        if magic != b"glTF" or kind != b"JSON":
            raise ValueError("it does not begin as a GLB file does")
        if max(length, 20 + json_length) > size:
            raise _too_short(path, "what its header announces", max(length, 20 + json_length), size)
        document = json.loads(file.read(json_length))
        head = file.read(8)
        binary = struct.unpack("<I4s", head)[0] if len(head) == 8 else 0
    if 28 + json_length + binary > size and binary:
        raise _too_short(path, "its binary chunk", binary, size - 28 - json_length)
    _check_document(path, document, binary)


def _check_gltf(path: Path) -> None:
    _check_document(path, json.loads(path.read_bytes()), 0)


def _check_document(path: Path, document: dict[str, Any], binary: int) -> None:
    """Every accessor lies in its view, every view in its buffer, and every buffer in what is there."""
    buffers = []
    for index, buffer in enumerate(document.get("buffers", [])):
        needed, held = _count(buffer["byteLength"]), _held(path, buffer.get("uri"), binary)
        if needed > held and not buffer.get("extensions"):
            raise _too_short(path, f"buffer {index}", needed, held)
        buffers.append(needed)
    views = document.get("bufferViews", [])
    for index, view in enumerate(views):
        end, held = _count(view.get("byteOffset", 0)) + _count(view["byteLength"]), buffers[view["buffer"]]
        if end > held:
            raise _too_short(path, f"view {index} of buffer {view['buffer']}", end, held)
    for index, accessor in enumerate(document.get("accessors", [])):
        _check_accessor(path, f"accessor {index}", accessor, views)


def _check_accessor(path: Path, name: str, accessor: dict[str, Any], views: list[dict[str, Any]]) -> None:
    count = _count(accessor["count"])
    if sparse := accessor.get("sparse"):
        # Each of its elements takes at least a byte, of indices as of values.
        held = min(views[sparse[part]["bufferView"]]["byteLength"] for part in ("indices", "values"))
        if _count(sparse["count"]) > held:
            raise _too_short(path, f"sparse {name}", sparse["count"], held)
    if "bufferView" not in accessor:
        if count > _MOST_ZEROS:
            raise AssetError(f"{path}: {name} of {count:,} elements", f"up to {_MOST_ZEROS:,} without data")
        return
    view = views[accessor["bufferView"]]
    element = _COMPONENT_BYTES[accessor["componentType"]] * _COMPONENTS[accessor["type"]]
    stride = _count(view.get("byteStride", 0)) or element
    needed = _count(accessor.get("byteOffset", 0)) + (stride * (count - 1) + element if count else 0)
    if needed > view["byteLength"]:
        raise _too_short(path, f"{name} of {count:,} elements", needed, view["byteLength"])


def _count(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"{value!r} where a number of bytes or elements is expected")
    return value


def _held(path: Path, uri: str | None, binary: int) -> int:
    """Bytes behind a buffer: the file's own chunk, those in the text itself, or those of another file."""
    if uri is None:
        return binary
    if uri.startswith("data:"):
        return len(uri.partition(",")[2]) * 3 // 4
    for name in (uri, unquote(uri)):
        if (file := path.parent / name).is_file():
            return file.stat().st_size
    raise AssetError(f"{path} names buffer {uri!r}, which is not there", hint="restoring the file")


def _check_stl(path: Path) -> None:
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(84)
        is_text = b"facet" in head.lower() + file.read(1000).lower()
    if is_text or len(head) < 84:
        return
    triangles = int.from_bytes(head[80:84], "little")
    if size != 84 + 50 * triangles:
        raise _too_short(path, f"a binary STL file of {triangles:,} triangles", 84 + 50 * triangles, size)


def _check_ply(path: Path) -> None:
    """A row takes at least the bytes of its properties, or in text a digit and a space for each."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(1 << 16)
    text, end, _ = head.partition(b"end_header")
    if not end:
        return
    is_text = re.search(rb"format\s+ascii", text) is not None
    needed, count = 0, 0
    for line in text.decode("latin-1").splitlines():
        words = line.split()
        if words[:1] == ["element"]:
            count = _count(int(words[2]))
        elif words[:1] == ["property"]:
            # An empty list is still its own length.
            needed += count * (2 if is_text else _PLY_BYTES.get(words[2 if words[1] == "list" else 1], 4))
    if needed > size - len(text):
        raise _too_short(path, "what its header announces", needed, size - len(text))
