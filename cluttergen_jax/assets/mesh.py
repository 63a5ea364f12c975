"""A triangle mesh as two arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles in some frame, in metres.

    Attributes:
      vertices: f64[V, 3].
      faces: i32[F, 3], counter-clockwise seen from outside. A convex part may leave its
        faces out (F = 0): its convex hull is meant.
    """

    vertices: np.ndarray
    faces: np.ndarray

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", np.asarray(self.vertices, np.float64).reshape(-1, 3))
        object.__setattr__(self, "faces", np.asarray(self.faces, np.int32).reshape(-1, 3))

    @staticmethod
    def points(vertices: np.ndarray) -> Mesh:
        """The convex part spanned by `vertices`, f64[V, 3]."""
        return Mesh(vertices, np.zeros((0, 3), np.int32))

    @property
    def bounds(self) -> np.ndarray:
        """f64[2, 3]: the lower and the upper corner of the axis-aligned box."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)])

    def transformed(self, rotation: np.ndarray, translation: np.ndarray) -> Mesh:
        """The mesh with every vertex v moved to rotation @ v + translation."""
        return Mesh(self.vertices @ np.asarray(rotation).T + np.asarray(translation), self.faces)


def joined(meshes: list[Mesh] | tuple[Mesh, ...]) -> Mesh:
    """All triangles of several meshes as one mesh, nothing welded."""
    offsets = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=True)]),
    )
