"""An image laid over another mesh of the same surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece

UV_DIGITS = 6
_NEAR = 16
"""Triangles among which the nearest is looked for."""


def transferred(piece: Piece, mesh: Mesh) -> Piece:
    """The textured piece with `mesh` in place of its own, each corner's uv taken from the nearest old place.

    The old surface falls into charts, between which the image is cut. A new triangle takes all of its uv
    from the chart nearest to its middle, so that none is stretched from one side of a cut to the other; a
    vertex at a cut comes once for each chart.
    """
    assert piece.uv is not None
    old = piece.mesh
    chart = _charts(old)
    tree = cKDTree(old.vertices[old.faces].mean(1))
    corners = mesh.vertices[mesh.faces]
    everything = np.full(len(mesh.faces), -1)
    middle = _nearest(old, tree, chart, corners.mean(1), everything)[0]
    own = np.repeat(chart[middle], 3)
    face, weights = _nearest(old, tree, chart, corners.reshape(-1, 3), own)
    uv = (piece.uv[old.faces[face]] * weights[..., None]).sum(1)
    keys = np.column_stack([mesh.faces.ravel(), own])
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    vertices = mesh.vertices[mesh.faces.ravel()[first]]
    return replace(piece, mesh=Mesh(vertices, inverse.reshape(-1, 3)), uv=uv[first].astype(np.float32))


def _charts(mesh: Mesh) -> np.ndarray:
    """i[F]: for each triangle the number of its chart: those that share a vertex are of one."""
    size = len(mesh.vertices)
    rows, columns = mesh.faces.ravel(), np.roll(mesh.faces, 1, axis=1).ravel()
    linked = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(size, size))
    return connected_components(linked, directed=False)[1][mesh.faces[:, 0]]


def _nearest(
    mesh: Mesh, tree: cKDTree, chart: np.ndarray, points: np.ndarray, wanted: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """i[P] and f64[P, 3]: the triangle nearest to each point, and the weights of its corners there.

    Args:
      wanted: i[P], the chart to which the triangle must belong where any that is near does; -1 for any.
    """
    near = tree.query(points, min(_NEAR, len(mesh.faces)))[1].reshape(len(points), -1)
    triangles = mesh.vertices[mesh.faces[near.ravel()]]
    targets = np.repeat(points, near.shape[1], axis=0)
    closest = trimesh.triangles.closest_point(triangles, targets)
    away = np.linalg.norm(closest - targets, axis=1).reshape(near.shape)
    is_other = (wanted[:, None] >= 0) & (chart[near] != wanted[:, None])
    # A chart that has nothing near is worse than none only by being far away.
    best = np.argmin(away + np.where(is_other, np.ptp(mesh.vertices, axis=0).max() * 4, 0.0), axis=1)
    picked = np.arange(len(points)) * near.shape[1] + best
    weights = trimesh.triangles.points_to_barycentric(triangles[picked], closest[picked])
    is_flat = ~np.isfinite(weights).all(1)
    weights[is_flat] = 1 / 3
    return near[np.arange(len(points)), best], np.clip(weights, 0, 1)
