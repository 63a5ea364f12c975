"""Mesh files: OBJ, STL, PLY, GLB, GLTF and DAE, through trimesh."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh

from cluttergen_jax.assets.config import MAX_TEXTURE
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.texture import Texture
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.collada import collada_notes, collada_polygons, unit_of
from cluttergen_jax.importing.readers.colours import coloured_by_vertices
from cluttergen_jax.importing.readers.damage import (
    check_whole,
    ply_of_polygons,
    sound_stl,
    unreadable,
)
from cluttergen_jax.importing.readers.materials import Dresser, gltf_notes
from cluttergen_jax.importing.readers.mesh_text import Companions, mesh_input
from cluttergen_jax.importing.readers.opening import check_openable
from cluttergen_jax.importing.readers.polygons import cut_obj

_RANDOM = re.compile(r"_[0-9a-f]{6}$")
"""What trimesh puts behind a node's name where several surfaces hang on it, another each time."""


def _mend_obj(data: bytes) -> tuple[bytes, tuple[str, ...]]:
    data, of_colours = coloured_by_vertices(data)
    data, of_polygons = cut_obj(data)
    return data, (*of_colours, *of_polygons)


_MENDS: dict[str, Callable[[bytes], tuple[bytes, tuple[str, ...]]]] = {
    ".obj": _mend_obj,
    ".stl": sound_stl,
}
"""By suffix, what is done to a file's content before it is parsed."""


class MeshFile(NamedTuple):
    """What a mesh file holds."""

    pieces: list[
        Piece
    ]  # Its surfaces, in the file's own frame, and unless it declares a unit in its own.
    notes: tuple[str, ...]  # What could not be kept of its materials, in words.


class NamedMeshFile(NamedTuple):
    """What a mesh file holds, and what its surfaces are called."""

    pieces: list[Piece]
    notes: tuple[str, ...]
    names: tuple[tuple[str, ...], ...]  # Of each surface, what it hangs on, the innermost first.


def read_mesh_file(
    path: Path, max_side: int = MAX_TEXTURE, image: Texture | None = None
) -> MeshFile:
    """`read_named_file` without the names."""
    pieces, notes, _ = read_named_file(path, max_side, image)
    return MeshFile(pieces, notes)


def read_named_file(
    path: Path, max_side: int = MAX_TEXTURE, image: Texture | None = None
) -> NamedMeshFile:
    """The file's surfaces in its own frame, each with one colour, with its vertices' or with its image.

    Every geometry of a scene graph is placed where its nodes put it. The colour is the material's; colours
    of vertices or triangles that differ are kept for each vertex. A DAE file's declared unit is applied, its
    vertical axis is not (`axes.own_up`): where a URDF names such a file, that is what PyBullet does. Other
    files are in their own unit.

    Args:
      max_side: pixels; larger images are shrunk.
      image: for surfaces that have texture coordinates but no image of their own.

    Raises:
      AssetError: the file is missing, announces more than it holds, or cannot be understood.
    """
    check_openable(path)
    if not path.is_file():
        raise AssetError(f"mesh file {path} is missing", hint="restoring the file or its name")
    check_whole(path)
    beside = Companions(path)
    try:
        scene, of_parsing = _parse(path, beside)
    except AssetError:
        raise
    except Exception as error:  # trimesh's loaders raise whatever their parsers do.
        raise unreadable(path, error) from error
    is_gltf = path.suffix.lower() in (".glb", ".gltf")
    is_collada = path.suffix.lower() == ".dae"
    unit = unit_of(path) if is_collada else 1.0
    dresser = Dresser(is_gltf, max_side, image)
    pieces = []
    materials = []
    names = []
    for node in sorted(
        scene.graph.nodes_geometry, key=lambda each: (_RANDOM.sub("", each), scene.graph[each][1])
    ):
        transform, name = scene.graph[node]
        geometry = scene.geometry[name]
        if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces):
            mesh = _sound(geometry, path).transform(
                unit * transform[:3, :3], unit * transform[:3, 3]
            )
            if np.linalg.det(transform[:3, :3]) < 0:
                mesh = Mesh(mesh.vertices, mesh.faces[:, ::-1])
            pieces.append(dresser.piece(mesh, geometry.visual))
            names.append(_names_of(scene, node))
            materials.append(getattr(geometry.visual, "material", None))
    lost = gltf_notes(path, materials) if is_gltf else collada_notes(path) if is_collada else ()
    notes = tuple(dict.fromkeys([*of_parsing, *beside.notes, *lost, *dresser.notes]))
    if not pieces:
        raise AssetError(
            f"{path} holds no triangles", "a surface mesh, not points or curves", "; ".join(notes)
        )
    return NamedMeshFile(pieces, notes, tuple(names))


def _names_of(scene: trimesh.Scene, node: str) -> tuple[str, ...]:
    """What a node and those above it are called, without the root, and what its surface is called."""
    above = scene.graph.transforms.parents
    names = [_RANDOM.sub("", node)]
    surface = str(scene.graph[node][1])
    while (node := above.get(node, scene.graph.base_frame)) != scene.graph.base_frame:
        names.append(_RANDOM.sub("", node))
    return tuple(dict.fromkeys([*names, surface]))


def _parse(path: Path, beside: Companions) -> tuple[trimesh.Scene, list[str]]:
    """What trimesh makes of a file whose concave polygons are cut and whose counts are right, and notes."""
    content = mesh_input(path)
    notes: list[str] = []
    mend = _MENDS.get(path.suffix.lower())
    if mend is not None and not isinstance(content.file_obj, str):
        data, of_content = mend(content.file_obj.getvalue())
        content = content._replace(file_obj=io.BytesIO(data))
        notes += of_content
    with collada_polygons(path) as of_polygons:
        scene = trimesh.load_scene(**content._asdict(), resolver=beside, process=False)
    if path.suffix.lower() == ".ply":
        _check_ply_faces(path, scene)
    return scene, [*notes, *of_polygons]


def _check_ply_faces(path: Path, scene: trimesh.Scene) -> None:
    """trimesh reads all faces of a binary PLY file with as many corners as the first has."""
    for geometry in scene.geometry.values():
        faces = geometry.metadata.get("_ply_raw", {}).get("face", {}).get("data")
        if not isinstance(faces, np.ndarray) or faces.dtype.names is None:
            continue
        for name in faces.dtype.names:
            is_list = faces.dtype[name].names == ("f0", "f1")
            if is_list and len(np.unique(faces[name]["f0"])) > 1:
                raise ply_of_polygons(path)


def _sound(geometry: trimesh.Trimesh, path: Path) -> Mesh:
    """The triangles, if they are some and name vertices that are there."""
    vertices = np.asarray(geometry.vertices)
    faces = np.asarray(geometry.faces)
    if faces.ndim != 2 or faces.shape[1] != 3 or vertices.ndim != 2 or vertices.shape[1] != 3:
        raise AssetError(
            f"{path} holds a surface that is not made of triangles", "triangles in space"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise AssetError(f"{path} is damaged: its triangles name vertices that it does not have")
    return Mesh(vertices, faces)
