"""How far the parts' surface is from the mesh: the symmetric Hausdorff distance, by sampling."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from cluttergen_jax.assets.cloud import sample_solid, sample_surface
from cluttergen_jax.assets.mesh import Mesh, joined
from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.assets.solid import Solid
from cluttergen_jax.assets.voxels import Voxels

NUM_SAMPLES = 10_000
_DENSITY = 20
# Cells along the longest side: gaps of up to two of them, 1.4 % of it, count as closed.
_FINE = 144


def sample_parts(parts: Sequence[np.ndarray], count: int, seed: int) -> np.ndarray:
    """f64[<= count, 3]: points of the parts' surface that can be seen from outside.

    Faces along which parts touch, or nearly so, are no surface of the object: nothing can get there.
    """
    mesh = surface_of(parts)
    points = sample_surface(mesh, 3 * count, seed)
    return points[Voxels.of(mesh).is_exposed(points)][:count]


def surface_of(parts: Sequence[np.ndarray]) -> Mesh:
    """The triangles of all parts' hulls as one mesh, overlaps and all."""
    hulls = [hull for hull in map(hull_of, parts) if hull is not None]
    return joined([Mesh(hull.points, hull.simplices) for hull in hulls])


def is_within_parts(points: np.ndarray, parts: Sequence[np.ndarray]) -> np.ndarray:
    """bool[N]: whether points lie in one of the convex parts."""
    inside = np.zeros(len(points), bool)
    for hull in map(hull_of, parts):
        if hull is None:
            continue
        near = np.flatnonzero(((points >= hull.min_bound) & (points <= hull.max_bound)).all(1) & ~inside)
        height = points[near] @ hull.equations[:, :3].T + hull.equations[:, 3]
        inside[near] = height.max(1, initial=-np.inf) < 0
    return inside


def deviation(parts: Sequence[np.ndarray], solid: Solid, seed: int = 0) -> float:
    """Symmetric Hausdorff distance between parts and mesh, 10,000 samples each way, over the diagonal.

    Each sample's distance is taken to the nearest of 200,000 points of the other surface, which can only
    make it larger than it is. Faces along which pieces touch, such as a box and its lid, are no surface.
    """
    dense = NUM_SAMPLES * _DENSITY
    on_solid, on_parts = sample_solid(solid, dense, seed), sample_parts(parts, dense, seed + 1000)
    there = cKDTree(on_parts).query(on_solid[:NUM_SAMPLES])[0]
    back = cKDTree(on_solid).query(on_parts[:NUM_SAMPLES])[0].max()
    if solid.is_exact and there.max() > back:
        # Pieces that only touch are united with a gap between them, which nothing can enter.
        is_outer = Voxels.of(solid.mesh, _FINE).is_exposed(on_solid[:NUM_SAMPLES])
        there = there[is_outer]
    return float(max(there.max(initial=0.0), back) / solid.diagonal)


def hull_deviation(points: np.ndarray, solid: Solid) -> float:
    """`deviation` of a single hull."""
    return deviation([points], solid)
