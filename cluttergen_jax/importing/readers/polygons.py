"""Polygons of mesh files: those that a fan from the first corner would fold are cut into other triangles.

The parsers cut every polygon into a fan. Of one with a concave outline such triangles lie over each other,
with the outline's edges and its area by sign still right: closed, and no solid. So the file is handed to
them with these polygons already cut, by Manifold's ear clipping; all other polygons stay as they are.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

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
