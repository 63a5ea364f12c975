"""Surfaces as OBJ text, with the places in their images if they have some."""

from __future__ import annotations

import numpy as np

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece


def surface_text(piece: Piece, digits: int, material: tuple[str, str] | None = None) -> str:
    """A compact OBJ: vertices, `vt` where there is a texture, triangles.

    Args:
      digits: significant ones of a coordinate, none finer than a micrometre.
      material: an MTL file and the name of a material in it, for readers that look there.
    """
    lines = [f"mtllib {material[0]}"] if material else []
    vertices = np.round(piece.mesh.vertices, 6) + 0.0
    lines += [f"v {x:.{digits}g} {y:.{digits}g} {z:.{digits}g}" for x, y, z in vertices.tolist()]
    faces = (piece.mesh.faces + 1).tolist()
    if piece.uv is not None:
        lines += [f"vt {u:.6g} {v:.6g}" for u, v in (piece.uv + np.float32(0)).tolist()]
    if material:
        lines.append(f"usemtl {material[1]}")
    if piece.uv is None:
        lines += [f"f {a} {b} {c}" for a, b, c in faces]
    else:
        lines += [f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in faces]
    return "\n".join(lines) + "\n"


def parse_surface(text: str) -> tuple[Mesh, np.ndarray | None]:
    """The mesh and f32[V, 2] (None without a texture) that `surface_text` wrote.

    Raises:
      ValueError: it is no such text.
    """
    rows = [line.split() for line in text.splitlines()]
    vertices = np.array([row[1:4] for row in rows if row and row[0] == "v"], np.float64)
    places = np.array([row[1:3] for row in rows if row and row[0] == "vt"], np.float32)
    corners = [[each.partition("/")[0] for each in row[1:4]] for row in rows if row and row[0] == "f"]
    faces = np.array(corners, np.int32) - 1
    if len(faces) == 0 or faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError("a surface whose triangles name vertices that it does not have")
    return Mesh(vertices, faces), places if len(places) else None
