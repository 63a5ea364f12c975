"""Geometry of arrays: rotations, rigid transforms, turns about z, rectangles.

Quaternions are wxyz, poses are position and then quaternion, f[7]; radians and metres. What takes the array
module `xp` serves NumPy and JAX alike, as host callbacks may not call JAX; the rest is for the host. Pose
algebra in compiled code is jaxlie's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike

Array = Any
"""A NumPy array, or a JAX array where the function takes `xp`."""
ROUND = 24
"""An object of so many equal turns counts as round: any turn about z is as good as another."""


def norm(xp: Any, vector: Array) -> Array:
    """Euclidean length over the last axis."""
    return xp.sqrt(xp.sum(vector * vector, axis=-1))


def cross(xp: Any, a: Array, b: Array) -> Array:
    """Cross product of f[..., 3] with f[..., 3]."""
    return xp.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        axis=-1,
    )


def rotate(xp: Any, quaternion: Array, vector: Array) -> Array:
    """`vector`, f[..., 3], turned by the unit `quaternion`, f[..., 4] wxyz."""
    w = quaternion[..., :1]
    xyz = quaternion[..., 1:]
    twice = 2 * cross(xp, xyz, vector)
    return vector + w * twice + cross(xp, xyz, twice)


def turn_between(xp: Any, quaternion: Array, reference: Array) -> Array:
    """The angle in [0, pi] between two orientations, f[..., 4] wxyz each, exact for small angles."""
    w = quaternion[..., :1]
    xyz = quaternion[..., 1:]
    w0 = reference[..., :1]
    xyz0 = -reference[..., 1:]
    vector = w * xyz0 + w0 * xyz + cross(xp, xyz, xyz0)
    scalar = w[..., 0] * w0[..., 0] - xp.sum(xyz * xyz0, axis=-1)
    return 2 * xp.atan2(norm(xp, vector), xp.abs(scalar))


def conjugate(quaternion: Array) -> Array:
    """The inverse of unit quaternions, f[..., 4]."""
    return quaternion * np.array([1, -1, -1, -1])


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Quaternions f64[..., 4] that turn as `b` does and then as `a` does."""
    w = a[..., :1]
    v = a[..., 1:]
    u = b[..., :1]
    x = b[..., 1:]
    scalar = w * u - (v * x).sum(-1, keepdims=True)
    return np.concatenate([scalar, w * x + u * v + np.cross(v, x)], axis=-1)


def rotation_matrix(quaternion: np.ndarray) -> np.ndarray:
    """f64[3, 3] of a unit quaternion f[4]."""
    w, x, y, z = np.asarray(quaternion, np.float64)
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


def transform_points(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """f64[..., 3]: points f[..., 3] of a frame that stands at `pose`, in the frame of that pose."""
    pose = np.asarray(pose, np.float64)
    return np.asarray(points, np.float64) @ rotation_matrix(pose[3:]).T + pose[:3]


def yaw_quaternion(yaw: float) -> tuple[float, float, float, float]:
    """The quaternion of a turn about z."""
    return math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)


def yaw_matrix(yaw: float) -> np.ndarray:
    """f64[3, 3]: a turn about z."""
    cos = math.cos(yaw)
    sin = math.sin(yaw)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def cross_2d(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """f64[...]: the cross product of f64[..., 2]: twice the signed area between them."""
    return one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]


def triangle_areas(triangles: np.ndarray) -> np.ndarray:
    """f64[M]: twice the signed areas of f64[M, 3, 2]."""
    return cross_2d(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def unit(vectors: np.ndarray) -> np.ndarray:
    """f64[N, D]: vectors at length 1; zero where they are."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1), 1e-30)[:, None]


def across(direction: np.ndarray) -> np.ndarray:
    """f64[3]: a unit vector at right angles to one; zero where that is zero."""
    side = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    return side / max(float(np.linalg.norm(side)), 1e-300)


def plane_axes(normal: np.ndarray) -> np.ndarray:
    """f64[3, 2]: two axes in which what lies in a plane is seen along its normal, counter-clockwise."""
    upward = normal / max(float(np.linalg.norm(normal)), 1e-300)
    side = across(upward)
    return np.stack([side, np.cross(upward, side)], axis=1)


def box_corners(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """f64[4, 2]: the corners of a rectangle along the axes, counter-clockwise from the lowest."""
    return np.array([low, (high[0], low[1]), high, (low[0], high[1])])


def cell_centers(lower: np.ndarray, cell: ArrayLike, shape: ArrayLike) -> np.ndarray:
    """f64[X, Y, 2]: the middles of X x Y cells of a grid that begins at `lower`, f64[2]."""
    sides = np.broadcast_to(cell, 2)
    axes = [lower[k] + sides[k] * (np.arange(np.asarray(shape)[k]) + 0.5) for k in (0, 1)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def at_height(points: ArrayLike, height: float) -> np.ndarray:
    """f64[N, 3]: points f64[N, 2] of the plane, all at one height."""
    flat = np.asarray(points, np.float64)
    return np.column_stack([flat, np.full(len(flat), height)])


def rotate_in_plane(points: ArrayLike, yaw: float) -> np.ndarray:
    """f64[..., 2]: points of the plane turned about the origin."""
    cos = math.cos(yaw)
    sin = math.sin(yaw)
    return np.asarray(points, np.float64) @ np.array([[cos, sin], [-sin, cos]])


def rectangle_corners(center: Any, half_extents: Any, yaw: float) -> np.ndarray:
    """f64[4, 2]: the corners of a turned rectangle, one after the other around it, counter-clockwise."""
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return np.asarray(center) + rotate_in_plane(signs * half_extents, yaw)


def hull_area(points: np.ndarray) -> float:
    """Square metres within the convex hull of f[N, 2]; 0 where they are on a line."""
    ring = np.array(convex_hull(points), np.float64)
    x, y = (ring - ring[0]).T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2)


def convex_hull(points: np.ndarray) -> list[tuple[float, float]]:
    """Corners of the convex hull of f[M, 2], counter-clockwise (Andrew's monotone chain)."""
    ordered = sorted({(x, y) for x, y in points.tolist()})
    if len(ordered) < 3:
        return ordered
    return [*_chain(ordered)[:-1], *_chain(ordered[::-1])[:-1]]


def _chain(ordered: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The lower hull of points in ascending order; the upper one, of points in descending order."""
    chain: list[tuple[float, float]] = []
    for point in ordered:
        x, y = point
        while len(chain) > 1:
            x0, y0 = chain[-2]
            x1, y1 = chain[-1]
            if (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0) > 0:
                break
            chain.pop()
        chain.append(point)
    return chain


def closing(height: np.ndarray, width: int) -> np.ndarray:
    """f[R, C]: a map with its gaps closed into which a square of so many cells does not fit.

    The grey closing of `scipy.ndimage`, which takes longer to import than to run.
    """
    before = width // 2
    raised = _extreme(np.max, height, width, width - 1 - before)
    return _extreme(np.min, raised, width, before)


def _extreme(choose: Callable[..., Any], values: np.ndarray, width: int, before: int) -> np.ndarray:
    """The largest or smallest of the square about each cell, of which so many cells come before it."""
    for axis in (0, 1):
        sides = [(0, 0), (0, 0)]
        sides[axis] = (before, width - 1 - before)
        padded = np.pad(values, sides, mode="symmetric")
        values = choose(sliding_window_view(padded, width, axis=axis), axis=-1)
    return values
