"""Convex collision parts for what the modeller makes: at most 32 vertices each, metres, z up.

A part is a `Mesh.points`: the hull of its vertices is meant, and every vertex is a corner of that hull.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from manifold3d import Manifold
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.config import MAX_PART_VERTICES
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.modeller.solids import (
    Points2,
    ellipse,
    join_points,
    section_rings,
    to_mesh,
)
from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.errors import AssetError
from cluttergen_jax.geometry import at_height

# More than what a body dropped from a few millimetres sinks in when it lands: then only the feet touch.
LIFT = 0.0012


def hull(*points: Sequence[Sequence[float]] | np.ndarray) -> Mesh:
    """The convex hull of one or several sets of points f64[N, 3], reduced to its corners.

    Raises:
      AssetError: the points are flat, or their hull has more than 32 corners.
    """
    cloud = join_points(points)
    found = hull_of(cloud)
    if found is None:
        raise AssetError(
            f"{len(cloud)} points without volume", "points that span a solid", "a thicker part"
        )
    corners = cloud[np.sort(found.vertices)]
    if len(corners) > MAX_PART_VERTICES:
        raise AssetError(
            f"a part with {len(corners)} corners",
            f"at most {MAX_PART_VERTICES}",
            "fewer sides or more parts",
        )
    return Mesh.points(corners)


def box(size: Sequence[float], center: Sequence[float] = (0, 0), z: float = 0.0) -> Mesh:
    """A box of `size` (x, y, z) standing on height `z`, centred on `center` (x, y)."""
    signs = np.array([(x, y, s) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for s in (0, 1)])
    return hull(signs * np.asarray(size) + np.array([center[0], center[1], z]))


def prism(polygon: Points2, height: float, z: float = 0.0) -> Mesh:
    """The hull of a polygon drawn up from `z` to `z + height`."""
    return hull(at_height(polygon, z), at_height(polygon, z + height))


def disc(
    profile: Points2,
    num: int = 12,
    phase: float = 0.0,
    is_standing: bool = False,
) -> Mesh:
    """A solid of revolution as a polygon of `num` sides.

    Args:
      profile: (radius, z) points that bulge outwards, such as [(r, 0), (r, h)]; a radius of 0 is one apex.
      num: corners per ring; `num` times the number of rings is at most 32.
      phase: radians; a corner lies on the x axis turned by this.
      is_standing: the lowest ring touches the table with four corners only; the others end `LIFT` higher.
        A simulator keeps four contacts between two faces. Where a face has more corners its choice may change
        from step to step, and something tall and light then trembles without end.
    """
    rings: list[np.ndarray] = []
    if is_standing:
        (radius, low), *others = profile
        rings = [_ring(radius, low, 4, phase)]
        profile = [(radius, low + LIFT), *others]
    for radius, z in profile:
        rings.append(_ring(radius, z, num if radius > 0 else 1, phase))
    return hull(np.concatenate(rings) + 0.0)


def facing(radius: float, depth: float, num: int, center: Sequence[float] = (0, 0)) -> Mesh:
    """A disc that faces the front (-y): its centre at (x, z), half of its depth on either side of y = 0."""
    upright_disc = disc([(radius, -depth / 2), (radius, depth / 2)], num)
    return rotate_part(upright_disc, (90, 0, 0), (center[0], 0, center[1]))


def ring_sectors(profile: Points2, num: int = 8, phase: float = 0.0) -> tuple[Mesh, ...]:
    """The wall of a cup, a bowl or a ring, as convex wedges.

    Args:
      profile: the wall's section, a convex outline of (radius, z) points, all radii positive.
      num: wedges; corners lie on the true circle.
      phase: radians added to all angles.
    """
    radius, z = np.asarray(profile, np.float64).T
    angles = np.linspace(0.0, 2 * np.pi, num + 1)[:-1] + phase
    edges = [np.column_stack([radius * np.cos(a), radius * np.sin(a), z]) + 0.0 for a in angles]
    edges.append(edges[0])
    return tuple(hull(*pair) for pair in pairwise(edges))


def sweep(
    path: Sequence[Sequence[float]] | np.ndarray,
    section: Points2 | float,
    side: Sequence[float] = (0, 1, 0),
    scales: Sequence[float] | np.ndarray | None = None,
) -> tuple[Mesh, ...]:
    """A bar along a path (a handle, a spout) as one convex cell per leg of the path.

    Args:
      path: f64[N, 3], the corners: N - 1 cells. Take few points of the path the solid was swept along.
      section, side, scales: as in `solids.sweep`; a number stands for a round bar of that radius (6 corners).
    """
    outline = ellipse(section, section, 6) if isinstance(section, int | float) else section
    rings = section_rings(path, outline, side, scales)
    return tuple(hull(*pair) for pair in pairwise(rings))


def thin_path(path: np.ndarray, num_cells: int, bulge: float = 0.0) -> np.ndarray:
    """`num_cells + 1` stations picked evenly by length from a fine path, ends included.

    `bulge` moves the stations between the ends away from the ends' middle by this share, because a polygon
    inscribed in an arch lies inside it.
    """
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = np.linspace(0.0, length[-1], num_cells + 1)
    stations = np.stack([np.interp(wanted, length, path[:, k]) for k in range(path.shape[1])], -1)
    middle = (stations[0] + stations[-1]) / 2
    stations[1:-1] += bulge * (stations[1:-1] - middle)
    return stations


def upright(outline: Points2, depth: float, y: float = 0.0) -> Mesh:
    """The hull of an outline of (x, z) given `depth` along y, centred on `y`; see `solids.upright`."""
    flat = np.asarray(outline, np.float64)
    faces = [
        np.column_stack([flat[:, 0], np.full(len(flat), y + s * depth), flat[:, 1]])
        for s in (-0.5, 0.5)
    ]
    return hull(*faces)


def ball(radius: float, center: Sequence[float]) -> Mesh:
    """A ball as 32 corners, which lie outside its surface by about as much as the faces lie inside."""
    golden = (1 + 5**0.5) / 2
    signs = (-1.0, 1.0)
    cyclic = [(0.0, a, b * golden) for a in signs for b in signs]
    cyclic += [(0.0, a / golden, b * golden) for a in signs for b in signs]
    corners = [np.roll(corner, turn) for corner in cyclic for turn in range(3)]
    corners += [np.array((a, b, c)) for a in signs for b in signs for c in signs]
    directions = np.stack([corner / np.linalg.norm(corner) for corner in corners])
    return hull(1.03 * radius * directions + np.asarray(center))


def corners_of(solid: Manifold) -> Mesh:
    """The hull of a solid that has few corners."""
    return hull(to_mesh(solid).vertices)


def rotate_part(part: Mesh, degrees: Sequence[float], shift: Sequence[float] = (0, 0, 0)) -> Mesh:
    """A part turned about x, then y, then z (as `Manifold.rotate` does), then moved by `shift`."""
    return part.transform(
        Rotation.from_euler("xyz", degrees, degrees=True).as_matrix(), np.asarray(shift)
    )


def _ring(radius: float, z: float, num: int, phase: float) -> np.ndarray:
    """`num` points on a circle, f64[num, 3]."""
    angles = np.linspace(0.0, 2 * np.pi, num, endpoint=False) + phase
    return at_height(np.stack([radius * np.cos(angles), radius * np.sin(angles)], -1), z)
