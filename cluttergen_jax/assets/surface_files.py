"""Surfaces as OBJ text, with the places in their images if they have some."""

from __future__ import annotations

import numpy as np

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shading import shaded
from cluttergen_jax.assets.shape import Piece


def surface_text(piece: Piece, digits: int) -> str:
    """A compact OBJ: vertices, `vt` where there is a texture, triangles.

    A vertex that comes several times, once for each side of a seam of the image, is written once: so readers
    shade it as one.

    Args:
      digits: significant ones of a coordinate, none finer than a micrometre.
    """
    rounded = np.round(piece.mesh.vertices, 6) + 0.0
    vertices = [f"v {x:.{digits}g} {y:.{digits}g} {z:.{digits}g}" for x, y, z in rounded.tolist()]
    if piece.uv is None:
        return (
            "\n".join([*vertices, *(f"f {a} {b} {c}" for a, b, c in (piece.mesh.faces + 1).tolist())]) + "\n"
        )
    number = _numbered(vertices)
    corners = [f"{number[line]}/{index}" for index, line in enumerate(vertices, 1)]
    lines = [*number, *_uv_lines(piece.uv), *_face_lines(corners, piece.mesh.faces)]
    return "\n".join(lines) + "\n"


def shaded_text(piece: Piece, material: tuple[str, str] | None = None) -> str:
    """An OBJ for other programs: with normals, and with texture coordinates where there is an image.

    Args:
      material: an MTL file, and the name of a material in it.
    """
    vertices, normals, faces, uv = shaded(piece.mesh, piece.uv)
    places = [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in vertices.tolist()]
    turns = [f"vn {x:.4f} {y:.4f} {z:.4f}" for x, y, z in (normals + np.float32(0)).tolist()]
    shown = [] if uv is None else _uv_lines(uv)
    place, turn, show = _numbered(places), _numbered(turns), _numbered(shown)
    images = [str(show[line]) for line in shown] or [""] * len(places)
    corners = [f"{place[p]}/{i}/{turn[t]}" for p, i, t in zip(places, images, turns, strict=True)]
    head, use = ([f"mtllib {material[0]}"], [f"usemtl {material[1]}"]) if material else ([], [])
    return "\n".join([*head, *place, *show, *turn, *use, *_face_lines(corners, faces)]) + "\n"


def _numbered(lines: list[str]) -> dict[str, int]:
    """Each line once, in order, and its number from 1."""
    return {line: index for index, line in enumerate(dict.fromkeys(lines), 1)}


def _uv_lines(uv: np.ndarray) -> list[str]:
    return [f"vt {u:.6g} {v:.6g}" for u, v in (uv + np.float32(0)).tolist()]


def _face_lines(corners: list[str], faces: np.ndarray) -> list[str]:
    return [f"f {corners[a]} {corners[b]} {corners[c]}" for a, b, c in faces.tolist()]


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
