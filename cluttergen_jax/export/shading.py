"""Meshes with normals: smooth where the surface bends gently, sharp at its edges."""

from __future__ import annotations

import math

import numpy as np
from scipy import sparse

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.support import Box

_CREASE = math.radians(40)


def shaded(mesh: Mesh, crease: float = _CREASE) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, unit normals and triangles; a vertex on an edge comes once for each side.

    Args:
      crease: radians; faces that meet at a greater angle do not share a normal.

    Returns:
      f32[V, 3], f32[V, 3], u32[F, 3]. Triangles without area are left out.
    """
    points, place = np.unique(np.round(mesh.vertices, 7), axis=0, return_inverse=True)
    faces = place.reshape(-1)[mesh.faces]
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    keep = area > 1e-14
    faces, normals, area = faces[keep], normals[keep] / area[keep, None], area[keep]
    smooth = _smoothed(faces, normals, area, len(points), math.cos(crease))
    # Equal normals at one vertex become one vertex again.
    keys = np.column_stack([faces.ravel(), np.round(smooth * 1e4).astype(np.int64)])
    _, first, index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return (
        points[faces.ravel()[first]].astype(np.float32),
        smooth[first].astype(np.float32),
        index.reshape(-1, 3).astype(np.uint32),
    )


def _smoothed(
    faces: np.ndarray, normals: np.ndarray, area: np.ndarray, num_points: int, least: float
) -> np.ndarray:
    """f64[3 F, 3]: at each corner the mean normal of the faces around it that are nearly parallel."""
    num = 3 * len(faces)
    owner = np.repeat(np.arange(len(faces)), 3)
    at = sparse.csr_array((np.ones(num), (np.arange(num), faces.ravel())), shape=(num, num_points))
    pairs = (at @ at.T).tocoo()
    mine, other = pairs.coords[0], pairs.coords[1]
    alike = (normals[owner[mine]] * normals[owner[other]]).sum(1) > least
    weight = area[owner[other]] * alike
    total = np.zeros((num, 3))
    np.add.at(total, mine, normals[owner[other]] * weight[:, None])
    return total / np.linalg.norm(total, axis=1, keepdims=True)


def box_mesh(box: Box) -> Mesh:
    """A support's box as triangles, world frame."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
    local = signs * box.half_extents
    cosine, sine = math.cos(box.yaw), math.sin(box.yaw)
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [tri for a, b, c, d in quads for tri in ((a, b, c), (a, c, d))]
    return Mesh(local @ turn.T + np.array(box.center), np.array(faces))
