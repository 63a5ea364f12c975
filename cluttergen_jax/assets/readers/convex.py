"""Telling whether a model's collision meshes are convex parts already."""

from __future__ import annotations

import numpy as np

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.parts import hull_of

MAX_PARTS = 32


def convex_parts(meshes: list[Mesh], tolerance: float = 0.02) -> tuple[Mesh, ...] | None:
    """The vertices of each mesh as a part, if there are few and each fills its hull; else None.

    A mesh fills its hull if the volume that its triangles enclose is within `tolerance` of the hull's.
    """
    if not 0 < len(meshes) <= MAX_PARTS:
        return None
    return (
        tuple(Mesh.points(mesh.vertices) for mesh in meshes)
        if all(is_convex(mesh, tolerance) for mesh in meshes)
        else None
    )


def is_convex(mesh: Mesh, tolerance: float = 0.02) -> bool:
    """Whether the triangles enclose all of the hull but a share of `tolerance`."""
    hull = hull_of(mesh.vertices)
    return hull is not None and bool(abs(signed_volume(mesh)) > (1 - tolerance) * hull.volume)


def signed_volume(mesh: Mesh) -> float:
    """Cubic metres enclosed by a closed mesh, positive if its triangles face outwards."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] - mesh.vertices.mean(0) for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)
