"""Finding objects: a file, an object's folder, or a tree of them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from xml.etree import ElementTree

from cluttergen_jax.assets.shape import Provenance
from cluttergen_jax.assets.texture import MAX_SIDE
from cluttergen_jax.config import check_positive
from cluttergen_jax.errors import AssetError

# In order of preference where a folder offers one object in several formats.
MESH_SUFFIXES = (".glb", ".gltf", ".obj", ".dae", ".ply", ".stl")
# File and folder names that say nothing about the object.
_GENERIC = re.compile(
    r"\d{1,2}|mobility|model|models|object|mesh|meshes|textured|nontextured|textured_objs|visual|collision"
    r"|scene|base|main|urdf|mjcf|google_\d+k|textured_simple(_reordered)?|assets|untitled"
)


@dataclass(frozen=True)
class ReadOptions:
    """How files are read.

    Attributes:
      scale: factor from the file's unit to metres.
      up: "z", "y", or "auto": y for GLTF (its standard), what a DAE file declares, z for all others.
      density: kg/m^3, for objects whose mass is not known.
      mass: kilograms for every object, instead of volume times density.
      max_texture: pixels a side that an image may have; larger ones are shrunk.
    """

    scale: float = 1.0
    up: str = "auto"
    density: float = 500.0
    mass: float | None = None
    max_texture: int = MAX_SIDE

    def __post_init__(self) -> None:
        check_positive(self, "scale", "density", "max_texture")
        if self.mass is not None:
            check_positive(self, "mass")


@dataclass(frozen=True)
class Source:
    """One object to be read.

    Attributes:
      path: the mesh, URDF or MJCF file.
      kind: "mesh", "urdf" or "mjcf".
      name: `[a-z0-9_-]+`, unique among the sources found together.
      label: what people call it.
      body: the body's name, where an MJCF file holds several objects.
      notes: known faults, passed on as flags.
    """

    path: Path
    kind: str
    name: str
    label: str
    body: str = ""
    provenance: Provenance | None = None
    notes: tuple[str, ...] = ()


def find_sources(path: str | Path) -> list[Source]:
    """Every object that `path` holds, in sorted order, with distinct names.

    A URDF or MJCF file speaks for its folder: meshes below it are its pieces, not objects.

    Raises:
      AssetError: nothing is there, or nothing that can be read.
    """
    path = Path(path)
    if not path.exists():
        raise AssetError(f"{path} does not exist", "a mesh, URDF or MJCF file, or a folder of them")
    found = list(_walk(path) if path.is_dir() else _from_file(path))
    if not found:
        raise AssetError(f"{path} holds no object", ", ".join([*MESH_SUFFIXES, ".urdf", ".xml (MJCF)"]))
    return named_apart(found)


def _walk(folder: Path) -> Iterator[Source]:
    children = sorted(each for each in folder.iterdir() if not each.name.startswith("."))
    files = [each for each in children if each.is_file()]
    models = [source for each in files if each.suffix in (".urdf", ".xml") for source in _from_file(each)]
    if models:
        yield from models
        return
    yield from (source for each in _chosen(files) for source in _from_file(each))
    for each in children:
        if each.is_dir():
            yield from _walk(each)


def _chosen(files: list[Path]) -> list[Path]:
    """Mesh files, one per object: one format of each stem, and one file where no stem says anything."""
    meshes = [each for each in files if each.suffix.lower() in MESH_SUFFIXES]
    meshes.sort(
        key=lambda each: (each.stem == "collision", MESH_SUFFIXES.index(each.suffix.lower()), each.name)
    )
    best: dict[str, Path] = {}
    for each in meshes:
        best.setdefault("" if _GENERIC.fullmatch(each.stem.lower()) else each.stem, each)
    return sorted(best.values())


def _from_file(path: Path) -> Iterator[Source]:
    suffix = path.suffix.lower()
    if suffix in MESH_SUFFIXES:
        yield _source(path, "mesh")
    elif suffix == ".urdf":
        yield _source(path, "urdf")
    elif suffix == ".xml":
        root = _root_tag(path)
        if root == "robot":
            yield _source(path, "urdf")
        elif root == "mujoco":
            yield from _bodies(path)


def _root_tag(path: Path) -> str:
    try:
        return next(iter(ElementTree.iterparse(path, events=("start",))))[1].tag
    except (ElementTree.ParseError, StopIteration):
        return ""


def _bodies(path: Path) -> Iterator[Source]:
    """One source for each body that hangs on the world body; the file itself if it does not say."""
    try:
        tree = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise AssetError(f"{path} is not well-formed XML: {error}") from error
    names = [body.get("name", "") for world in tree.iter("worldbody") for body in world.findall("body")]
    if len(names) < 2:
        yield _source(path, "mjcf")
        return
    for index, name in enumerate(names):
        body = name or f"#{index}"
        yield replace(_source(path, "mjcf", name or f"{path.stem}-{index}"), body=body)


def _source(path: Path, kind: str, title: str = "") -> Source:
    title = title or telling_name(path)
    label = re.sub(r"^\d+[-_ ]+", "", title).replace("_", " ").strip() or title
    return Source(path, kind, plain_name(title), label)


def telling_name(path: Path) -> str:
    """The innermost part of a path that says what the object is."""
    parts = [path.stem, *(each.name for each in path.resolve().parents)]
    return next((part for part in parts if part and not _GENERIC.fullmatch(part.lower())), path.stem)


def plain_name(text: str) -> str:
    """`text` in the letters allowed for names."""
    return re.sub(r"[^a-z0-9_-]+", "_", text.lower()).strip("_") or "object"


def named_apart(sources: list[Source]) -> list[Source]:
    """Distinct names: where several objects share one, all but the first get the next free number."""
    taken: set[str] = set()
    out = []
    for source in sources:
        numbered = (f"{source.name}-{number}" for number in count(2))
        name = source.name if source.name not in taken else next(n for n in numbered if n not in taken)
        taken.add(name)
        out.append(replace(source, name=name))
    return out
