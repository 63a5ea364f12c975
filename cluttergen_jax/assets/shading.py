"""Meshes with normals: smooth where the surface bends gently, sharp at its edges. And linear colours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cluttergen_jax.assets.mesh import Mesh, unique_rows

_CREASE = math.radians(40)
"""Faces that meet at a greater angle do not share a normal."""


class Shaded(NamedTuple):
    """A surface as it is drawn.

    Attributes:
      vertices: f32[V, 3], metres.
      normals: f32[V, 3], of unit length.
      faces: u32[F, 3].
      uv: f32[V, 2], the lower left corner of the image being (0, 0); None without a texture.
    """

    vertices: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    uv: np.ndarray | None


def shade(mesh: Mesh, uv: np.ndarray | None = None) -> Shaded:
    """The mesh with normals; a vertex on an edge, or on a seam of its image, comes once for each side.

    Triangles without area are left out.

    Args:
      uv: f[V, 2], if there is a texture.
    """
    points, place = np.unique(np.round(mesh.vertices, 7), axis=0, return_inverse=True)
    faces = place.reshape(-1)[mesh.faces]
    normals = Mesh(points, faces).normals
    area = np.linalg.norm(normals, axis=1)
    keep = area > 1e-14
    faces = faces[keep]
    normals = normals[keep] / area[keep, None]
    area = area[keep]
    smooth = _smooth_normals(faces, normals, area, len(points), math.cos(_CREASE))
    corner_uv = None if uv is None else np.asarray(uv, np.float32)[mesh.faces[keep].ravel()]
    # Equal normals at one vertex, with equal uv, become one vertex again.
    keys = [faces.ravel(), np.round(smooth * 1e4).astype(np.int64)]
    if corner_uv is not None:
        keys.append(np.round(corner_uv * 1e6).astype(np.int64))
    first, index = unique_rows(*keys)
    return Shaded(
        points[faces.ravel()[first]].astype(np.float32),
        smooth[first].astype(np.float32),
        index.reshape(-1, 3).astype(np.uint32),
        None if corner_uv is None else corner_uv[first],
    )


def _smooth_normals(
    faces: np.ndarray, normals: np.ndarray, area: np.ndarray, num_points: int, least: float
) -> np.ndarray:
    """f64[3 F, 3]: at each corner the mean normal of the faces around it that are nearly parallel."""
    from scipy import sparse

    num = 3 * len(faces)
    owner = np.repeat(np.arange(len(faces)), 3)
    at = sparse.csr_array((np.ones(num), (np.arange(num), faces.ravel())), shape=(num, num_points))
    pairs = (at @ at.T).tocoo()
    mine = pairs.coords[0]
    other = pairs.coords[1]
    alike = (normals[owner[mine]] * normals[owner[other]]).sum(1) > least
    weight = area[owner[other]] * alike
    total = np.zeros((num, 3))
    np.add.at(total, mine, normals[owner[other]] * weight[:, None])
    return total / np.linalg.norm(total, axis=1, keepdims=True)


def linear(rgba: Sequence[float]) -> tuple[float, float, float, float]:
    """An sRGB colour as shown, in the linear values that glTF and USD store; alpha as it is."""
    red, green, blue, alpha = (float(value) for value in rgba)
    return (*(_linear_channel(value) for value in (red, green, blue)), alpha)  # type: ignore[return-value]


def _linear_channel(value: float) -> float:
    return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4
