"""Points of surfaces: uniform samples, and clouds whose every prefix is a good sample."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.object import CLOUD_SIZE
from cluttergen_jax.assets.solid import Solid
from cluttergen_jax.assets.voxels import Voxels


class Samples(NamedTuple):
    """Points of a mesh: f64[N, 3], i64[N], the triangle of each, and f64[N, 3], the shares of its corners."""

    points: np.ndarray
    faces: np.ndarray
    weights: np.ndarray


def sample_faces(mesh: Mesh, count: int, seed: int) -> Samples:
    """Points on the mesh, uniform by area, the same for the same seed."""
    area = np.cumsum(np.linalg.norm(mesh.normals, axis=1))
    rng = np.random.default_rng(seed)
    which = np.searchsorted(area, rng.uniform(0, area[-1], count), side="right").clip(0, len(area) - 1)
    root, along = np.sqrt(rng.uniform(size=count)), rng.uniform(size=count)
    weights = np.stack([1 - root, root * (1 - along), root * along], axis=1)
    return Samples(np.einsum("nk,nkd->nd", weights, mesh.corners[which]), which, weights)


def sample_surface(mesh: Mesh, count: int, seed: int) -> np.ndarray:
    """f64[count, 3]: the points of `sample_faces`."""
    return sample_faces(mesh, count, seed).points


def sample_solid(solid: Solid, count: int, seed: int) -> np.ndarray:
    """f64[<= count, 3]: points of the object's own surface that can be seen from outside.

    Of an exact solid all of its surface; else of all triangles those that a flood from outside reaches.
    """
    if solid.is_exact:
        return sample_surface(solid.mesh, count, seed)
    points = sample_surface(solid.surface, 3 * count, seed)
    return points[Voxels.of(solid.surface).is_exposed(points)][:count]


def surface_cloud(solid: Solid, seed: int = 0) -> np.ndarray:
    """f64[1024, 3]: points of the outer surface, uniform by area, in farthest-point order."""
    points = sample_solid(solid, CLOUD_SIZE, seed)
    if len(points) < CLOUD_SIZE:
        points = np.concatenate([points, sample_solid(solid, 8 * CLOUD_SIZE, seed + 1)])[:CLOUD_SIZE]
    return points[farthest_first(points)]


def farthest_first(
    points: np.ndarray, count: int | None = None, weight: np.ndarray | float = 1.0
) -> np.ndarray:
    """i64[M]: an order in which each point is the farthest from all before it.

    Starts with the point farthest from the mean, so that the order does not depend on how points came.

    Args:
      points: f64[N, D].
      count: how many to take, all of them by default.
      weight: f64[N]: distances to points that are to lie denser count for more.
    """
    order = np.empty(len(points) if count is None else min(count, len(points)), np.int64)
    distance = np.full(len(points), np.inf)
    current = int(((points - points.mean(0)) ** 2).sum(1).argmax())
    for index in range(len(order)):
        order[index] = current
        distance = np.minimum(distance, ((points - points[current]) ** 2).sum(1))
        current = int((distance * weight**2).argmax())
    return order
