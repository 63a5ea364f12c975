"""What pose estimation knows of an object: its surface as points, its symmetry, and how it rests."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from cluttergen_jax.assets import ObjectAsset, join_meshes, turn_symmetry
from cluttergen_jax.sensing import RaySensor, sensed_model

NUM_POINTS = 3000
NUM_DENSE = 60_000
NUM_JUDGED = 1000


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """An object as pose estimation knows it.

    Attributes:
      asset: the object. symmetry: of its turns about z (`assets.symmetry.turn_symmetry`).
      points, normals: f64[3000, 3], of its surface, object frame, metres.
    """

    asset: ObjectAsset
    symmetry: int
    points: np.ndarray
    normals: np.ndarray
    _surface: trimesh.Trimesh = field(repr=False)

    @staticmethod
    @lru_cache(maxsize=64)
    def of(asset: ObjectAsset) -> ObjectModel:
        """The model of an object, made once: what is drawn of it, or its collision parts where nothing is."""
        mesh = join_meshes(
            [piece.mesh for piece in asset.pieces] or [part.hull() for part in asset.parts]
        )
        surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        points, faces = trimesh.sample.sample_surface(surface, NUM_POINTS, seed=0)
        normals = np.asarray(surface.face_normals)[faces]
        return ObjectModel(asset, turn_symmetry(asset), np.asarray(points), normals, surface)

    @cached_property
    def tree(self) -> cKDTree:
        """Of `points`."""
        return cKDTree(self.points)

    @cached_property
    def sensor(self) -> RaySensor:
        """Casts rays at the object alone."""
        return RaySensor(sensed_model([self.asset], None), bool(self.asset.pieces))

    @cached_property
    def _dense(self) -> cKDTree:
        return cKDTree(trimesh.sample.sample_surface(self._surface, NUM_DENSE, seed=1)[0])

    def surface_distance(self, pose: np.ndarray, other: np.ndarray) -> float:
        """ADD-S: mean metres from points of the surface at one pose f64[4, 4] to the surface at another.

        The other surface is so densely sampled that what this adds is below a millimetre.
        """
        points = self.points[:NUM_JUDGED]
        moved = np.linalg.inv(other) @ pose
        return float(self._dense.query(points @ moved[:3, :3].T + moved[:3, 3])[0].mean())
