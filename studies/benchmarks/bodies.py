"""Hand-built bodies for benchmarks: simple enough that the right answer is known."""

from __future__ import annotations

import numpy as np

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.object import ObjectAsset, RestingPose
from cluttergen_jax.assets.shape import Provenance


def box(name: str, half_extents: tuple[float, float, float], mass: float) -> ObjectAsset:
    """A solid box: half sizes in metres, kilograms."""
    half = np.asarray(half_extents, np.float64)
    corners = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), -1).reshape(-1, 3) * half
    return _solid(name, corners, np.diag((half**2).sum() - half**2) * mass / 3, mass)


def prism(name: str, radius: float, half_height: float, mass: float) -> ObjectAsset:
    """A hexagonal prism that stands on one of its hexagons; its inertia is that of a cylinder."""
    angle = np.arange(6) * np.pi / 3
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], -1)
    vertices = np.concatenate([np.c_[ring, np.full(6, z)] for z in (-half_height, half_height)])
    across = mass * (3 * radius**2 + 4 * half_height**2) / 12
    return _solid(name, vertices, np.diag([across, across, mass * radius**2 / 2]), mass)


def apple(name: str, radius: float, mass: float) -> ObjectAsset:
    """A round thing of 32 vertices: the corners of an icosahedron and of its dual on one sphere."""
    golden = (1 + 5**0.5) / 2
    signs = [(a, b) for a in (-1, 1) for b in (-1, 1)]
    corners: list[tuple[float, ...]] = []
    for a, b in signs:
        for x, y, z in ((0, a, b * golden), (0, a * golden, b / golden)):
            corners += [(x, y, z), (z, x, y), (y, z, x)]
        corners += [(a, b, c) for c in (-1, 1)]
    vertices = np.array(corners) / np.linalg.norm(corners, axis=1, keepdims=True) * radius
    return _solid(name, vertices, np.eye(3) * 0.4 * mass * radius**2, mass)


def _solid(name: str, vertices: np.ndarray, inertia: np.ndarray, mass: float) -> ObjectAsset:
    return ObjectAsset(
        name=name,
        label=name,
        pieces=(),
        parts=(Mesh.points(vertices),),
        mass=mass,
        center_of_mass=np.zeros(3),
        inertia=inertia,
        cloud=np.zeros((1024, 3), np.float32),
        resting=(RestingPose((1.0, 0.0, 0.0, 0.0), float(-vertices[:, 2].min()), 1.0),),
        provenance=Provenance("benchmarks", "Apache-2.0"),
    )
