"""An image laid over another mesh of the same surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece

UV_DIGITS = 6
_NEAR = 16
"""Triangles among which the nearest is looked for."""
_STRETCH = 3.0
"""Times the stretch of the image at a triangle's middle by which it may be stretched up to a corner."""


def transferred(piece: Piece, mesh: Mesh) -> Piece:
    """The textured piece with `mesh` in place of its own, each corner's uv taken from the nearest old place.

    The image is cut along seams, and what lies beyond a seam is elsewhere in the image. So the place of a new
    triangle's middle is found first, and its corners' places are taken only where the image runs on from
    there; elsewhere it is continued as it lies on the old triangle in the middle.
    """
    assert piece.uv is not None
    old, uv = piece.mesh, piece.uv.astype(np.float64)
    tree = cKDTree(old.vertices[old.faces].mean(1))
    corners = mesh.corners
    middle = corners.mean(1)
    places, away, owner = _candidates(old, uv, tree, middle)
    best = np.argmin(away, axis=1)
    row = np.arange(len(middle))
    start, triangle = places[row, best], owner[row, best]
    stretch = _STRETCH * _scale(old, uv)[triangle]
    found = np.empty((len(middle), 3, 2))
    for k in range(3):
        places, away, _ = _candidates(old, uv, tree, corners[:, k])
        step = np.linalg.norm(places - start[:, None], axis=2)
        runs_on = step <= (stretch * np.linalg.norm(corners[:, k] - middle, axis=1))[:, None] + 1e-6
        best = np.argmin(np.where(runs_on, away, np.inf), axis=1)
        continued = _places(old, uv, triangle, corners[:, k])
        found[:, k] = np.where(runs_on.any(1)[:, None], places[row, best], continued)
    keys = np.column_stack([mesh.faces.ravel(), np.round(found.reshape(-1, 2), UV_DIGITS)])
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    vertices = mesh.vertices[mesh.faces.ravel()[first]]
    return replace(
        piece,
        mesh=Mesh(vertices, inverse.reshape(-1, 3)),
        uv=found.reshape(-1, 2)[first].astype(np.float32),
    )


def _candidates(
    mesh: Mesh, uv: np.ndarray, tree: cKDTree, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each of P points the nearest places on C triangles near it.

    Returns:
      f64[P, C, 2], their uv; f64[P, C], how far they are, metres; i[P, C], the triangles.
    """
    near = tree.query(points, min(_NEAR, len(mesh.faces)))[1].reshape(len(points), -1)
    triangles = mesh.vertices[mesh.faces[near.ravel()]]
    targets = np.repeat(points, near.shape[1], axis=0)
    closest = trimesh.triangles.closest_point(triangles, targets)
    places = _places(mesh, uv, near.ravel(), closest)
    away = np.linalg.norm(closest - targets, axis=1)
    return places.reshape(*near.shape, 2), away.reshape(near.shape), near


def _scale(mesh: Mesh, uv: np.ndarray) -> np.ndarray:
    """f64[F]: the most that the image moves on a triangle, in uv for each metre."""
    corners, places = mesh.corners, uv[mesh.faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    steps = np.linalg.norm(places - np.roll(places, 1, axis=1), axis=2)
    return (steps / np.maximum(sides, 1e-9)).max(1)


def _places(mesh: Mesh, uv: np.ndarray, triangle: np.ndarray, points: np.ndarray) -> np.ndarray:
    """f64[P, 2]: uv at points in the planes of triangles i[P], beyond their edges as if they went on."""
    faces = mesh.faces[triangle]
    weights = trimesh.triangles.points_to_barycentric(mesh.vertices[faces], points)
    weights = np.where(np.isfinite(weights).all(1)[:, None], weights, 1 / 3)
    return np.asarray((uv[faces] * weights[..., None]).sum(1))
