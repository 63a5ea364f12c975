"""Mesh files: OBJ, STL, PLY, GLB, GLTF and DAE, through trimesh."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.readers.damage import check_whole, unreadable
from cluttergen_jax.assets.readers.sizes import check_sizes
from cluttergen_jax.assets.readers.text import TextResolver, opened
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.errors import AssetError

GREY = (0.7, 0.7, 0.7, 1.0)
_STAND_IN = 2


def read_mesh_file(path: Path) -> list[Piece]:
    """The file's surfaces in its own unit and frame, each with one colour.

    Every geometry of a scene graph is placed where its nodes put it. The colour is the material's, or the
    mean over texture or vertex colours. A DAE file's declared unit is applied.

    Raises:
      AssetError: the file is missing, announces more than it holds, or cannot be understood.
    """
    if not path.is_file():
        raise AssetError(f"mesh file {path} is missing", hint="restoring the file or its name")
    check_sizes(path)
    check_whole(path)
    try:
        scene = trimesh.load_scene(**opened(path), resolver=TextResolver(str(path)), process=False)
    except Exception as error:  # trimesh's loaders raise whatever their parsers do.
        raise unreadable(path, error) from error
    is_linear = path.suffix.lower() in (".glb", ".gltf")
    pieces = []
    for node in sorted(scene.graph.nodes_geometry):
        transform, name = scene.graph[node]
        geometry = scene.geometry[name]
        if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces):
            mesh = _sound(geometry, path).transformed(transform[:3, :3], transform[:3, 3])
            if np.linalg.det(transform[:3, :3]) < 0:
                mesh = Mesh(mesh.vertices, mesh.faces[:, ::-1])
            pieces.append(Piece(mesh, mean_colour(geometry.visual, is_linear)))
    if not pieces:
        raise AssetError(f"{path} holds no triangles", "a surface mesh, not points or curves")
    return pieces


def _sound(geometry: trimesh.Trimesh, path: Path) -> Mesh:
    """The triangles, if they are some and name vertices that are there."""
    vertices, faces = np.asarray(geometry.vertices), np.asarray(geometry.faces)
    if faces.ndim != 2 or faces.shape[1] != 3 or vertices.ndim != 2 or vertices.shape[1] != 3:
        raise AssetError(f"{path} holds a surface that is not made of triangles", "triangles in space")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise AssetError(f"{path} is damaged: its triangles name vertices that it does not have")
    return Mesh(vertices, faces)


def mean_colour(visual: Any, is_linear: bool = False) -> tuple[float, float, float, float]:
    """One sRGB colour for a trimesh visual; grey where it has none."""
    try:
        if visual.kind == "texture":
            colours = _texture_colours(visual, is_linear)
        elif visual.defined:
            colours = np.atleast_2d(visual.face_colors) / 255.0
        else:
            return GREY
    except Exception:  # A broken texture must not cost the object.
        return GREY
    r, g, b, a = np.asarray(colours, np.float64).reshape(-1, 4).mean(0).clip(0, 1)
    return (round(float(r), 4), round(float(g), 4), round(float(b), 4), round(float(max(a, 0.2)), 4))


def _texture_colours(visual: Any, is_linear: bool) -> np.ndarray:
    material = visual.material
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if image is not None and max(image.size) <= _STAND_IN:
        # What trimesh puts where a material or its texture is missing.
        return np.array(GREY)
    if image is not None and visual.uv is not None:
        return trimesh.visual.color.uv_to_color(visual.uv, image) / 255.0
    main = np.asarray(material.main_color, np.float64) / 255.0
    if is_linear:
        main[:3] = np.where(main[:3] <= 0.0031308, 12.92 * main[:3], 1.055 * main[:3] ** (1 / 2.4) - 0.055)
    return main


def cleaned(mesh: Mesh, is_closed: bool = False) -> Mesh:
    """The mesh with equal vertices welded; collapsed and doubled triangles and unused vertices dropped.

    Slivers stay: to drop one would open a closed surface. Of coinciding triangles one stays; of a surface
    that should be closed, a triangle and its reverse cancel out.
    """
    if not len(mesh.faces):
        return mesh
    digits = 6 - int(np.floor(np.log10(max(float(np.ptp(mesh.vertices)), 1e-9))))
    _, first, inverse = np.unique(
        np.round(mesh.vertices, digits), axis=0, return_index=True, return_inverse=True
    )
    faces = inverse.reshape(-1)[mesh.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(1)]
    if not len(faces):
        return Mesh(np.zeros((0, 3)), faces)
    corners, turn = np.sort(faces, axis=1), np.sign(_parity(faces))
    _, which = np.unique(corners, axis=0, return_inverse=True)
    which = which.reshape(-1)
    if is_closed:
        balance = np.bincount(which, turn)[which] * turn
        which, faces = which[balance > 0], faces[balance > 0]
    faces = faces[np.sort(np.unique(which, return_index=True)[1])]
    used, faces = np.unique(faces, return_inverse=True)
    return Mesh(mesh.vertices[first][used], faces.reshape(-1, 3))


def _parity(faces: np.ndarray) -> np.ndarray:
    """Positive where a triangle's corners are an even permutation of their sorted order."""
    a, b, c = faces.T
    return np.where((a < b).astype(int) + (b < c) + (c < a) == 2, 1, -1)
