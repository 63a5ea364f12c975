"""An object as vertical columns: where it is, how low and how high, seen from straight above."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cluttergen_jax.assets.cloud import farthest_first
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.errors import AssetError

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull

REACH = 0.004
"""Metres by which upper surfaces are grown: what keeps clear of them keeps clear of the object itself."""

SURFACE_SPACING = 0.005
_INSET = 2e-4
_OUTLINE_WEIGHT = 2.0


@dataclass(frozen=True, eq=False)
class HeightProfile:
    """The object's collision parts cut into columns, object frame, metres.

    The columns stand on a grid and, as closely, along the outline of the footprint, so that they tell where
    the object ends to a fraction of a millimetre.

    Attributes:
      xy: f64[P, 2], where they stand.
      bottom: f64[P], the lowest point of any part there.
      top: f64[P], the highest.
      sample: i64[M], a choice of at most the asked number, farthest-point ordered: any prefix is a sample of
        the footprint, twice as dense along the outline as inside.
      surface: f64[Q, 3], the upper surface grown sideways by `REACH`, points on a grid.
    """

    xy: np.ndarray
    bottom: np.ndarray
    top: np.ndarray
    sample: np.ndarray
    surface: np.ndarray


def height_profile_of(asset: ObjectAsset, spacing: float, num_samples: int) -> HeightProfile:
    """Cuts an asset into columns at most `spacing` metres apart.

    Raises:
      AssetError: no vertical line meets the object.
    """
    from scipy.spatial import ConvexHull

    planes = [ConvexHull(part.vertices).equations for part in asset.parts]
    outline = _outline(asset, spacing)
    xy = np.concatenate([outline, _grid(asset.half_extents[:2], spacing)])
    lowest = np.full(len(xy), np.inf)
    highest = np.full(len(xy), -np.inf)
    for part in planes:
        hit, bottom, top = _part_range(part, xy)
        lowest = np.where(hit, np.minimum(lowest, bottom), lowest)
        highest = np.where(hit, np.maximum(highest, top), highest)
    hit = np.isfinite(lowest)
    if not hit.any():
        raise AssetError(
            f"{asset.name}: no column of {spacing * 1000:g} mm meets it", hint="a finer spacing"
        )
    weight = np.where(np.arange(len(xy)) < len(outline), _OUTLINE_WEIGHT, 1.0)
    xy = xy[hit]
    top = highest[hit]
    sample = farthest_first(xy, num_samples, weight[hit])
    return HeightProfile(
        xy, lowest[hit], top, sample, _grown_surface(xy, top, asset.half_extents[:2])
    )


def _grown_surface(xy: np.ndarray, top: np.ndarray, half: np.ndarray) -> np.ndarray:
    """f64[Q, 3]: on a grid, the highest top within reach."""
    from scipy.spatial import cKDTree

    grid = _grid(half + REACH, SURFACE_SPACING)
    near = cKDTree(xy).sparse_distance_matrix(cKDTree(grid), REACH, output_type="coo_matrix")
    height = np.full(len(grid), -np.inf)
    np.maximum.at(height, near.col, top[near.row])
    return np.column_stack([grid, height])[np.isfinite(height)]


def _grid(half: np.ndarray, spacing: float) -> np.ndarray:
    """f64[P, 2]: the centres of a grid over a rectangle of these half extents."""
    counts = np.maximum(np.ceil(2 * half / spacing), 1).astype(int)
    axes = [
        (np.arange(count) + 0.5) / count * 2 * side - side
        for count, side in zip(counts, half, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)


def _outline(asset: ObjectAsset, spacing: float) -> np.ndarray:
    """f64[P, 2]: points just inside the edge of the footprint, the union of the parts' shadows."""
    from scipy.spatial import ConvexHull

    shadows = [ConvexHull(part.vertices[:, :2]) for part in asset.parts]
    points = []
    for index, shadow in enumerate(shadows):
        candidates = _along_edge(shadow, spacing)
        others = [other for place, other in enumerate(shadows) if place != index]
        covered = [
            (other.equations[:, :2] @ candidates.T + other.equations[:, 2:] < -2 * _INSET).all(0)
            for other in others
        ]
        points.append(candidates[~np.any(covered, axis=0)] if others else candidates)
    return np.concatenate(points)


def _along_edge(shadow: ConvexHull, spacing: float) -> np.ndarray:
    """f64[P, 2]: points along a convex polygon's edges, moved inwards by a hair."""
    corners = shadow.points[shadow.vertices]
    runs = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        count = max(int(np.ceil(np.linalg.norm(end - start) / spacing)), 1)
        runs.append(start + (end - start) * (np.arange(count) / count)[:, None])
    points = np.concatenate(runs)
    inwards = corners.mean(0) - points
    return points + _INSET * inwards / np.maximum(
        np.linalg.norm(inwards, axis=1, keepdims=True), 1e-9
    )


def _part_range(planes: np.ndarray, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of vertical lines at `xy`: which ones cross a convex part, and from where to where."""
    offset = planes[:, :2] @ xy.T + planes[:, 3:]
    slope = planes[:, 2:3]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = -offset / slope
    top = np.where(slope > 1e-9, crossing, np.inf).min(0)
    bottom = np.where(slope < -1e-9, crossing, -np.inf).max(0)
    outside = ((np.abs(slope) <= 1e-9) & (offset > 1e-9)).any(0)
    return ~outside & (bottom <= top), bottom, top
