"""Mesh files: OBJ, STL, PLY, GLB, GLTF and DAE, through trimesh, which gets their text in UTF-8.

Old exporters write comments and material names in Latin-1. trimesh guesses the encoding with a library that
may be missing, from the first thousand bytes, and drops what it cannot decode, so that a material of the OBJ
file may no longer be found in the MTL file.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
from PIL import Image

from cluttergen_jax.assets.config import MAX_TEXTURE
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece, Texture
from cluttergen_jax.errors import AssetError
from cluttergen_jax.files import MOST_WORDS
from cluttergen_jax.importing.readers.collada import (
    collada_notes,
    collada_polygons,
    plain_collada,
    unit_of,
)
from cluttergen_jax.importing.readers.damage import (
    check_whole,
    is_text_stl,
    ply_of_polygons,
    sound_stl,
    unreadable,
)
from cluttergen_jax.importing.readers.gltf import plain_glb
from cluttergen_jax.importing.readers.materials import Dresser, coloured_by_vertices, gltf_notes
from cluttergen_jax.importing.readers.opening import (
    OPTIONS,
    as_utf8,
    check_openable,
    find_named,
    read_file,
)
from cluttergen_jax.importing.readers.polygons import cut_obj

_END_OF_HEADER = b"end_header"
_OLD_COLOUR = re.compile(rb"(?<=[ \t])diffuse_(red|green|blue)\b")
"""What early PLY files call their colours."""
_WORD_AND_TAB = re.compile(rb"^[ \t]*([a-z]+)[ ]*\t[ \t]*", re.MULTILINE)
ALL_MATERIALS = "*.mtl"
"""What an OBJ file's text calls all its material files together: trimesh asks for one."""

_MTLLIB = re.compile(rb"mtllib[ \t]++([^\n]++)$", re.MULTILINE)
_REMARK = re.compile(rb"(?<=[ \t])#.*", re.DOTALL)


class MeshInput(NamedTuple):
    """A mesh file as `trimesh.load_scene` takes it: its content and suffix, or its path."""

    file_obj: io.BytesIO | str
    file_type: str | None = None


def mesh_input(path: Path) -> MeshInput:
    """A mesh file in a form that trimesh understands."""
    suffix = path.suffix.lower()
    if suffix in (".glb", ".gltf") and (plain := plain_glb(path)) is not None:
        return MeshInput(io.BytesIO(plain), "glb")
    if suffix == ".dae" and (named := plain_collada(path)) is not None:
        return MeshInput(io.BytesIO(named), "dae")
    if suffix not in (".obj", ".ply", ".stl"):
        return MeshInput(str(path))
    data = read_file(path)
    if suffix == ".ply":
        head, end, body = data.partition(_END_OF_HEADER)
        data = (_OLD_COLOUR.sub(rb"\1", as_utf8(head)) if end else head) + end + body
    elif suffix == ".obj":
        data = _plain_obj(as_utf8(data))
    elif is_text_stl(data, len(data)):
        data = as_utf8(data)
    return MeshInput(io.BytesIO(data), suffix[1:])


def material_lines(data: bytes) -> list[str]:
    """What the `mtllib` lines of an OBJ text name: each one file, or several with spaces between them."""
    lines = [
        found[1]
        for found in _MTLLIB.finditer(data)
        if not data[data.rfind(b"\n", 0, found.start()) + 1 : found.start()].strip(b" \t")
    ]
    named = (_REMARK.sub(b"", line, count=1).strip(b" \t\r") for line in lines)
    return [name.decode() for name in dict.fromkeys(named) if name]


def _plain_obj(data: bytes) -> bytes:
    """An OBJ text as trimesh follows it: spaces behind keywords, and one `mtllib` line, the first."""
    if b"\t" in data:
        data = _WORD_AND_TAB.sub(rb"\1 ", data)
    return f"mtllib {ALL_MATERIALS}\n".encode() + data if material_lines(data) else data


_NAMED = {
    ".mtl": rb"^[ \t]*+map_[Kk][Dd][ \t]++([^\n]++)$",
    ".gltf": rb'"uri"\s*:\s*"([^"]{1,1000})"',
    ".dae": rb"<init_from>([^<]++)</init_from>",
}
_USED, _DEFINED = (
    re.compile(rb"^[ \t]*+%s[ \t]++([^\n]++)$" % word, re.MULTILINE)
    for word in (b"usemtl", b"newmtl")
)
_ONE_NUMBER = re.compile(rb"^([ \t]*Kd)[ \t]+([-+.\deE]+)(?=[ \t\r]*$)", re.MULTILINE)


def companions(path: Path) -> Iterator[Path]:
    """The files that a mesh file names, and that its materials name, as far as they are there."""
    suffix = path.suffix.lower()
    if suffix == ".obj":
        for _, found in _material_files(path):
            if found is not None:
                yield found
                yield from companions(found) if found.suffix.lower() == ".mtl" else ()
    elif pattern := _NAMED.get(suffix):
        for name in re.findall(pattern, as_utf8(read_file(path)), re.MULTILINE):
            if (found := find_named(path.parent, name.strip().decode())) is not None:
                yield found


def _names(pattern: re.Pattern[bytes], text: bytes) -> list[bytes]:
    return [name.strip() for name in pattern.findall(text)]


def _material_files(obj: Path) -> Iterator[tuple[str, Path | None]]:
    """The material files of an OBJ file by name, None where one is not there.

    A line names one file, whose name may hold spaces; or if that is not there, several.
    """
    for line in material_lines(as_utf8(read_file(obj))):
        names = [line] if find_named(obj.parent, line) else line.split()
        yield from ((name, find_named(obj.parent, name)) for name in names)


class Companions(trimesh.resolvers.FilePathResolver):
    """Hands a mesh file's companions to trimesh, and remembers what could not be read.

    Attributes:
      notes: that in words.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(str(path))
        self._path = path
        self.notes: list[str] = []

    def get(self, name: str) -> bytes:
        """The content of the file that is called so."""
        if name == ALL_MATERIALS:
            return self._materials()
        found = find_named(self._path.parent, str(name))
        if found is None:
            self._miss(str(name))
            raise FileNotFoundError(name)
        if OPTIONS.match(str(name).strip()):
            self.notes.append(f"the options of an image are ignored ({str(name).strip()})")
        data = read_file(found)
        if found.suffix.lower() != ".bin":
            try:
                Image.open(io.BytesIO(data))
            except Exception as error:  # Pillow's decoders raise whatever they do.
                reason = re.sub(r" <_io.*?>", "", str(error)) or type(error).__name__
                self.notes.append(f"{found.name} cannot be read as an image ({reason})")
                raise
        return data

    def _materials(self) -> bytes:
        """The content of all material files of an OBJ file."""
        texts = []
        for name, found in _material_files(self._path):
            if found is None:
                self._miss(name)
            else:
                texts.append(as_utf8(read_file(found, MOST_WORDS)))
        text = b"\n".join(texts)
        if texts:
            used = dict.fromkeys(_names(_USED, as_utf8(self._path.read_bytes())))
            defined = set(_names(_DEFINED, text))
            lost = [name.decode() for name in used if name not in defined]
            self.notes += [
                f"{self._path.name} names material {name!r}, which is nowhere defined"
                for name in lost
            ]
        # Of a colour with one number the others are equal to it.
        return _ONE_NUMBER.sub(rb"\1 \2 \2 \2", text)

    def _miss(self, name: str) -> None:
        self.notes.append(f"{self._path.name} names {name!r}, which is not there")


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
    """What a mesh file holds.

    Attributes:
      pieces: its surfaces, in the file's own frame, and unless it declares a unit in its own.
      notes: what could not be kept of its materials, in words.
      names: of each surface, what it hangs on, the innermost first.
    """

    pieces: list[Piece]
    notes: tuple[str, ...]
    names: tuple[tuple[str, ...], ...] = ()


def read_mesh_file(
    path: Path, max_side: int = MAX_TEXTURE, image: Texture | None = None
) -> MeshFile:
    """The file's surfaces in its own frame, each with one colour, with its vertices' or with its image.

    Every geometry of a scene graph is placed where its nodes put it. The colour is the material's; colours
    of vertices or triangles that differ are kept for each vertex. A DAE file's declared unit is applied, its
    vertical axis is not (`source.own_up`): where a URDF names such a file, that is what PyBullet does. Other
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
    return MeshFile(pieces, notes, tuple(names))


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
