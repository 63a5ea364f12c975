"""Convex parts: hulls, few vertices, flat bottoms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.object import MAX_PART_VERTICES

# Vertices this near the lowest point belong to the bottom, unless the object itself is thin.
BOTTOM_REACH = 0.003
_THIN_SHARE = 0.15
_MIN_THICKNESS = 0.0004
_BOTTOM_CORNERS = 12
_BOTTOM_GAP = 0.1

# Along the axes and the diagonals of a cube.
_DIRECTIONS = np.concatenate(
    [np.eye(3), -np.eye(3), [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]]
)


def hull_of(points: np.ndarray) -> ConvexHull | None:
    """The convex hull, or None where Qhull finds the points too flat."""
    try:
        return ConvexHull(points)
    except (QhullError, ValueError):
        return None


def sound_points(points: np.ndarray) -> np.ndarray:
    """The hull's vertices; points in a plane or nearly so are given a thickness of 0.4 mm first."""
    points = np.unique(np.round(points, 7), axis=0)
    center = points.mean(0)
    _, _, axes = np.linalg.svd(points - center, full_matrices=True)
    spread = np.ptp((points - center) @ axes.T, axis=0)
    for axis, width in zip(axes, spread, strict=True):
        if width < _MIN_THICKNESS:
            lift = axis * (_MIN_THICKNESS - width) / 2
            points = np.concatenate([points - lift, points + lift])
    hull = hull_of(points)
    return points if hull is None else points[hull.vertices]


def reduced(points: np.ndarray, bottom: float | None = None, count: int = MAX_PART_VERTICES) -> np.ndarray:
    """At most `count` of the hull's vertices, chosen to lose as little as possible.

    Starts with the extremes in 14 directions and, of the vertices at height `bottom`, the outline; then
    takes, again and again, the vertex that lies farthest outside of what is taken.

    Args:
      points: f64[N, 3].
      bottom: the height of the plane on which the object stands, if it is to be kept.

    Returns:
      f64[M, 3], M <= count.
    """
    points = sound_points(points)
    if len(points) <= count:
        return points
    chosen = list(dict.fromkeys(np.argmax(points @ _DIRECTIONS.T, axis=0).tolist()))
    if bottom is not None:
        low = np.flatnonzero(points[:, 2] < bottom + 1e-6)
        chosen = list(dict.fromkeys(chosen + _outline(points, low, count // 2)))[:count]
    while len(chosen) < count:
        hull = hull_of(points[chosen])
        if hull is None:
            break
        outside = (points @ hull.equations[:, :3].T + hull.equations[:, 3]).max(1)
        outside[chosen] = -np.inf
        farthest = int(outside.argmax())
        if outside[farthest] < 1e-6:
            break
        chosen.append(farthest)
    return points[chosen]


def _outline(points: np.ndarray, low: np.ndarray, count: int) -> list[int]:
    """Of the points `low`, those that keep most of their outline seen from above."""
    if len(low) <= count:
        return low.tolist()
    angles = 2 * np.pi * np.arange(count) / count
    ends = points[low][:, :2] @ np.stack([np.cos(angles), np.sin(angles)])
    return list(dict.fromkeys(low[ends.argmax(0)].tolist()))


def bottom_height(parts: Sequence[np.ndarray]) -> float:
    """The lowest height of all parts, metres."""
    return float(min(points[:, 2].min() for points in parts))


def flattened(parts: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The parts with every vertex that is within 3 mm of the bottom laid onto the bottom plane.

    An object thinner than 2 cm gives up less, so that what is flat stays as it is.
    """
    bottom = bottom_height(parts)
    height = max(float(points[:, 2].max()) for points in parts) - bottom
    reach = min(BOTTOM_REACH, _THIN_SHARE * height)
    out = []
    for points in parts:
        points = points.copy()
        points[points[:, 2] < bottom + reach, 2] = bottom
        out.append(points)
    return out


def with_spread_bottom(points: np.ndarray, bottom: float) -> np.ndarray:
    """The points without those of the bottom's outline that lie close to another one.

    MuJoCo keeps four contacts of a face that lies on another. Among corners a millimetre apart it changes
    its choice from step to step, and the object trembles; among a dozen corners well apart it does not.
    Distances are measured with the outline stretched to a square, so that a narrow foot keeps its width.
    """
    low = np.flatnonzero(points[:, 2] < bottom + 1e-6)
    outline = points[low][:, :2]
    if len(low) <= 4:
        return points
    centered = outline - outline.mean(0)
    _, spread, axes = np.linalg.svd(centered, full_matrices=False)
    if spread[1] < 1e-6:
        return points
    along = centered @ axes.T
    square = along / np.ptp(along, axis=0)
    kept = [int(np.linalg.norm(square, axis=1).argmax())]
    while len(kept) < _BOTTOM_CORNERS:
        gap = np.linalg.norm(square[:, None] - square[kept], axis=2).min(1)
        if gap.max() < _BOTTOM_GAP:
            break
        kept.append(int(gap.argmax()))
    return np.delete(points, np.delete(low, kept), axis=0)


def finished(parts: Sequence[np.ndarray], flatten: bool, count: int = MAX_PART_VERTICES) -> list[np.ndarray]:
    """Parts of at most `count` vertices each, their common bottom flat and kept."""
    parts = flattened(parts) if flatten else list(parts)
    if not flatten:
        return [reduced(points, None, count) for points in parts]
    bottom = bottom_height(parts)
    hulls = [sound_points(points) for points in parts]
    return [reduced(with_spread_bottom(points, bottom), bottom, count) for points in hulls]


def as_meshes(parts: Sequence[np.ndarray]) -> tuple[Mesh, ...]:
    """Parts as the meshes that an asset holds, rounded as they are on disk."""
    return tuple(Mesh.points(np.round(points, 7) + 0.0) for points in parts)
