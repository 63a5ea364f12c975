"""Polygons of mesh files: those that a fan from the first corner would fold are cut into other triangles.

The parsers cut every polygon into a fan. Of one with a concave outline such triangles lie over each other,
with the outline's edges and its area by sign still right: closed, and no solid. So the file is handed to
them with these polygons already cut, by Manifold's ear clipping; all other polygons stay as they are.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import manifold3d
import numpy as np

from cluttergen_jax.geometry import plane_axes, triangle_areas

_SLACK = 1e-9
"""Of a polygon's area: so much of a triangle may face the other way, by rounding."""
_BENT = 0.01
"""Of a polygon's size: so far its holes may lie beside its plane."""
_OBJ_VERTEX = re.compile(rb"^[ \t]*v[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)", re.MULTILINE)
_OBJ_POLYGON = re.compile(rb"^[ \t]*f((?:[ \t]+[-+\d/]+){4,})[ \t\r]*(?:#.*)?$", re.MULTILINE)
_OBJ_BACKWARD = re.compile(rb"^[ \t]*f[^\n]*[ \t/]-", re.MULTILINE)
_OBJ_LINE = re.compile(rb"^[ \t]*(vt|vn|v|f)[ \t]+([^\n#]*)", re.MULTILINE)
CROSSING = "a polygon whose outline crosses itself is cut into a fan from its first corner"


def cuts(points: np.ndarray, polygons: Sequence[np.ndarray]) -> tuple[dict[int, np.ndarray], bool]:
    """The triangles of those polygons that a fan would fold.

    Args:
      points: f64[V, 3].
      polygons: i64[N] each, the corners of one, N >= 3, as indices of points.

    Returns:
      By index of the polygon, i64[N - 2, 3], its triangles as places in its outline, turned as it is; and
      whether some polygon cannot be cut so, because its outline crosses itself.
    """
    found: dict[int, np.ndarray] = {}
    is_crossing = False
    lengths = np.array([len(each) for each in polygons], np.int64)
    for length in np.unique(lengths[lengths > 3]):
        which = np.flatnonzero(lengths == length)
        corners = points[np.stack([polygons[index] for index in which.tolist()])]
        for index in np.flatnonzero(_is_folded_fan(corners)):
            triangles = cut_with_holes([corners[index]])
            if triangles is None:
                is_crossing = True
            else:
                found[int(which[index])] = triangles
    return found, is_crossing


def _is_folded_fan(corners: np.ndarray) -> np.ndarray:
    """bool[M]: of f64[M, N, 3], whether a triangle of the fan faces against the polygon's own normal."""
    arms = corners[:, 1:] - corners[:, :1]
    # Each is a triangle's normal, twice as long as its area; together they are the polygon's, by Newell.
    normals = np.cross(arms[:, :-1], arms[:, 1:])
    normal = normals.sum(1)
    along = np.einsum("mni,mi->mn", normals, normal)
    return (along < -_SLACK * (normal**2).sum(1)[:, None]).any(1)


def cut_with_holes(rings: Sequence[np.ndarray]) -> np.ndarray | None:
    """The triangles of one polygon with holes seen along its normal; None if they would overlap, or if its
    holes lie elsewhere.

    Args:
      rings: f64[N, 3] each, the outline and its holes, which may turn either way.

    Returns:
      i64[M, 3], places in all rings one after another, turned as the outline is.
    """
    arms = rings[0][1:] - rings[0][0]
    plane = plane_axes(np.cross(arms[:-1], arms[1:]).sum(0))
    flat = [(ring - rings[0][0]) @ plane for ring in rings]
    across = np.concatenate(rings) @ np.cross(*plane.T)
    if len(rings) > 1 and np.ptp(across) > _BENT * np.ptp(flat[0]):
        return None
    order = []
    start = 0
    for number, ring in enumerate(flat):
        places = np.arange(start, start + len(ring))
        # Manifold wants holes that turn against their outline.
        order.append(places[::-1] if number and _area(ring) > 0 else places)
        start += len(ring)
    whole = np.concatenate(flat)
    places = np.concatenate(order)
    try:
        triangles = places[
            np.asarray(manifold3d.triangulate([whole[each] for each in order]), np.int64)
        ]
    except (RuntimeError, ValueError):
        return None
    areas = triangle_areas(whole[triangles])
    area = sum(_area(whole[each]) for each in order)
    # Each hole is joined to the outline by two more triangles.
    is_sound = (
        len(triangles) == len(whole) + 2 * (len(rings) - 1) - 2 and (areas >= -_SLACK * area).all()
    )
    return triangles if is_sound and np.isclose(areas.sum(), area, rtol=1e-6) else None


def _area(outline: np.ndarray) -> float:
    """Twice the signed area of f64[N, 2]."""
    x, y = outline.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def cut_obj(data: bytes) -> tuple[bytes, tuple[str, ...]]:
    """The text of an OBJ file with its concave polygons cut, and what to say of others.

    Corners keep their own words, and with them texture coordinates and normals. Negative ones count back from
    their own line, but the parser counts them from the last: they are written as counted from the first. What
    the parser itself would refuse stays as it is.
    """
    data = data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    if _OBJ_BACKWARD.search(data):
        data = _forward(data)
    lines = list(_OBJ_POLYGON.finditer(data))
    if not lines:
        return data, ()
    words = [line[1].split() for line in lines]
    try:
        points = np.array(_OBJ_VERTEX.findall(data)).astype(np.float64)
        polygons = [_obj_corners(each, len(points)) for each in words]
    except (ValueError, IndexError):
        return data, ()
    found, is_crossing = cuts(points, polygons)
    parts = []
    end = 0
    for index, triangles in sorted(found.items()):
        text = [
            b"f " + b" ".join(words[index][place] for place in triangle) for triangle in triangles
        ]
        parts += [data[end : lines[index].start()], b"\n".join(text)]
        end = lines[index].end()
    return b"".join([*parts, data[end:]]), (CROSSING,) if is_crossing else ()


def _forward(data: bytes) -> bytes:
    """The text of an OBJ file with all corners counted from the first."""
    numbers = {b"v": 0, b"vt": 0, b"vn": 0}
    parts = []
    end = 0
    for line in _OBJ_LINE.finditer(data):
        if line[1] != b"f":
            numbers[line[1]] += 1
            continue
        words = (zip(word.split(b"/"), numbers.values(), strict=False) for word in line[2].split())
        corners = [
            b"/".join(_count_from_first(name, number) for name, number in word) for word in words
        ]
        parts += [data[end : line.start()], b"f " + b" ".join(corners)]
        end = line.end()
    return b"".join([*parts, data[end:]])


def _count_from_first(name: bytes, number: int) -> bytes:
    """A corner's index from the first on; `number` there are so far."""
    is_backward = name[:1] == b"-" and name[1:].isdigit() and 0 < int(name[1:]) <= number
    return b"%d" % (number + 1 + int(name)) if is_backward else name


def _obj_corners(words: Sequence[bytes], num_points: int) -> np.ndarray:
    """i64[N]: the vertices of a face, from zero on."""
    corners = np.array([int(word.partition(b"/")[0]) for word in words]) - 1
    if corners.min() < 0 or corners.max() >= num_points:
        raise IndexError("a vertex that is not there")
    return corners


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
    except (
        LookupError,
        ValueError,
        RuntimeError,
        StopIteration,
        struct.error,
        OverflowError,
        MemoryError,
    ):
        return data, ()


def _cut(data: bytes) -> tuple[bytes, tuple[str, ...]]:
    end = _END.search(data)
    if end is None:
        return data, ()
    head = data[: end.end()].decode("latin-1").splitlines()
    elements = _elements(head)
    order = _order(head)
    if [each.name for each in elements[:2]] != ["vertex", "face"]:
        return data, ()
    vertex, face = elements[:2]
    place = next(
        i for i, each in enumerate(face.properties) if each.count and each.name in _CORNERS
    )
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
    # Corners that are not there are reported by `_sound`, once the parser has read the file.
    is_there = bool(len(named)) and 0 <= named.min() <= named.max() < len(points)
    found, is_crossing = cuts(points, polygons) if is_there else ({}, False)
    notes = (CROSSING,) if is_crossing else ()
    is_mixed = len({len(each) for each in polygons}) > 1
    if not found and not (is_mixed and order):
        return data, notes
    rows[1] = [
        part
        for index, row in enumerate(rows[1])
        for part in _triangles(row, place, found.get(index))
    ]
    written = _write_binary(rows, elements, order) if order else _write_text(rows, elements)
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
    start = vertex.number * struct.calcsize(
        order + "".join(each.code for each in vertex.properties)
    )
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
        yield [
            _of_corners(value, number, triangle) if isinstance(value, tuple) else value
            for value in row
        ]


def _of_corners(values: tuple[Any, ...], number: int, triangle: np.ndarray) -> tuple[Any, ...]:
    """Of a list for `number` corners the values of three; a list of another kind as it is."""
    if not values or len(values) % number:
        return values
    width = len(values) // number
    return tuple(
        value for corner in triangle for value in values[corner * width : (corner + 1) * width]
    )


def _new_head(head: Sequence[str], number: int) -> bytes:
    lines = [
        f"element face {number}" if line.split()[:2] == ["element", "face"] else line
        for line in head
    ]
    return ("\n".join(lines) + "\n").encode("latin-1")


def _write_text(rows: Sequence[Sequence[Row]], elements: Sequence[_Element]) -> bytes:
    lines = []
    for table, element in zip(rows, elements, strict=True):
        for row in table:
            pairs = zip(row, element.properties, strict=True)
            lines.append(
                " ".join(
                    " ".join([str(len(value)), *value]) if column.count else value
                    for value, column in pairs
                )
            )
    return ("\n".join(lines) + "\n").encode("latin-1")


def _write_binary(rows: Sequence[Sequence[Row]], elements: Sequence[_Element], order: str) -> bytes:
    parts = []
    for table, element in zip(rows, elements, strict=True):
        for row in table:
            for value, column in zip(row, element.properties, strict=True):
                if column.count:
                    parts.append(
                        struct.pack(
                            f"{order}{column.count}{len(value)}{column.code}", len(value), *value
                        )
                    )
                else:
                    parts.append(struct.pack(order + column.code, value))
    return b"".join(parts)
