"""Mesh files: OBJ, STL, PLY, GLB, GLTF and DAE, through trimesh, which gets their text in UTF-8.

Old exporters write comments and material names in Latin-1. trimesh guesses the encoding with a library that
may be missing, from the first thousand bytes, and drops what it cannot decode, so that a material of the OBJ
file may no longer be found in the MTL file. pycollada loses images without a path, and polygons with holes.

Both cut every polygon into a fan from its first corner. Of one with a concave outline such triangles lie over
each other, with the outline's edges and its area by sign still right: closed, and no solid. So these polygons
are cut before, by Manifold's ear clipping; all others stay as they are.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch
from xml.etree import ElementTree

import manifold3d
import numpy as np
import trimesh
from PIL import Image

from cluttergen_jax.assets.config import MAX_TEXTURE
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece, Texture
from cluttergen_jax.errors import AssetError
from cluttergen_jax.files import MOST_WORDS
from cluttergen_jax.geometry import plane_axes, triangle_areas
from cluttergen_jax.importing.readers.damage import (
    check_whole,
    is_text_stl,
    ply_of_polygons,
    sound_stl,
    unreadable,
)
from cluttergen_jax.importing.readers.finishes import with_exponents
from cluttergen_jax.importing.readers.gltf import plain_gltf, read_document
from cluttergen_jax.importing.readers.materials import (
    LEFT_OUT,
    Dresser,
    coloured_by_vertices,
    gltf_notes,
    vary,
)
from cluttergen_jax.importing.readers.opening import (
    OPTIONS,
    as_utf8,
    check_openable,
    find_named,
    read_file,
)
from cluttergen_jax.importing.readers.xml_tree import (
    BROKEN,
    Element,
    parse_numbers,
    parse_xml,
    plain_tag,
)

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
    if suffix in (".glb", ".gltf"):
        data, kind = plain_gltf(path)
        return MeshInput(io.BytesIO(data), kind)
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
    elif is_text_stl(data):
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
    ".mtl": rb"^[ \t]*+(?i:map_kd|map_pr|map_pm|map_bump|bump|norm)[ \t]++([^\n]++)$",
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
        self._images: dict[Path, Image.Image] = {}
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

    def image(self, name: str) -> Image.Image:
        """The image that a material names behind its options (AssetError: why it cannot be opened)."""
        found = find_named(self._path.parent, name)
        if found is None:
            raise AssetError(f"{name!r} is not there")
        if found not in self._images:
            try:
                self._images[found] = Image.open(io.BytesIO(read_file(found)))
            except AssetError:
                raise
            except Exception as error:  # Pillow's decoders raise whatever they do.
                raise AssetError(f"{found.name} cannot be read as an image") from error
        if OPTIONS.match(name):
            self.notes.append(f"the options of an image are ignored ({name})")
        return self._images[found]

    def _materials(self) -> bytes:
        """The content of all material files of an OBJ file."""
        texts = []
        for name, found in _material_files(self._path):
            if found is None:
                self._miss(name)
            else:
                texts.append(with_exponents(as_utf8(read_file(found, MOST_WORDS))))
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
    records = read_document(path).get("materials", []) if is_gltf else []
    dresser = Dresser(is_gltf, max_side, image, records, beside.image)
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


def unit_of(path: Path) -> float:
    """Metres in the file's unit of length: what its <unit> says, 1 if it says nothing.

    Raises:
      AssetError: the unit is no length.
    """
    text = _declared_unit(path)
    unit, *more = parse_numbers(text) or [math.nan]
    if more or not (math.isfinite(unit) and unit > 0):
        raise AssetError(f'{path}: <unit meter="{text}">', "metres in one unit: a number above 0")
    return unit


def _declared_unit(path: Path) -> str:
    try:
        for _, element in ElementTree.iterparse(path):
            if plain_tag(element) == "asset":
                return next(
                    (each.get("meter", "1") for each in element if plain_tag(each) == "unit"), "1"
                )
    except BROKEN:
        pass
    return "1"


def plain_collada(path: Path) -> bytes | None:
    """The file with a name in place of each image's missing path, and polygons with holes as triangles.

    pycollada drops an image without a path, and with it the effect, the material and the surfaces; and it
    drops polygons with holes (<ph>). Surfaces whose vertices have colours, and on which no image can lie, are
    without their materials: trimesh takes these, which say less. None if there are none of the three.
    """
    if (tree := parse_xml(path)) is None:
        return None
    is_changed = _name_images(tree)
    for surface in _coloured_by_vertices(tree):
        if not _can_have_image(tree, surface):
            is_changed |= surface.attrib.pop("material", None) is not None
    for polygons in list(_all(tree, "polygons")):
        try:
            is_changed |= _cut_holes(tree, polygons)
        except (LookupError, ValueError, TypeError):
            # They stay, are dropped, and `collada_notes` says so.
            continue
    return ElementTree.tostring(tree) if is_changed else None


def _coloured_by_vertices(tree: Element) -> Iterator[Element]:
    """The surfaces at whose vertices colours differ."""
    sources = {each.get("id"): each for each in _all(tree, "source")}
    for tag in ("triangles", "polylist", "polygons", "tristrips", "trifans"):
        for surface in _all(tree, tag):
            named = [
                each.get("source", "")[1:] for each in surface if each.get("semantic") == "COLOR"
            ]
            found = sources.get(named[0]) if named else None
            if found is not None and vary(_colours(found)):
                yield surface


def _colours(source: Element) -> np.ndarray:
    """f64[N, 3]; none if the source is not of colours."""
    values = (
        next((parse_numbers(each.text or "") for each in _all(source, "float_array")), None) or []
    )
    stride = next((each.get("stride", "1") for each in _all(source, "accessor")), "3")
    step = int(stride) if stride.isdecimal() else 0
    if step < 3 or len(values) % step:
        return np.zeros((0, 3))
    return np.array(values).reshape(-1, step)[:, :3]


def _can_have_image(tree: Element, surface: Element) -> bool:
    has_places = any(each.get("semantic") == "TEXCOORD" for each in surface)
    return has_places and next(_all(tree, "texture"), None) is not None


def _name_images(tree: Element) -> bool:
    is_changed = False
    for image in _all(tree, "image"):
        places = [each for each in image if plain_tag(each) == "init_from"]
        if any((each.text or "").strip() for each in places):
            continue
        is_changed = True
        place = places[0] if places else ElementTree.SubElement(image, image.tag[:-5] + "init_from")
        # COLLADA 1.5 has the path one level deeper.
        place.text = next(
            (each.text for each in place if each.text), f"{image.get('id')} (no path is given)"
        )
    return is_changed


def _cut_holes(tree: Element, polygons: Element) -> bool:
    """Puts triangles in place of the <ph> of one <polygons>; whether there were some that can be cut."""
    inputs = [each for each in polygons if plain_tag(each) == "input"]
    width = 1 + max(int(each.get("offset", 0)) for each in inputs)
    (vertex,) = (each for each in inputs if each.get("semantic") == "VERTEX")
    points = _positions(tree, vertex.get("source", "")[1:])
    is_changed = False
    for polygon in [each for each in polygons if plain_tag(each) == "ph"]:
        rings = [
            np.array((each.text or "").split(), np.int64).reshape(-1, width) for each in polygon
        ]
        outlines = [points[ring[:, int(vertex.get("offset", 0))]] for ring in rings]
        if (triangles := cut_with_holes(outlines)) is None:
            continue
        corners = np.concatenate(rings)
        tag = polygon.tag[:-2] + "p"
        for triangle in triangles:
            words = corners[triangle].reshape(-1).tolist()
            ElementTree.SubElement(polygons, tag).text = " ".join(map(str, words))
        polygons.remove(polygon)
        is_changed = True
    if is_changed:
        polygons.set("count", str(sum(plain_tag(each) in ("p", "ph") for each in polygons)))
    return is_changed


def _positions(tree: Element, vertices: str) -> np.ndarray:
    """f64[V, 3]: where the vertices of an id are."""
    by_id = {each.get("id"): each for each in tree.iter() if each.get("id")}
    (place,) = (each for each in by_id[vertices] if each.get("semantic") == "POSITION")
    source = by_id[place.get("source", "")[1:]]
    (array,) = (each for each in source if plain_tag(each) == "float_array")
    (accessor,) = _all(source, "accessor")
    numbers = np.array((array.text or "").split(), np.float64)
    return numbers[int(accessor.get("offset", 0)) :].reshape(-1, int(accessor.get("stride", 1)))[
        :, :3
    ]


def collada_notes(path: Path) -> Iterator[str]:
    """What is not read of a COLLADA file."""
    data = plain_collada(path)
    tree = parse_xml(path) if data is None else ElementTree.fromstring(data)
    if holes := sum(1 for _ in _all(tree, "ph")):
        yield f"{holes} polygons with holes (<ph>) cannot be cut into triangles and are left out"
    if skins := sum(1 for _ in _all(tree, "instance_controller")):
        yield f"{skins} surfaces with a skeleton or a morph (<instance_controller>) are left out"
    if tree is not None and any(
        _can_have_image(tree, each) for each in _coloured_by_vertices(tree)
    ):
        yield LEFT_OUT


def _all(tree: Element | None, tag: str) -> Iterator[Element]:
    return (each for each in (() if tree is None else tree.iter()) if plain_tag(each) == tag)


@contextmanager
def collada_polygons(path: Path) -> Iterator[list[str]]:
    """While it is open, pycollada cuts polygons into triangles that do not overlap, instead of into fans.

    Yields:
      What there is to say of the polygons, once they are read.
    """
    notes: list[str] = []
    if path.suffix.lower() != ".dae":
        yield notes
        return
    # Loaded for COLLADA alone.
    from collada.polylist import Polylist
    from collada.triangleset import TriangleSet

    cut_into_fans = Polylist.triangleset

    def triangleset(polylist: Any) -> Any:
        if polylist._triangleset is None and (corners := _corners(polylist, notes)) is not None:
            index = polylist.index[corners.reshape(-1)].reshape(-1)
            polylist._triangleset = TriangleSet(
                polylist.sources, polylist.material, index, polylist.xmlnode
            )
        return cut_into_fans(polylist)

    with patch.object(Polylist, "triangleset", triangleset):
        yield notes


def _corners(polylist: Any, notes: list[str]) -> np.ndarray | None:
    """i64[F, 3]: rows of the list's index that make its triangles; None where fans will do."""
    named = polylist.vertex_index
    points = polylist.vertex
    if named is None or points is None or not len(named) or min(polylist.vcounts) < 3:
        return None
    if named.min() < 0 or named.max() >= len(points):
        return None
    starts = polylist.polyindex[:, 0]
    polygons = [named[start:end] for start, end in polylist.polyindex]
    found, is_crossing = cuts(np.asarray(points, np.float64), polygons)
    if is_crossing and CROSSING not in notes:
        notes.append(CROSSING)
    if not found:
        return None
    fans = {
        n: np.array([[0, i + 1, i + 2] for i in range(n - 2)])
        for n in set(polylist.vcounts.tolist())
    }
    return np.concatenate(
        [start + found.get(i, fans[len(polygons[i])]) for i, start in enumerate(starts.tolist())]
    )


_SLACK = 1e-9
"""Of a polygon's area: so much of a triangle may face the other way, by rounding."""
_BENT = 0.01
"""Of a polygon's size: so far its holes may lie beside its plane."""
_OBJ_VERTEX = re.compile(rb"^[ \t]*v[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)", re.MULTILINE)
_OBJ_POLYGON = re.compile(rb"^[ \t]*f((?:[ \t]+[-+\d/]+){4,})[ \t\r]*(?:#.*)?$", re.MULTILINE)
_OBJ_BACKWARD = re.compile(rb"^[ \t]*f[^\n]*[ \t/]-", re.MULTILINE)
_OBJ_LINE = re.compile(rb"^[ \t]*(vt|vn|v|f)[ \t]+([^\n#]*)", re.MULTILINE)
CROSSING = "a polygon whose outline crosses itself is cut into a fan from its first corner"


def cuts(points: np.ndarray, polygons: Sequence[np.ndarray]) -> tuple[dict[int, np.ndarray], bool]:
    """The triangles of those polygons that a fan would fold.

    Args:
      points: f64[V, 3].
      polygons: i64[N] each, the corners of one, N >= 3, as indices of points.

    Returns:
      By index of the polygon, i64[N - 2, 3], its triangles as places in its outline, turned as it is; and
      whether some polygon cannot be cut so, because its outline crosses itself.
    """
    found: dict[int, np.ndarray] = {}
    is_crossing = False
    lengths = np.array([len(each) for each in polygons], np.int64)
    for length in np.unique(lengths[lengths > 3]):
        which = np.flatnonzero(lengths == length)
        corners = points[np.stack([polygons[index] for index in which.tolist()])]
        for index in np.flatnonzero(_is_folded_fan(corners)):
            triangles = cut_with_holes([corners[index]])
            if triangles is None:
                is_crossing = True
            else:
                found[int(which[index])] = triangles
    return found, is_crossing


def _is_folded_fan(corners: np.ndarray) -> np.ndarray:
    """bool[M]: of f64[M, N, 3], whether a triangle of the fan faces against the polygon's own normal."""
    arms = corners[:, 1:] - corners[:, :1]
    # Each is a triangle's normal, twice as long as its area; together they are the polygon's, by Newell.
    normals = np.cross(arms[:, :-1], arms[:, 1:])
    normal = normals.sum(1)
    along = np.einsum("mni,mi->mn", normals, normal)
    return (along < -_SLACK * (normal**2).sum(1)[:, None]).any(1)


def cut_with_holes(rings: Sequence[np.ndarray]) -> np.ndarray | None:
    """The triangles of one polygon with holes seen along its normal; None if they would overlap, or if its
    holes lie elsewhere.

    Args:
      rings: f64[N, 3] each, the outline and its holes, which may turn either way.

    Returns:
      i64[M, 3], places in all rings one after another, turned as the outline is.
    """
    arms = rings[0][1:] - rings[0][0]
    plane = plane_axes(np.cross(arms[:-1], arms[1:]).sum(0))
    flat = [(ring - rings[0][0]) @ plane for ring in rings]
    across = np.concatenate(rings) @ np.cross(*plane.T)
    if len(rings) > 1 and np.ptp(across) > _BENT * np.ptp(flat[0]):
        return None
    order = []
    start = 0
    for number, ring in enumerate(flat):
        places = np.arange(start, start + len(ring))
        # Manifold wants holes that turn against their outline.
        order.append(places[::-1] if number and _area(ring) > 0 else places)
        start += len(ring)
    whole = np.concatenate(flat)
    places = np.concatenate(order)
    try:
        triangles = places[
            np.asarray(manifold3d.triangulate([whole[each] for each in order]), np.int64)
        ]
    except (RuntimeError, ValueError):
        return None
    areas = triangle_areas(whole[triangles])
    area = sum(_area(whole[each]) for each in order)
    # Each hole is joined to the outline by two more triangles.
    is_sound = (
        len(triangles) == len(whole) + 2 * (len(rings) - 1) - 2 and (areas >= -_SLACK * area).all()
    )
    return triangles if is_sound and np.isclose(areas.sum(), area, rtol=1e-6) else None


def _area(outline: np.ndarray) -> float:
    """Twice the signed area of f64[N, 2]."""
    x, y = outline.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def cut_obj(data: bytes) -> tuple[bytes, tuple[str, ...]]:
    """The text of an OBJ file with its concave polygons cut, and what to say of others.

    Corners keep their own words, and with them texture coordinates and normals. Negative ones count back from
    their own line, but the parser counts them from the last: they are written as counted from the first. What
    the parser itself would refuse stays as it is.
    """
    data = data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    if _OBJ_BACKWARD.search(data):
        data = _forward(data)
    lines = list(_OBJ_POLYGON.finditer(data))
    if not lines:
        return data, ()
    words = [line[1].split() for line in lines]
    try:
        points = np.array(_OBJ_VERTEX.findall(data)).astype(np.float64)
        polygons = [_obj_corners(each, len(points)) for each in words]
    except (ValueError, IndexError):
        return data, ()
    found, is_crossing = cuts(points, polygons)
    parts = []
    end = 0
    for index, triangles in sorted(found.items()):
        text = [
            b"f " + b" ".join(words[index][place] for place in triangle) for triangle in triangles
        ]
        parts += [data[end : lines[index].start()], b"\n".join(text)]
        end = lines[index].end()
    return b"".join([*parts, data[end:]]), (CROSSING,) if is_crossing else ()


def _forward(data: bytes) -> bytes:
    """The text of an OBJ file with all corners counted from the first."""
    numbers = {b"v": 0, b"vt": 0, b"vn": 0}
    parts = []
    end = 0
    for line in _OBJ_LINE.finditer(data):
        if line[1] != b"f":
            numbers[line[1]] += 1
            continue
        words = (zip(word.split(b"/"), numbers.values(), strict=False) for word in line[2].split())
        corners = [
            b"/".join(_count_from_first(name, number) for name, number in word) for word in words
        ]
        parts += [data[end : line.start()], b"f " + b" ".join(corners)]
        end = line.end()
    return b"".join([*parts, data[end:]])


def _count_from_first(name: bytes, number: int) -> bytes:
    """A corner's index from the first on; `number` there are so far."""
    is_backward = name[:1] == b"-" and name[1:].isdigit() and 0 < int(name[1:]) <= number
    return b"%d" % (number + 1 + int(name)) if is_backward else name


def _obj_corners(words: Sequence[bytes], num_points: int) -> np.ndarray:
    """i64[N]: the vertices of a face, from zero on."""
    corners = np.array([int(word.partition(b"/")[0]) for word in words]) - 1
    if corners.min() < 0 or corners.max() >= num_points:
        raise IndexError("a vertex that is not there")
    return corners
