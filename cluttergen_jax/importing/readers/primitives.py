"""Boxes, cylinders, spheres, capsules and ellipsoids as meshes, and as convex parts of few vertices."""

from __future__ import annotations

import numpy as np
import trimesh

from cluttergen_jax.assets.mesh import Mesh


def box(half_extents: np.ndarray) -> Mesh:
    """A box centred on the origin."""
    return _mesh(trimesh.creation.box(2 * np.asarray(half_extents, np.float64)))


def cylinder(radius: float, half_height: float, sections: int = 32) -> Mesh:
    """A cylinder along z, centred on the origin."""
    return _mesh(trimesh.creation.cylinder(radius, 2 * half_height, sections=sections))


def ellipsoid(radii: np.ndarray) -> Mesh:
    """An ellipsoid centred on the origin; equal radii make a sphere."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    return Mesh(ball.vertices * np.asarray(radii, np.float64), ball.faces)


def capsule(radius: float, half_height: float) -> Mesh:
    """A capsule along z, centred on the origin; `half_height` is that of its cylinder."""
    tri = trimesh.creation.capsule(height=2 * half_height, radius=radius, count=(16, 16))
    tri.apply_translation(-tri.bounds.mean(0))
    return _mesh(tri)


def _mesh(tri: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(tri.vertices), np.asarray(tri.faces))
