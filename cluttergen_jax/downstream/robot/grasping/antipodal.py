"""Antipodal pairs: two points of a body's surface that fingers can press towards each other without slipping.

Lines are cast through the union of a body's convex parts. What a line crosses without leaving the union is
one segment, be it of many parts; so the wall of a mug counts as well as the mug.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from cluttergen_jax.assets import Mesh

FRICTION = 0.4
"""Sliding coefficient that grasps are sought with; the simulator's is 0.5 for most objects."""
_GAP = 2e-4
_ON_SURFACE = 1e-6


class Pairs(NamedTuple):
    """P pairs of points, object frame, metres.

    Attributes:
      first: f64[P, 3], where one finger touches; axis: f64[P, 3], unit, from there to where the other does.
      width: f64[P], between the two.
    """

    first: np.ndarray
    axis: np.ndarray
    width: np.ndarray

    @property
    def middle(self) -> np.ndarray:
        """f64[P, 3]: halfway between the two."""
        return self.first + self.axis * self.width[:, None] / 2


class _Crossing(NamedTuple):
    """Where L lines enter and leave P convex parts; inf and -inf where they miss.

    Attributes:
      enter, leave: f64[L, P], metres along the line.
      face: i64[L, P], of the part's faces the one through which it leaves.
    """

    enter: np.ndarray
    leave: np.ndarray
    face: np.ndarray


class Union:
    """The union of convex parts, for lines to be cast through; parts: convex collision parts of one body."""

    def __init__(self, parts: Sequence[Mesh]) -> None:
        hulls = [ConvexHull(part.vertices) for part in parts]
        # Qhull cuts a flat face into triangles, each with the same plane.
        self._planes = [np.unique(hull.equations.round(9), axis=0) for hull in hulls]
        self._hulls = hulls

    def surface_points(
        self, number: int, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Points on the faces of all parts, uniform by area, and outward normals, f64[number, 3] each.

        Points that lie inside another part are among them.
        """
        corners = np.concatenate([hull.points[hull.simplices] for hull in self._hulls])
        normals = np.concatenate([hull.equations[:, :3] for hull in self._hulls])
        a, b, c = corners.transpose(1, 0, 2)
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        face = rng.choice(len(area), number, p=area / area.sum())
        u, v = rng.random((2, number, 1))
        fold = u + v > 1
        u = np.where(fold, 1 - u, u)
        v = np.where(fold, 1 - v, v)
        return a[face] + u * (b - a)[face] + v * (c - a)[face], normals[face]

    def cast(self, start: np.ndarray, direction: np.ndarray) -> _Crossing:
        """Where lines f64[L, 3] through `start` cross each part."""
        found = [self._cast_one(planes, start, direction) for planes in self._planes]
        return _Crossing(*(np.stack(each, axis=1) for each in zip(*found, strict=True)))

    @staticmethod
    def _cast_one(
        planes: np.ndarray, start: np.ndarray, direction: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        slope = direction @ planes[:, :3].T
        height = start @ planes[:, :3].T + planes[:, 3]
        is_along = np.abs(slope) < 1e-9
        time = -height / np.where(is_along, 1.0, slope)
        enter = np.where(slope < 0, time, -np.inf)
        leave = np.where(slope > 0, time, np.inf)
        enter[is_along] = leave[is_along] = -np.inf
        enter = np.where(is_along & (height > 0), np.inf, enter)
        leave = np.where(is_along, np.inf, leave)
        first = enter.max(1)
        last = leave.min(1)
        face = leave.argmin(1)
        is_hit = first < last
        return np.where(is_hit, first, np.inf), np.where(is_hit, last, -np.inf), face

    def normals(self, crossing: _Crossing, part: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """f64[R, 3]: outward normals where lines `rows`, i[R], leave the parts `part`, i[R]."""
        return np.array(
            [self._planes[p][crossing.face[row, p], :3] for row, p in zip(rows, part, strict=True)]
        ).reshape(-1, 3)

    def reach(self, start: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """f64[L]: metres that lines run within the union from points inside it, 0 for points outside."""
        crossing = self.cast(start, direction)
        reach = np.zeros(len(start))
        for column in np.argsort(crossing.enter, axis=1).T:
            rows = np.arange(len(start))
            grows = crossing.enter[rows, column] <= reach + _GAP
            reach = np.where(grows, np.maximum(reach, crossing.leave[rows, column]), reach)
        return reach


def sample_pairs(union: Union, number: int, rng: np.random.Generator, max_width: float) -> Pairs:
    """The antipodal pairs among `number` lines that are cast from the surface inwards.

    Half of them run against the surface's normal, since flat pads turn an object until they lie flat on it;
    the others run level wherever the friction cone allows it, since a level hand comes nearest to a table.
    At the far end the surface may be tilted as far as the cone allows. Fingers may press upon one wall of a
    body, or upon two with a hollow between them.

    Args:
      max_width: metres between the two points.
    """
    points, normals = union.surface_points(number, rng)
    cone = np.arctan(FRICTION)
    axis = -normals
    level = axis * [1, 1, 0]
    length = np.linalg.norm(level, axis=1)
    may_be_level = (length >= np.cos(cone)) & (np.arange(number) % 2 == 1)
    axis[may_be_level] = level[may_be_level] / length[may_be_level, None]
    crossing = union.cast(points, axis)
    found = [
        _narrow(union, crossing, axis, rows, reach, part, cone, max_width)
        for rows, reach, part in _segments(crossing)
        if len(rows)
    ]
    if not found:
        return Pairs(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    rows, width = (np.concatenate(each) for each in zip(*found, strict=True))
    return Pairs(points[rows], axis[rows], width)


def _narrow(
    union: Union,
    crossing: _Crossing,
    axis: np.ndarray,
    rows: np.ndarray,
    reach: np.ndarray,
    part: np.ndarray,
    cone: float,
    max_width: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Of the ends of segments those that fit between the fingers and are faced well enough."""
    fits = reach <= max_width
    rows = rows[fits]
    reach = reach[fits]
    part = part[fits]
    facing = (union.normals(crossing, part, rows) * axis[rows]).sum(1)
    is_good = facing >= np.cos(cone)
    return rows[is_good], reach[is_good]


def _segments(crossing: _Crossing) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Ends of the segments of lines whose first point is where one of them begins.

    Each is a triple: lines, metres to the end, and the part that ends there. A line's first segment and those
    behind it count, since a finger may press upon the far side of a hollow body.
    """
    num_lines = len(crossing.enter)
    every = np.arange(num_lines)
    reach = np.full(num_lines, -np.inf)
    last = np.zeros(num_lines, np.int64)
    is_ours = np.zeros(num_lines, bool)
    ends = []
    for column in np.argsort(crossing.enter, axis=1).T:
        enter = crossing.enter[every, column]
        leave = crossing.leave[every, column]
        is_new = enter > reach + _GAP
        done = every[is_ours & is_new & np.isfinite(reach)]
        ends.append((done, reach[done].copy(), last[done].copy()))
        # Behind the last part everything is inf: nothing more ends there.
        is_ours = (is_ours | (is_new & (np.abs(enter) < _ON_SURFACE))) & np.isfinite(enter)
        grows = np.isfinite(enter) & (leave > reach)
        reach = np.where(grows, leave, reach)
        last = np.where(grows, column, last)
    done = every[is_ours]
    ends.append((done, reach[done], last[done]))
    return ends
