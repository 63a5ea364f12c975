"""Surfaces as OBJ text, with the places in their images if they have some."""

from __future__ import annotations

import numpy as np

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece


def surface_text(piece: Piece, digits: int, material: tuple[str, str] | None = None) -> str:
    """A compact OBJ: vertices, `vt` where there is a texture, triangles.

    A vertex that comes several times, once for each side of a seam of the image, is written once: so readers
    shade it as one.

    Args:
      digits: significant ones of a coordinate, none finer than a micrometre.
      material: an MTL file and the name of a material in it, for readers that look there.
    """
    rounded = np.round(piece.mesh.vertices, 6) + 0.0
    vertices = [f"v {x:.{digits}g} {y:.{digits}g} {z:.{digits}g}" for x, y, z in rounded.tolist()]
    if piece.uv is None:
        return (
            "\n".join([*vertices, *(f"f {a} {b} {c}" for a, b, c in (piece.mesh.faces + 1).tolist())]) + "\n"
        )
    number = {line: index for index, line in enumerate(dict.fromkeys(vertices), 1)}
    corners = [f"{number[line]}/{index}" for index, line in enumerate(vertices, 1)]
    lines = [
        *([f"mtllib {material[0]}"] if material else []),
        *number,
        *(f"vt {u:.6g} {v:.6g}" for u, v in (piece.uv + np.float32(0)).tolist()),
        *([f"usemtl {material[1]}"] if material else []),
        *(f"f {corners[a]} {corners[b]} {corners[c]}" for a, b, c in piece.mesh.faces.tolist()),
    ]
    return "\n".join(lines) + "\n"


def parse_surface(text: str) -> tuple[Mesh, np.ndarray | None]:
    """The mesh and f32[V, 2] (None without a texture) that `surface_text` wrote.

    Raises:
      ValueError: it is no such text.
    """
    rows = [line.split() for line in text.splitlines()]
    vertices = np.array([row[1:4] for row in rows if row and row[0] == "v"], np.float64)
    uv = np.array([row[1:3] for row in rows if row and row[0] == "vt"], np.float32)
    corners = [row[1:4] for row in rows if row and row[0] == "f"]
    if not len(uv):
        return Mesh(vertices, _checked(corners, len(vertices))), None
    pairs = [[corner.split("/") for corner in row] for row in corners]
    place = _checked([[first for first, _ in row] for row in pairs], len(vertices))
    faces = _checked([[second for _, second in row] for row in pairs], len(uv))
    own = np.zeros(len(uv), np.int32)
    own[faces] = place
    return Mesh(vertices[own], faces), uv


def _checked(corners: list[list[str]], count: int) -> np.ndarray:
    """i32[F, 3], counted from 0."""
    faces = np.array(corners, np.int32) - 1
    if len(faces) == 0 or faces.min() < 0 or faces.max() >= count:
        raise ValueError("a surface whose triangles name vertices that it does not have")
    return faces
