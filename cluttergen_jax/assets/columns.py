"""An object as vertical columns: where it is, how low and how high, seen from straight above."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.errors import AssetError


@dataclass(frozen=True, eq=False)
class Columns:
    """The object's collision parts cut into columns on a grid, object frame, metres.

    Attributes:
      xy: f64[P, 2], the columns' centres.
      bottom: f64[P], the lowest point of any part over the centre.
      top: f64[P], the highest.
    """

    xy: np.ndarray
    bottom: np.ndarray
    top: np.ndarray


def _part_range(part: Mesh, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of vertical lines at `xy`: which ones cross a convex part, and from where to where."""
    planes = ConvexHull(part.vertices).equations
    offset = planes[:, :2] @ xy.T + planes[:, 3:]
    slope = planes[:, 2:3]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = -offset / slope
    top = np.where(slope > 1e-9, crossing, np.inf).min(0)
    bottom = np.where(slope < -1e-9, crossing, -np.inf).max(0)
    outside = ((np.abs(slope) <= 1e-9) & (offset > 1e-9)).any(0)
    return ~outside & (bottom <= top), bottom, top


def cut_columns(asset: ObjectAsset, spacing: float) -> Columns:
    """Cuts an asset into columns `spacing` metres apart, farthest-point ordered: any prefix is a sample.

    Raises:
      AssetError: no vertical line through the grid meets the object.
    """
    half = asset.half_extents[:2]
    counts = np.maximum(np.ceil(2 * half / spacing), 1).astype(int)
    axes = [
        (np.arange(count) + 0.5) / count * 2 * side - side for count, side in zip(counts, half, strict=True)
    ]
    xy = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    lowest, highest = np.full(len(xy), np.inf), np.full(len(xy), -np.inf)
    for part in asset.parts:
        hit, bottom, top = _part_range(part, xy)
        lowest = np.where(hit, np.minimum(lowest, bottom), lowest)
        highest = np.where(hit, np.maximum(highest, top), highest)
    hit = np.flatnonzero(np.isfinite(lowest))
    if not hit.size:
        raise AssetError(f"{asset.name}: no column of {spacing * 1000:g} mm meets it", hint="a finer spacing")
    order = hit[farthest_first(xy[hit])]
    return Columns(xy[order], lowest[order], highest[order])


def farthest_first(points: np.ndarray) -> np.ndarray:
    """The order in which each point is the farthest from all before it, starting farthest from the mean."""
    order = np.empty(len(points), int)
    order[0] = np.argmax(((points - points.mean(0)) ** 2).sum(1))
    distance = np.full(len(points), np.inf)
    for place in range(1, len(points)):
        distance = np.minimum(distance, ((points - points[order[place - 1]]) ** 2).sum(1))
        order[place] = np.argmax(distance)
    return order
