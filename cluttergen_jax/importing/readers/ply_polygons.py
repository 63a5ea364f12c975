"""PLY files with polygons: cut where a fan would fold, and all as triangles where they differ in length.

The parser takes faces of several lengths in text, but not in binary files. So every polygon of such a file is
written anew as triangles, each with what the file says of its polygon.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np

from cluttergen_jax.importing.readers.polygons import CROSSING, cuts

_CODES = {
    "char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f",
    "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I",
    "double": "d", "float32": "f", "float64": "d",
}  # fmt: skip
_CORNERS = ("vertex_indices", "vertex_index")
_END = re.compile(rb"end_header[ \t]*\r?\n")


@dataclass(frozen=True)
class _Property:
    """A column of an element: a number, or (`count` is not empty) a list with its length before it."""

    name: str
    code: str
    count: str = ""


@dataclass(frozen=True)
class _Element:
    """Rows of one kind."""

    name: str
    number: int
    properties: tuple[_Property, ...]


Row = list[Any]
"""The values of a row, by property: a number, in text a word, or a tuple of them where it is a list."""


def cut_ply(data: bytes) -> tuple[bytes, tuple[str, ...]]:
    """The file with its polygons as triangles, and what to say of it.

    It stays as it is where all faces are triangles already, where no fan would fold and the parser can read
    it, and where it cannot be understood: then the parser says so.
    """
    try:
        return _cut(data)
    except (LookupError, ValueError, RuntimeError, StopIteration, struct.error, OverflowError, MemoryError):
        return data, ()


def _cut(data: bytes) -> tuple[bytes, tuple[str, ...]]:
    end = _END.search(data)
    if end is None:
        return data, ()
    head = data[: end.end()].decode("latin-1").splitlines()
    elements, order = _elements(head), _order(head)
    if [each.name for each in elements[:2]] != ["vertex", "face"]:
        return data, ()
    vertex, face = elements[:2]
    place = next(i for i, each in enumerate(face.properties) if each.count and each.name in _CORNERS)
    body = data[end.end() :]
    is_plain = (
        _is_of_triangles(body, vertex, face, place, order)
        if order
        else _is_text_of_triangles(body, vertex, face)
    )
    if is_plain:
        return data, ()
    read = _binary_rows(body, elements, order) if order else _text_rows(body, elements)
    rows = [list(islice(read, each.number)) for each in elements]
    if any(len(table) < each.number for table, each in zip(rows, elements, strict=True)):
        return data, ()
    rows[1] = [row for row in rows[1] if len(row[place]) >= 3]
    polygons = [np.array(row[place]).astype(np.int64) for row in rows[1]]
    axes = [[each.name for each in vertex.properties].index(axis) for axis in "xyz"]
    points = np.array([[row[axis] for axis in axes] for row in rows[0]]).astype(np.float64)
    named = np.concatenate(polygons)
    # Of corners that are not there `_sound` tells, once the parser has read the file.
    is_there = bool(len(named)) and 0 <= named.min() <= named.max() < len(points)
    found, is_crossing = cuts(points, polygons) if is_there else ({}, False)
    notes = (CROSSING,) if is_crossing else ()
    is_mixed = len({len(each) for each in polygons}) > 1
    if not found and not (is_mixed and order):
        return data, notes
    rows[1] = [part for index, row in enumerate(rows[1]) for part in _triangles(row, place, found.get(index))]
    written = _written_binary(rows, elements, order) if order else _written_text(rows, elements)
    return _new_head(head, len(rows[1])) + written, notes


def _elements(head: Sequence[str]) -> list[_Element]:
    found: list[_Element] = []
    for words in (line.split() for line in head):
        if words[:1] == ["element"]:
            found.append(_Element(words[1], int(words[2]), ()))
        elif words[:1] == ["property"]:
            column = (
                _Property(words[4], _CODES[words[3]], _CODES[words[2]])
                if words[1] == "list"
                else _Property(words[2], _CODES[words[1]])
            )
            found[-1] = replace(found[-1], properties=(*found[-1].properties, column))
    return found


def _order(head: Sequence[str]) -> str:
    """`<` or `>`, the order of bytes; empty of text."""
    kind = next(line.split()[1] for line in head if line.startswith("format"))
    return {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[kind]


def _is_of_triangles(body: bytes, vertex: _Element, face: _Element, place: int, order: str) -> bool:
    """Whether all faces of a binary file are triangles, with no other lists: so are most large ones."""
    lists = [each for each in (*vertex.properties, *face.properties) if each.count]
    if len(lists) > 1:
        return False
    start = vertex.number * struct.calcsize(order + "".join(each.code for each in vertex.properties))
    before = struct.calcsize(order + "".join(each.code for each in face.properties[:place]))
    corners = face.properties[place]
    after = "".join(each.code for each in face.properties[place + 1 :])
    size = before + struct.calcsize(order + corners.count + 3 * corners.code + after)
    if len(body) < start + size * face.number:
        return False
    table = np.frombuffer(body, np.uint8, size * face.number, start).reshape(-1, size)
    width = struct.calcsize(order + corners.count)
    counts = np.ascontiguousarray(table[:, before : before + width]).view(order + "u" + str(width))
    return bool((counts == 3).all())


def _is_text_of_triangles(body: bytes, vertex: _Element, face: _Element) -> bool:
    """The same of a text file whose faces begin with their corners."""
    rows = body.splitlines()[vertex.number : vertex.number + face.number]
    return bool(face.properties[0].count) and all(row.split(None, 1)[:1] == [b"3"] for row in rows)


def _text_rows(body: bytes, elements: Sequence[_Element]) -> Iterator[Row]:
    """Rows of words, as they are written."""
    lines = iter(body.decode("latin-1").splitlines())
    for element in elements:
        for _ in range(element.number):
            words = iter(next(lines).split())
            yield [
                tuple(islice(words, int(next(words)))) if column.count else next(words)
                for column in element.properties
            ]


def _binary_rows(body: bytes, elements: Sequence[_Element], order: str) -> Iterator[Row]:
    """Rows of numbers."""
    offset = 0
    for element in elements:
        if not any(column.count for column in element.properties):
            row = struct.Struct(order + "".join(column.code for column in element.properties))
            end = offset + row.size * element.number
            yield from (list(each) for each in row.iter_unpack(body[offset:end]))
            offset = end
            continue
        for _ in range(element.number):
            values: Row = []
            for column in element.properties:
                number = 1
                if column.count:
                    (number,) = struct.unpack_from(order + column.count, body, offset)
                    offset += struct.calcsize(column.count)
                format = f"{order}{number}{column.code}"
                taken = struct.unpack_from(format, body, offset)
                offset += struct.calcsize(format)
                values.append(taken if column.count else taken[0])
            yield values


def _triangles(row: Row, place: int, triangles: np.ndarray | None) -> Iterator[Row]:
    """The rows of a polygon's triangles: a fan if no others are given.

    Lists with a value, or several, for each corner are cut with it; all else is the same for each.
    """
    number = len(row[place])
    if triangles is None:
        triangles = np.array([[0, i + 1, i + 2] for i in range(number - 2)])
    for triangle in triangles:
        yield [_of_corners(value, number, triangle) if isinstance(value, tuple) else value for value in row]


def _of_corners(values: tuple[Any, ...], number: int, triangle: np.ndarray) -> tuple[Any, ...]:
    """Of a list for `number` corners the values of three; a list of another kind as it is."""
    if not values or len(values) % number:
        return values
    width = len(values) // number
    return tuple(value for corner in triangle for value in values[corner * width : (corner + 1) * width])


def _new_head(head: Sequence[str], number: int) -> bytes:
    lines = [f"element face {number}" if line.split()[:2] == ["element", "face"] else line for line in head]
    return ("\n".join(lines) + "\n").encode("latin-1")


def _written_text(rows: Sequence[Sequence[Row]], elements: Sequence[_Element]) -> bytes:
    lines = []
    for table, element in zip(rows, elements, strict=True):
        for row in table:
            pairs = zip(row, element.properties, strict=True)
            lines.append(
                " ".join(
                    " ".join([str(len(value)), *value]) if column.count else value for value, column in pairs
                )
            )
    return ("\n".join(lines) + "\n").encode("latin-1")


def _written_binary(rows: Sequence[Sequence[Row]], elements: Sequence[_Element], order: str) -> bytes:
    parts = []
    for table, element in zip(rows, elements, strict=True):
        for row in table:
            for value, column in zip(row, element.properties, strict=True):
                if column.count:
                    parts.append(
                        struct.pack(f"{order}{column.count}{len(value)}{column.code}", len(value), *value)
                    )
                else:
                    parts.append(struct.pack(order + column.code, value))
    return b"".join(parts)
