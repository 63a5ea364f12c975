"""Convex parts: hulls, few vertices, flat bottoms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cluttergen_jax.assets.config import MAX_PART_VERTICES
from cluttergen_jax.assets.mesh import Mesh

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull

# Vertices this near the lowest point belong to the bottom, unless the object itself is thin.
BOTTOM_REACH = 0.003
_THIN_SHARE = 0.15
_MIN_THICKNESS = 0.0004
# A wide base keeps its outline; of a small foot four corners are enough, and MuJoCo has nothing to choose.
MAX_BASE_CORNERS = 12
_FOOT_CORNERS = (4, 6, 8)
_FOOT_SHARE = 0.5
_OUTLINE_TOLERANCE = 0.04

# Along the axes and the diagonals of a cube.
_DIRECTIONS = np.concatenate(
    [np.eye(3), -np.eye(3), [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]]
)


def hull_of(points: np.ndarray) -> ConvexHull | None:
    """The convex hull, or None where Qhull finds the points too flat."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return ConvexHull(points)
    except (QhullError, ValueError):
        return None


def heights_over(points: np.ndarray, hull: ConvexHull) -> np.ndarray:
    """f64[N, P]: how far points f64[N, D] are outside of each of a hull's planes."""
    return points @ hull.equations[:, :-1].T + hull.equations[:, -1]


def sound_points(points: np.ndarray) -> np.ndarray:
    """The hull's vertices; points in a plane or nearly so are given a thickness of 0.4 mm first."""
    points = np.unique(np.round(points, 7), axis=0)
    center = points.mean(0)
    # Fewer than three points have fewer than three axes of their own; of many, the full left factor is N x N.
    _, _, axes = np.linalg.svd(points - center, full_matrices=len(points) < 3)
    spread = np.ptp((points - center) @ axes.T, axis=0)
    for axis, width in zip(axes, spread, strict=True):
        if width < _MIN_THICKNESS:
            lift = axis * (_MIN_THICKNESS - width) / 2
            points = np.concatenate([points - lift, points + lift])
    hull = hull_of(points)
    return points if hull is None else points[hull.vertices]


def reduce_vertices(
    points: np.ndarray, bottom: float | None = None, count: int = MAX_PART_VERTICES
) -> np.ndarray:
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
    return points[_grow_hull(points, chosen, count, 1e-6)]


def _grow_hull(points: np.ndarray, chosen: list[int], count: int, tolerance: float) -> list[int]:
    """More of f64[N, D], each the farthest outside of the hull so far; up to `count`, or none is so far."""
    while len(chosen) < count:
        hull = hull_of(points[chosen])
        if hull is None:
            break
        outside = heights_over(points, hull).max(1)
        outside[chosen] = -np.inf
        farthest = int(outside.argmax())
        if outside[farthest] < tolerance:
            break
        chosen.append(farthest)
    return chosen


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


def flatten_bottoms(parts: Sequence[np.ndarray]) -> list[np.ndarray]:
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


def with_plain_bottom(
    points: np.ndarray, bottom: float, corners: int = MAX_BASE_CORNERS
) -> np.ndarray:
    """The points with no more of those on the bottom than its outline needs.

    MuJoCo keeps four contacts of a face that lies on another. Where corners are nearly on one line or a
    millimetre apart it changes its choice from step to step, and the object trembles. So corners are taken
    one by one, always the one farthest outside of the outline so far, until none is farther than 4 % of the
    outline's width. It is stretched to a square for this, so that a narrow foot keeps its width.

    Args:
      points: f64[N, 3].
      bottom: height of the bottom plane.
      corners: how many of its points stay at most.
    """
    low = np.flatnonzero(points[:, 2] < bottom + 1e-6)
    if len(low) <= 3:
        return points
    outline = points[low][:, :2] - points[low][:, :2].mean(0)
    _, spread, axes = np.linalg.svd(outline, full_matrices=False)
    if spread[1] < 1e-6:
        return points
    square = outline @ axes.T
    square /= np.ptp(square, axis=0)
    return np.delete(points, np.delete(low, _corners(square, corners)), axis=0)


def _corners(outline: np.ndarray, count: int) -> list[int]:
    """Indices of at most `count` of the points f64[N, 2] whose outline nearly encloses all of them."""
    first = int(np.linalg.norm(outline, axis=1).argmax())
    second = int(np.linalg.norm(outline - outline[first], axis=1).argmax())
    normal = (outline[second] - outline[first])[::-1] * (1, -1)
    kept = [first, second, int(np.abs((outline - outline[first]) @ normal).argmax())]
    return _grow_hull(outline, kept, count, _OUTLINE_TOLERANCE)


def finish_parts(
    parts: Sequence[np.ndarray],
    base_corners: int | None,
    foot_loss: float = np.inf,
) -> list[np.ndarray]:
    """Parts of few vertices each; their common bottom flat, with at most `base_corners`.

    With `base_corners` None bottoms are left as they are.

    Args:
      foot_loss: over the size of all, how far a small foot may lie inside of what it was; else it keeps more
        than four corners.
    """
    if base_corners is None:
        return [reduce_vertices(points) for points in parts]
    parts = flatten_bottoms(parts)
    bottom = bottom_height(parts)
    hulls = [sound_points(points) for points in parts]
    feet = [points[points[:, 2] < bottom + 1e-6] for points in hulls]
    wide = _FOOT_SHARE * _width(np.concatenate(feet))
    lost = foot_loss * float(np.linalg.norm(np.ptp(np.concatenate(hulls), axis=0)))
    finished = []
    for points, foot in zip(hulls, feet, strict=True):
        if _width(foot) >= wide:
            plain = with_plain_bottom(points, bottom, base_corners)
        else:
            plain = _with_small_foot(points, bottom, base_corners, lost)
        finished.append(reduce_vertices(plain, bottom))
    return finished


def _with_small_foot(points: np.ndarray, bottom: float, corners: int, lost: float) -> np.ndarray:
    """The points with as few on the bottom as leave none of the others farther than `lost` outside."""
    low = points[points[:, 2] < bottom + 1e-6][:, :2]
    plain = points
    for most in (each for each in _FOOT_CORNERS if each <= max(corners, _FOOT_CORNERS[0])):
        plain = with_plain_bottom(points, bottom, most)
        outline = hull_of(plain[plain[:, 2] < bottom + 1e-6][:, :2])
        if outline is None or heights_over(low, outline).max() <= lost:
            break
    return plain


def _width(points: np.ndarray) -> float:
    """The larger horizontal side of the box around points; zero if there are none."""
    return float(np.ptp(points[:, :2], axis=0).max()) if len(points) else 0.0


def as_meshes(parts: Sequence[np.ndarray]) -> tuple[Mesh, ...]:
    """Parts as the meshes that an asset holds, rounded as they are on disk."""
    return tuple(Mesh.points(np.round(points, 7) + 0.0) for points in parts)
