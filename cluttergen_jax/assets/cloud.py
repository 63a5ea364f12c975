"""Surface point clouds whose every prefix is a good sample."""

from __future__ import annotations

import numpy as np

from cluttergen_jax.assets.deviation import sample_solid
from cluttergen_jax.assets.object import CLOUD_SIZE
from cluttergen_jax.assets.solid import Solid


def surface_cloud(solid: Solid, seed: int = 0) -> np.ndarray:
    """f64[1024, 3]: points of the outer surface, uniform by area, in farthest-point order."""
    points = sample_solid(solid, CLOUD_SIZE, seed)
    if len(points) < CLOUD_SIZE:
        points = np.concatenate([points, sample_solid(solid, 8 * CLOUD_SIZE, seed + 1)])[:CLOUD_SIZE]
    return points[farthest_first(points)]


def farthest_first(points: np.ndarray) -> np.ndarray:
    """i64[N]: an order in which each point is the farthest from all before it.

    Starts with the point farthest from the mean, so that the order does not depend on how points came.
    """
    order = np.empty(len(points), np.int64)
    distance = np.full(len(points), np.inf)
    current = int(np.linalg.norm(points - points.mean(0), axis=1).argmax())
    for index in range(len(points)):
        order[index] = current
        distance = np.minimum(distance, ((points - points[current]) ** 2).sum(1))
        current = int(distance.argmax())
    return order
