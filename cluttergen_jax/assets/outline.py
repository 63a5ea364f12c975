"""Outlines of surfaces: rectangles and cells of a grid joined to polygons with holes; plane, metres."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cluttergen_jax.geometry import box_corners

Ring = tuple[tuple[float, float], ...]
"""A polygon's corners, one after the other: counter-clockwise around it, clockwise around a hole."""

_NARROW = 0.01
"""Half the width of gaps, as between planks, that are no edge."""


def outline_of_rectangles(rectangles: Sequence[np.ndarray]) -> list[Ring]:
    """The largest of the areas that rectangles cover together, gaps of up to 2 cm bridged, then its holes.

    Args:
      rectangles: f64[4, 2] each, counter-clockwise.
    """
    if len(rectangles) == 1:
        return [_as_ring(rectangles[0])]
    # Loaded where it is needed: most supports are used without their outline.
    from manifold3d import CrossSection, JoinType

    united = CrossSection([np.asarray(each, np.float64) for each in rectangles])
    for reach in (_NARROW, -_NARROW):
        united = united.offset(reach, JoinType.Miter, 2.0)
    return _largest(united)


def outline_of_cells(
    mask: np.ndarray, origin: np.ndarray, cell: np.ndarray, tolerance: float
) -> list[Ring]:
    """The outline of the largest connected area of True cells, then its holes.

    Args:
      mask: bool[X, Y], something True; origin: f64[2], where cell (0, 0) begins; cell: f64[2], its sides.
      tolerance: metres by which corners may move to make straight what is a staircase.
    """
    from manifold3d import CrossSection

    runs = []
    for x, row in enumerate(mask):
        steps = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(int)))
        for start, end in steps.reshape(-1, 2):
            low = origin + cell * (x, start)
            high = origin + cell * (x + 1, end)
            runs.append(box_corners(low, high))
    return _largest(CrossSection(runs).simplify(tolerance))


def ring_area(ring: Ring) -> float:
    """Square metres within a ring; below zero for a hole."""
    x, y = np.array(ring, np.float64).T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2)


def _largest(section: object) -> list[Ring]:
    """The largest of the areas of a CrossSection: its outer ring, then its holes."""
    areas = section.decompose()  # type: ignore[attr-defined]
    rings = [_as_ring(each) for each in max(areas, key=lambda each: each.area()).to_polygons()]
    return sorted(rings, key=ring_area, reverse=True)


def _as_ring(points: np.ndarray) -> Ring:
    return tuple((float(x), float(y)) for x, y in points)
