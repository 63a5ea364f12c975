"""Solids for the modeller: a small vocabulary over manifold3d. Metres, z up.

Profiles are sequences of (radius, z); polygons are sequences of (x, y), counter-clockwise. What lies flat
on the table is made with its lowest face at exactly z = 0. The convex parts that go with these solids are
made by the functions of the same spirit in `parts.py`.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import manifold3d
import numpy as np
from manifold3d import CrossSection, Manifold

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.solid import as_manifold
from cluttergen_jax.errors import AssetError

Points2 = Sequence[tuple[float, float]] | np.ndarray
Rgb = tuple[float, float, float]

SEGMENTS = 48


def to_mesh(solid: Manifold) -> Mesh:
    """The closed surface of a solid.

    Raises:
      AssetError: the solid is empty or not a valid manifold.
    """
    if solid.is_empty() or solid.status() != manifold3d.Error.NoError:
        raise AssetError(
            f"a solid with status {solid.status()} and {solid.num_tri()} triangles",
            "a closed solid with volume",
            "profiles that do not cross themselves",
        )
    mesh = solid.to_mesh64()
    # Copies, because the library's own arrays are read-only views.
    return Mesh(np.array(mesh.vert_properties)[:, :3].copy(), np.array(mesh.tri_verts))


Painted = tuple[Manifold, Rgb] | tuple[Manifold, Rgb, float]
"""A solid in one colour, sRGB in [0, 1], and perhaps its alpha."""


def piece(solid: Manifold, color: Rgb, alpha: float = 1.0) -> Piece:
    """The surface of a solid in one colour."""
    return Piece(to_mesh(solid), (*color, alpha))


def revolve(profile: Points2, segments: int = SEGMENTS) -> Manifold:
    """The body swept by a closed outline of (radius, z) points around the z axis."""
    return Manifold.revolve(_section(profile), segments)


def lathe(profile: Points2) -> Manifold:
    """The body of revolution whose outside is a profile of (radius, z) points, closed level at both ends."""
    return revolve([(0.0, profile[0][1]), *profile, (0.0, profile[-1][1])])


def pipe(inner: float, outer: float, low: float, high: float, segments: int = SEGMENTS) -> Manifold:
    """A ring of rectangular section around the z axis."""
    return revolve([(inner, low), (outer, low), (outer, high), (inner, high)], segments)


def extrude(polygon: Points2, height: float, z: float = 0.0) -> Manifold:
    """A prism from `z` to `z + height`."""
    return Manifold.extrude(_section(polygon), height).translate((0, 0, z))


def box(size: Sequence[float], center: Sequence[float] = (0, 0), z: float = 0.0) -> Manifold:
    """A box of `size` (x, y, z) standing on height `z`, centred on `center` (x, y)."""
    return Manifold.cube(tuple(size)).translate(
        (center[0] - size[0] / 2, center[1] - size[1] / 2, z)
    )


def rounded_box(
    size: Sequence[float],
    radius: float,
    center: Sequence[float] = (0, 0),
    z: float = 0.0,
    segments: int = 16,
) -> Manifold:
    """A box with all edges rounded by `radius`; its top and bottom stay flat inside the rounding."""
    ball = Manifold.sphere(radius, segments)
    reach = [side / 2 - radius for side in size]
    corners = [
        ball.translate(
            (center[0] + sx * reach[0], center[1] + sy * reach[1], z + size[2] / 2 + sz * reach[2])
        )
        for sx in (-1, 1)
        for sy in (-1, 1)
        for sz in (-1, 1)
    ]
    return Manifold.batch_hull(corners)


def rounded_rect(width: float, depth: float, radius: float, num: int = 6) -> np.ndarray:
    """The outline of a rectangle with round corners, centred: f64[4 * (num + 1), 2]."""
    turns = np.linspace(0.0, np.pi / 2, num + 1)
    corners = []
    for k, (sx, sy) in enumerate([(1, 1), (-1, 1), (-1, -1), (1, -1)]):
        angles = turns + k * np.pi / 2
        middle = np.array([sx * (width / 2 - radius), sy * (depth / 2 - radius)])
        corners.append(middle + radius * np.stack([np.cos(angles), np.sin(angles)], -1))
    return np.concatenate(corners)


def ellipse(rx: float, ry: float, num: int = SEGMENTS) -> np.ndarray:
    """The outline of an ellipse, centred: f64[num, 2]."""
    angles = np.linspace(0.0, 2 * np.pi, num, endpoint=False)
    return np.stack([rx * np.cos(angles), ry * np.sin(angles)], -1)


def cylinder(
    radius: float,
    height: float,
    z: float = 0.0,
    top: float | None = None,
    center: Sequence[float] = (0, 0),
    segments: int = SEGMENTS,
) -> Manifold:
    """A cylinder, or a frustum if `top` gives another radius for its upper end, standing on height `z`."""
    upper = radius if top is None else top
    return Manifold.cylinder(height, radius, upper, segments).translate((center[0], center[1], z))


def facing(
    radius: float, depth: float, center: Sequence[float] = (0, 0), front: float | None = None
) -> Manifold:
    """A disc that faces the front (-y): its centre at (x, z), its face at y = `front`, or -depth / 2."""
    back = depth / 2 if front is None else front + depth
    return cylinder(radius, depth).rotate((90, 0, 0)).translate((center[0], back, center[1]))


def sweep(
    path: Sequence[Sequence[float]] | np.ndarray,
    section: Points2,
    side: Sequence[float] = (0, 1, 0),
    scales: Sequence[float] | np.ndarray | None = None,
) -> Manifold:
    """A solid swept by a convex outline along a path (a handle, a spout, a wire).

    Args:
      path: f64[N, 3], the centres of the sections; its bends should be wider than the section.
      section: f64[M, 2], counter-clockwise; x goes along `side`, y along tangent x side.
      side: a direction that is nowhere parallel to the path, such as the normal of a flat path.
      scales: f64[N], the section's size at each station; 1 by default.
    """
    rings = section_rings(path, section, side, scales)
    num_stations, num_corners = rings.shape[:2]
    index = np.arange(num_stations * num_corners).reshape(num_stations, num_corners)
    following = np.roll(index, -1, 1)
    a = index[:-1]
    b = following[:-1]
    c = index[1:]
    d = following[1:]
    walls = np.concatenate([np.stack([a, b, d], -1), np.stack([a, d, c], -1)]).reshape(-1, 3)
    second = np.arange(1, num_corners - 1)
    fan = np.stack([0 * second, second, second + 1], -1)
    faces = np.concatenate([walls, index[0][fan[:, ::-1]], index[-1][fan]])
    return as_manifold(Mesh(rings, faces))


def tube(
    path: Sequence[Sequence[float]] | np.ndarray,
    radius: float,
    side: Sequence[float] = (0, 1, 0),
    scales: Sequence[float] | np.ndarray | None = None,
    segments: int = 16,
) -> Manifold:
    """A round bar along a path; the arguments are those of `sweep`."""
    return sweep(path, ellipse(radius, radius, segments), side, scales)


def section_rings(
    path: Sequence[Sequence[float]] | np.ndarray,
    section: Points2,
    side: Sequence[float],
    scales: Sequence[float] | np.ndarray | None = None,
) -> np.ndarray:
    """The section's outline at every station of a path, f64[N, M, 3]; see `sweep`."""
    stations = np.asarray(path, np.float64)
    outline = np.asarray(section, np.float64)
    sizes = np.ones(len(stations)) if scales is None else np.asarray(scales, np.float64)
    tangents = np.gradient(stations, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    sides = (
        np.asarray(side, np.float64) - tangents * (tangents @ np.asarray(side, np.float64))[:, None]
    )
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)
    ups = np.cross(tangents, sides)
    flat = outline[None] * sizes[:, None, None]
    return stations[:, None] + flat[..., :1] * sides[:, None] + flat[..., 1:] * ups[:, None]


def smooth_path(points: Sequence[Sequence[float]] | np.ndarray, num: int = 24) -> np.ndarray:
    """A smooth curve through the given points (Catmull-Rom, centripetal in spirit), f64[num, D].

    Stations are evenly spaced in the curve's parameter; the ends are the first and the last point.
    """
    knots = np.asarray(points, np.float64)
    padded = np.concatenate([2 * knots[:1] - knots[1:2], knots, 2 * knots[-1:] - knots[-2:-1]])
    time = np.linspace(0.0, len(knots) - 1, num)
    cell = np.minimum(time.astype(int), len(knots) - 2)
    t = (time - cell)[:, None]
    p0, p1, p2, p3 = (padded[cell + k] for k in range(4))
    linear = p2 - p0
    square = 2 * p0 - 5 * p1 + 4 * p2 - p3
    cube = 3 * p1 - p0 - 3 * p2 + p3
    return p1 + 0.5 * t * (linear + t * (square + t * cube))


def union(*solids: Manifold) -> Manifold:
    """All solids fused into one."""
    return Manifold.batch_boolean(list(solids), manifold3d.OpType.Add)


def difference(solid: Manifold, *tools: Manifold) -> Manifold:
    """A solid with all `tools` cut away."""
    return Manifold.batch_boolean([solid, *tools], manifold3d.OpType.Subtract)


def above(solid: Manifold) -> Manifold:
    """What of a solid lies above z = 0: gives anything a flat face to rest on."""
    return solid.trim_by_plane((0, 0, 1), 0.0)


def hull(*points: Sequence[Sequence[float]] | np.ndarray) -> Manifold:
    """The convex solid spanned by one or several sets of points f64[N, 3]."""
    return Manifold.hull_points(join_points(points))


def join_points(sets: Sequence[Sequence[Sequence[float]] | np.ndarray]) -> np.ndarray:
    """f64[N, 3]: the points of all sets."""
    return np.concatenate([np.asarray(each, np.float64).reshape(-1, 3) for each in sets])


def arc(turns: np.ndarray, across: float, rise: float) -> np.ndarray:
    """f64[N, 3]: points of an arch in the xz plane, half axes `across` and `rise`, angles from x to z."""
    return np.column_stack([across * np.cos(turns), 0 * turns, rise * np.sin(turns)])


def upright(outline: Points2, depth: float, y: float = 0.0) -> Manifold:
    """An outline of (x, z), as seen from the front (-y), given `depth` along y and centred on `y`."""
    return extrude(outline, depth).rotate((90.0, 0.0, 0.0)).translate((0.0, y + depth / 2, 0.0))


def _section(polygon: Points2) -> CrossSection:
    """A polygon as manifold3d wants it, whichever way round it was given."""
    points = np.asarray(polygon, np.float64)
    x, y = points.T
    if np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) < 0:
        points = points[::-1]
    return CrossSection([points])


_RELIEF = 0.0006
"""Metres, of letters; as much again is sunk below the plane, to join what they stand on."""

# Five rows of each letter, top to bottom; a mark is a filled cell.
_GLYPHS = {
    "A": " ## |#  #|####|#  #|#  #",
    "B": "### |#  #|### |#  #|### ",
    "C": " ###|#   |#   |#   | ###",
    "D": "### |#  #|#  #|#  #|### ",
    "E": "####|#   |### |#   |####",
    "F": "####|#   |### |#   |#   ",
    "I": "###| # | # | # |###",
    "L": "#   |#   |#   |#   |####",
    "N": "#  #|## #|# ##|#  #|#  #",
    "O": " ## |#  #|#  #|#  #| ## ",
    "P": "### |#  #|### |#   |#   ",
    "S": " ###|#   | ## |   #|### ",
    "T": "#####|  #  |  #  |  #  |  #  ",
    "U": "#  #|#  #|#  #|#  #| ## ",
    "X": "#   #| # # |  #  | # # |#   #",
    "0": "####|#  #|#  #|#  #|####",
    "1": " # |## | # | # |###",
    "2": "### |   #| ## |#   |####",
    "3": "### |   #| ## |   #|### ",
    "4": "#  #|#  #|####|   #|   #",
    "5": "####|#   |### |   #|### ",
    "7": "####|   #|  # | #  | #  ",
    "8": "####|#  #|####|#  #|####",
    "9": "####|#  #|####|   #|####",
    ":": " |#| |#| ",
    " ": "  |  |  |  |  ",
}


def lettering(text: str, height: float) -> Manifold:
    """Words in relief on the plane z = 0, read along x with y up, centred on the origin.

    Args:
      text: of letters that are drawn above.
      height: metres, of a letter.
    """
    cell = height / 5
    bars = []
    pen = 0
    for glyph in (_GLYPHS[letter].split("|") for letter in text):
        for row, line in enumerate(glyph):
            bars += [
                # Cells reach a little over their neighbours, so that letters are joined at corners too.
                box(
                    (cell * (len(run) + 0.1), cell * 1.1, 2 * _RELIEF),
                    (cell * (pen + start + len(run) / 2), cell * (4.5 - row)),
                    -_RELIEF,
                )
                for start, run in _runs(line)
            ]
        pen += len(glyph[0]) + 1
    return union(*bars).translate((-cell * (pen - 1) / 2, -height / 2, 0.0))


def _runs(line: str) -> list[tuple[int, str]]:
    """The filled stretches of a row: where each starts, and its cells."""
    runs = []
    start = 0
    for mark, cells in itertools.groupby(line):
        run = "".join(cells)
        if mark == "#":
            runs.append((start, run))
        start += len(run)
    return runs
