"""Damaged mesh files, told in words: cut short, or naming what they do not have."""

from __future__ import annotations

import math
import re
from pathlib import Path

from cluttergen_jax.errors import AssetError

_AGAIN = "fetching or exporting the file again"
# OBJ counts from one (or backwards from -1); a zero would be taken for the last vertex.
_OBJ_ZERO = re.compile(rb"^[ \t]*f[^\n]*[ \t][+-]?0+(?=[/\s]|$)", re.MULTILINE)
_PLY_COUNT = re.compile(rb"^element\s+\S+\s+(\d+)", re.MULTILINE)


def check_whole(path: Path) -> None:
    """Looks for damage that the parsers pass over.

    Raises:
      AssetError: the file is empty, has fewer rows than its head promises, or has a face with vertex 0.
    """
    if path.stat().st_size == 0:
        raise AssetError(f"{path} is empty", "a mesh file with triangles", _AGAIN)
    check = {".stl": _check_stl, ".ply": _check_ply, ".obj": _check_obj}.get(path.suffix.lower())
    if check is not None:
        check(path, path.read_bytes())


def unreadable(path: Path, error: Exception) -> AssetError:
    """What to raise where a parser failed with `error`; a parser's slip says nothing to a user."""
    reason = _obj_fault(path) if path.suffix.lower() == ".obj" else ""
    if not reason:
        is_slip = isinstance(error, LookupError | AttributeError | TypeError | NameError | AssertionError)
        slip = "it is damaged, cut short or of another format"
        said = re.sub(r"^(\w+Error: )+", "", " ".join(str(error).split())).rstrip(".!")
        reason = slip if is_slip else said or slip
    return AssetError(f"{path} cannot be read as a mesh: {reason}", "a whole file", _AGAIN)


def _check_stl(path: Path, data: bytes) -> None:
    """Of text; the length of binary files is checked with their sizes."""
    if b"\0" not in data[:512] and data.count(b"endfacet") < data.count(b"facet normal"):
        raise AssetError(f"{path} is cut short: its last triangle has no end", hint=_AGAIN)


def _check_ply(path: Path, data: bytes) -> None:
    head, found, body = data.partition(b"end_header")
    if not found or b"format ascii" not in head:
        return
    promised = sum(int(count) for count in _PLY_COUNT.findall(head))
    held = sum(bool(line.strip()) for line in body.splitlines())
    if held < promised:
        raise AssetError(
            f"{path} is cut short: its head promises {promised:,} vertices and faces, it has {held:,}",
            hint=_AGAIN,
        )


def _check_obj(path: Path, data: bytes) -> None:
    if found := _OBJ_ZERO.search(data):
        line = data.count(b"\n", 0, found.start()) + 1
        raise AssetError(
            f"{path} is damaged: line {line} has a face with vertex 0", "vertices counted from 1", _AGAIN
        )


def _obj_fault(path: Path) -> str:
    """The first line of an OBJ file that cannot be meant; empty if all can."""
    lines = [line.split() for line in path.read_bytes().decode(errors="replace").splitlines()]
    num_vertices = sum(line[:1] == ["v"] for line in lines)
    for number, words in enumerate(lines, 1):
        if words[:1] == ["v"] and (word := next((each for each in words[1:] if not _is_finite(each)), None)):
            return f"line {number} has a vertex at {word!r}, which is no finite number"
        if words[:1] != ["f"]:
            continue
        for word in words[1:]:
            index = word.partition("/")[0]
            if not re.fullmatch(r"[+-]?\d+", index):
                return f"line {number} has a face with vertex {index!r}, which is no number"
            if not 1 <= abs(int(index)) <= num_vertices:
                return f"line {number} has a face with vertex {int(index)}, of {num_vertices} vertices"
    return ""


def _is_finite(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False
