"""OBJ text: surfaces, shaded surfaces for other programs, and collision parts."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.shading import shade
from cluttergen_jax.assets.shape import Piece


def part_name(index: int) -> str:
    """The file name of an asset's collision part number `index`."""
    return f"part-{index:02d}.obj"


def write_parts(folder: Path, asset: ObjectAsset) -> None:
    """Writes the hull of every part of an asset into `folder`, which is made if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, part in enumerate(asset.parts):
        (folder / part_name(index)).write_text(mesh_text(part.hull()), encoding="ascii")


def mesh_text(mesh: Mesh) -> str:
    """A mesh as OBJ, vertices to eight digits."""
    return text(lines("v", mesh.vertices, ".8g") + lines("f", mesh.faces + 1, "d"))


def surface_text(piece: Piece, digits: int) -> str:
    """A compact OBJ: vertices, `vt` where there is a texture, triangles.

    A vertex that comes several times, once for each side of a seam of the image, is written once: so readers
    shade it as one.

    Args:
      digits: significant ones of a coordinate, none finer than a micrometre.
    """
    vertices = lines("v", np.round(piece.mesh.vertices, 6) + 0.0, f".{digits}g")
    if piece.uv is None:
        return text(vertices + lines("f", piece.mesh.faces + 1, "d"))
    number = _line_numbers(vertices)
    corners = [f"{number[line]}/{index}" for index, line in enumerate(vertices, 1)]
    return text([*number, *_uv_lines(piece.uv), *_face_lines(corners, piece.mesh.faces)])


def shaded_text(piece: Piece, material: tuple[str, str] | None = None) -> str:
    """An OBJ for other programs: with normals, and with texture coordinates where there is an image.

    Args:
      material: an MTL file, and the name of a material in it.
    """
    vertices, normals, faces, uv = shade(piece.mesh, piece.uv)
    places = lines("v", vertices, ".7g")
    turns = lines("vn", normals + np.float32(0), ".4f")
    shown = [] if uv is None else _uv_lines(uv)
    place = _line_numbers(places)
    turn = _line_numbers(turns)
    show = _line_numbers(shown)
    images = [str(show[line]) for line in shown] or [""] * len(places)
    corners = [f"{place[p]}/{i}/{turn[t]}" for p, i, t in zip(places, images, turns, strict=True)]
    head, use = ([f"mtllib {material[0]}"], [f"usemtl {material[1]}"]) if material else ([], [])
    return text([*head, *place, *show, *turn, *use, *_face_lines(corners, faces)])


def lines(key: str, rows: np.ndarray, number: str) -> list[str]:
    """A line for each of the rows, such as `v 0 0.5 1`, its numbers in the format `number`."""
    form = " ".join([key] + [f"{{:{number}}}"] * rows.shape[1])
    return [form.format(*row) for row in rows.tolist()]


def text(lines: list[str]) -> str:
    """Lines as the text of a file."""
    return "\n".join(lines) + "\n"


def _line_numbers(lines: list[str]) -> dict[str, int]:
    """Each line once, in order, and its number from 1."""
    return {line: index for index, line in enumerate(dict.fromkeys(lines), 1)}


def _uv_lines(uv: np.ndarray) -> list[str]:
    return lines("vt", uv + np.float32(0), ".6g")


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
        return Mesh(vertices, _checked_faces(corners, len(vertices))), None
    pairs = [[corner.split("/") for corner in row] for row in corners]
    place = _checked_faces([[first for first, _ in row] for row in pairs], len(vertices))
    faces = _checked_faces([[second for _, second in row] for row in pairs], len(uv))
    own = np.zeros(len(uv), np.int32)
    own[faces] = place
    return Mesh(vertices[own], faces), uv


def _checked_faces(corners: list[list[str]], count: int) -> np.ndarray:
    """i32[F, 3], counted from 0."""
    faces = np.array(corners, np.int32) - 1
    if len(faces) == 0 or faces.min() < 0 or faces.max() >= count:
        raise ValueError("a surface whose triangles name vertices that it does not have")
    return faces
