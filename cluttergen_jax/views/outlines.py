"""The outline of a mask as one polygon, as YOLO's labels for segmentation have it."""

from __future__ import annotations

import contourpy
import numpy as np

_INSET = 1 / 64
"""Pixels by which the outline stays inside the mask: rounded down, its corners are pixels of the mask."""


def outline_of(mask: np.ndarray) -> np.ndarray:
    """f64[P, 2]: a closed polygon around bool[H, W], x and y in pixels from the picture's upper left corner.

    It holds the middles of the mask's pixels and of no others, by the even-odd rule. Its parts and holes are
    joined where they are nearest, by a line there and back. Filled by OpenCV from corners rounded down, as
    Ultralytics does, it gives the mask itself, and the pixels of such lines between parts.

    Args:
      mask: with a pixel at least.
    """
    lines = contourpy.contour_generator(z=np.pad(mask, 1).astype(np.float64)).lines(0.5 + _INSET)
    # The middle of the padded picture's second pixel is at (0.5, 0.5); the last point is the first again.
    rings = [_corners(np.asarray(line)[:-1] - 0.5) for line in lines]
    return rings[0] if len(rings) == 1 else _join_rings(rings)


def _corners(ring: np.ndarray) -> np.ndarray:
    """The points of f[P, 2] that are not between two others on a row or a column."""
    is_straight = (ring == np.roll(ring, 1, axis=0)) & (ring == np.roll(ring, -1, axis=0))
    return ring[~is_straight.any(axis=1)]


def _join_rings(rings: list[np.ndarray]) -> np.ndarray:
    """One polygon of rings f[P, 2] whose points differ, joined by a spanning tree of the shortest lines."""
    points = np.concatenate(rings)
    sizes = [len(ring) for ring in rings]
    ring_of = np.repeat(np.arange(len(rings)), sizes)
    after = np.arange(len(points)) + 1
    ends = np.cumsum(sizes)
    after[ends - 1] = ends - sizes
    source = list(range(len(points)))
    following = after.tolist()
    for one, other in _bridges(points, ring_of):
        # There: a copy of the other point, and around its ring; back: a copy of the first.
        there = len(source)
        source += [other, one]
        following += [following[other], following[one]]
        following[other] = there + 1
        following[one] = there
    place = 0
    order = []
    for _ in source:
        order.append(source[place])
        place = following[place]
    return points[order]


def _bridges(points: np.ndarray, ring_of: np.ndarray) -> list[tuple[int, int]]:
    """Pairs of points, one fewer than there are rings, that join all rings by lines as short as can be.

    The shortest line between sets of points is an edge of their Delaunay triangulation.
    """
    from scipy.cluster.hierarchy import DisjointSet
    from scipy.spatial import Delaunay

    corners = Delaunay(points).simplices
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    edges = edges[ring_of[edges[:, 0]] != ring_of[edges[:, 1]]]
    length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    edges = edges[np.lexsort((edges[:, 1], edges[:, 0], length))]
    joined = DisjointSet(range(int(ring_of[-1]) + 1))
    return [
        (one, other)
        for one, other in edges.tolist()
        if joined.merge(int(ring_of[one]), int(ring_of[other]))
    ]
