"""Turn symmetry about an object's own z, and how far a pose is from a goal up to it."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.downstream.robot.frames import angle_between

TOLERANCE = 0.005
"""Metres that a symmetric object's surface may lie off itself once it is turned; points lie 2 mm apart. It
is the error below which a pose counts as right: depth cameras do not tell such turns apart."""
ROUND = 24
"""An object of so many equal turns counts as round: any turn about z is as good as another."""
_ORDERS = (ROUND, 8, 6, 5, 4, 3, 2)
_NUM_POINTS = 40_000


def turn_symmetry(asset: ObjectAsset) -> int:
    """The most equal turns about its z axis after which the object looks the same, colours aside; 1 for none.

    What is drawn of it decides; of an object without surfaces, its collision parts.
    """
    meshes = [piece.mesh for piece in asset.pieces] or [_hull(part.vertices) for part in asset.parts]
    surface = trimesh.util.concatenate([trimesh.Trimesh(mesh.vertices, mesh.faces) for mesh in meshes])
    dense, _ = trimesh.sample.sample_surface(surface, _NUM_POINTS, seed=0)
    tree, sparse = cKDTree(dense), dense[: _NUM_POINTS // 20]
    for order in _ORDERS:
        turned = (sparse @ turn_matrix(angle)[:3, :3].T for angle in _angles(order))
        if all(tree.query(points)[0].max() <= TOLERANCE for points in turned):
            return order
    return 1


def _hull(vertices: np.ndarray) -> Mesh:
    hull = trimesh.convex.convex_hull(vertices)
    return Mesh(np.asarray(hull.vertices), np.asarray(hull.faces))


def _angles(order: int) -> np.ndarray:
    return 2 * np.pi * np.arange(1, order // 2 + 1) / order


def turn_matrix(angle: float) -> np.ndarray:
    """f64[4, 4]: a turn about z by radians."""
    matrix = np.eye(4)
    matrix[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return matrix


def equal_places(place: np.ndarray, order: int, most: int = 8) -> np.ndarray:
    """f64[n, 4, 4]: poses of an object of this symmetry that look like `place` f64[4, 4], itself first."""
    number = min(order, most)
    angles = 2 * np.pi * np.arange(number) / number
    # With most = 8 every order that is not round divides the turn without rest, or is taken whole.
    return np.stack([place @ turn_matrix(angle) for angle in angles])


def offset(pose: np.ndarray, goal: np.ndarray, order: int) -> tuple[float, float]:
    """Metres and radians between poses f64[4, 4] of an object, at the best of its equal turns."""
    shift = float(np.linalg.norm(pose[:3, 3] - goal[:3, 3]))
    if order >= ROUND:
        return shift, float(np.arccos(np.clip(pose[:3, 2] @ goal[:3, 2], -1, 1)))
    return shift, float(angle_between(pose, equal_places(goal, order)).min())
