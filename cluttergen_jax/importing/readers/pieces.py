"""Which files belong to an object: those that model files name, and pieces by names of files and folders."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from xml.etree import ElementTree

from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.damage import stand_in
from cluttergen_jax.importing.readers.mjcf import world_bodies
from cluttergen_jax.importing.readers.mjcf_compile import (
    asset_folders,
    check_mjcf_extent,
    compile_with_notes,
    named_files,
    places_of,
)
from cluttergen_jax.importing.readers.opening import (
    MOST_XML,
    as_utf8,
    check_openable,
    folder_place,
    mesh_place,
    read_file,
)
from cluttergen_jax.importing.readers.sdf import (
    CONFIG,
    config_of,
    is_from_elsewhere,
    models,
    read_sdf_tree,
)
from cluttergen_jax.importing.readers.sdf import ROOTS as SDF_ROOTS
from cluttergen_jax.importing.readers.source import GENERIC
from cluttergen_jax.importing.readers.xml_tree import BROKEN, Element, parse_xml, plain_tag

_MADE_BY_MUJOCO = ("frame", "replicate", "attach")
"""Elements whose bodies hang on what the element hangs on."""
_MODELS = (".sdf", ".urdf", ".xml")
_SHOWS_NOTHING = ("light", "camera", "site")
_NAMED = re.compile(r"\bfile(?:name)?\s*=\s*[\"']([^\"'<>]+)")


@dataclass(frozen=True)
class ModelFile:
    """A URDF, SDF or MJCF file; files by their real paths.

    Attributes:
      kind: "urdf", "sdf" or "mjcf".
      files: meshes and textures that it names and that are there.
      includes: MJCF files that are part of it.
      bodies: names of bodies of the world ("" for none) or of an SDF's models.
      is_whole: all that it names is there.
      fault: why it is no object: a part for others to include, or broken.
      shared: files that it includes and that are objects of their own too.
    """

    path: Path
    kind: str
    files: frozenset[Path] = frozenset()
    includes: frozenset[Path] = frozenset()
    bodies: tuple[str, ...] = ()
    is_whole: bool = True
    fault: str = ""
    shared: frozenset[Path] = frozenset()


def model_file(path: Path, is_given: bool = False) -> ModelFile | str:
    """The model in a .urdf, .sdf or .xml file, or why it is none. One that is broken has a fault.

    Args:
      is_given: the user gave this file: of an SDF's world also those models count that have files of their
        own, which in a folder are found there.
    """
    try:
        check_openable(path, MOST_XML)
    except AssetError as error:
        return str(error)
    tag = _root_tag(path)
    if tag in ("mujoco", "mujocoinclude"):
        return _mjcf(path)
    if tag == "robot" or path.suffix.lower() == ".urdf":
        return _urdf(path)
    if tag in SDF_ROOTS:
        return _sdf(path, is_given)
    if found := stand_in(path):
        return found[0]
    if not tag:
        return _broken(path, "", "not well-formed XML")
    return f"neither URDF, SDF nor MJCF: its root is <{tag}>"


def _root_tag(path: Path) -> str:
    if (root := parse_xml(path)) is not None:
        return plain_tag(root)
    try:
        return plain_tag(next(iter(ElementTree.iterparse(path, events=("start",))))[1])
    except (*BROKEN, StopIteration):
        return ""


def _urdf(path: Path) -> ModelFile:
    root = parse_xml(path)
    if root is None:
        return _broken(path, "urdf")
    named = [
        each.get("filename", "") for each in root.iter() if plain_tag(each) in ("mesh", "texture")
    ]
    files = {
        name: file for name in dict.fromkeys(named) if (file := mesh_place(path, name)) is not None
    }
    real = frozenset(file.resolve() for file in files.values())
    return ModelFile(path, "urdf", real, is_whole=len(files) == len(set(named)))


def _sdf(path: Path, is_given: bool) -> ModelFile | str:
    _, chosen = config_of(path)
    if chosen not in ("", path.name) and (path.parent / chosen).is_file():
        return f"another version of {chosen}, which {CONFIG} names"
    try:
        tree = read_sdf_tree(path)
    except AssetError:
        return ModelFile(path, "sdf", is_whole=False)
    root = tree.root
    bodies = tuple(name for name, each in models(root) if is_given or not is_from_elsewhere(each))
    if not bodies and tree.files:
        return f"it includes models of other files, and has none of its own; `import {path.name}` takes them"
    places = ("mesh/uri", "metal/albedo_map", "specular/albedo_map")
    named = {(each.text or "").strip() for tag in places for each in root.iterfind(f".//{tag}")}
    there = [file for name in named if (file := mesh_place(path, name)) is not None]
    scripts = [
        each for uri in root.iter("uri") if (each := folder_place(path, (uri.text or "").strip()))
    ]
    # In a model's folder all is the model's: scripts, images, and meshes that it does not use.
    own = path.parent.rglob("*") if chosen else ()
    belonging = [*own, *(file for folder in scripts for file in folder.glob("*"))]
    files = [
        file.resolve()
        for file in (*there, *belonging)
        if file.suffix.lower() not in _MODELS and file.is_file()
    ]
    shared = frozenset(each for each in tree.files if (each.parent / CONFIG).is_file())
    parts = tree.files - shared
    return ModelFile(
        path,
        "sdf",
        frozenset(files),
        frozenset(parts),
        bodies,
        shared=shared,
        is_whole=len(there) == len(named),
    )


def _mjcf(path: Path) -> ModelFile:
    try:
        check_mjcf_extent(path)
    except AssetError:
        # The reader says what is wrong with it.
        return _broken(path, "mjcf")
    includes = {path.resolve()}
    root = _expand_includes(path, path.parent, includes)
    includes.discard(path.resolve())
    if root is None:
        return _broken(path, "mjcf")
    folders = [path.parent, *asset_folders(root, path.parent)]
    files: set[Path] = set()
    is_whole = True
    for element in root.iter():
        names = list(named_files(element))
        places = (file for name in names for file in places_of(name, folders))
        there = {file.resolve() for file in places if file.is_file()}
        is_whole &= bool(there) or not names
        if element.tag == "model":
            # An attached model is part of this one, with all that it names itself.
            for part in there - includes - {path.resolve()}:
                inner = _mjcf(part)
                includes |= {part, *inner.includes}
                files |= inner.files
        else:
            files |= there
    fault = "" if _shows_something(root) else "a part of MJCF models, made to be included"
    bodies = () if fault else _bodies(path, root)
    return ModelFile(path, "mjcf", frozenset(files), frozenset(includes), bodies, is_whole, fault)


def _shows_something(root: Element) -> bool:
    """Whether a tree is a model, not a part of others: there is more than lights and cameras in its world."""
    inside = [child.tag for world in root.iter("worldbody") for child in world]
    is_missing_part = root.find(".//include") is not None
    return root.tag == "mujoco" and (
        is_missing_part or any(tag not in _SHOWS_NOTHING for tag in inside)
    )


def _broken(path: Path, kind: str, fault: str = "") -> ModelFile:
    """What cannot be read, or is no well-formed XML, with the files that its text names."""
    text = ""
    with suppress(OSError):
        text = as_utf8(read_file(path, MOST_XML)).decode(errors="replace")
    places = (mesh_place(path, name) for name in dict.fromkeys(_NAMED.findall(text)))
    files = frozenset(each.resolve() for each in places if each is not None)
    return ModelFile(path, kind, files, is_whole=False, fault=fault)


def _bodies(path: Path, root: Element) -> tuple[str, ...]:
    """What the bodies of an MJCF file's world are called; MuJoCo says, where they are not all written out."""
    inside = [child for world in root.iter("worldbody") for child in world]
    if any(child.tag in _MADE_BY_MUJOCO for child in inside):
        # The reader reports a file that cannot be compiled.
        with suppress(AssetError):
            model = compile_with_notes(path)[0]
            return tuple(model.body(each).name for each in world_bodies(model))
    return tuple(child.get("name", "") for child in inside if child.tag == "body")


def _expand_includes(path: Path, main: Path, includes: set[Path]) -> Element | None:
    """An MJCF tree with the content of included files, where they are there, in place of their <include>.

    None if it is broken.

    Args:
      main: the main file's folder, which names are relative to.
      includes: the files that were included already; those found here are added.
    """
    root = parse_xml(path)
    if root is None:
        return None
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag != "include":
                continue
            name = child.get("file", "").replace("\\", "/")
            there = [file for file in (main / name, path.parent / name) if file.is_file()]
            if not there:
                continue
            place = list(parent).index(child)
            parent.remove(child)
            if (
                file := next((each for each in there if each.resolve() not in includes), None)
            ) is not None:
                includes.add(file.resolve())
                inner = _expand_includes(file, main, includes)
                parent[place:place] = list(inner) if inner is not None else []
    return root


# In order of preference where a folder offers one object in several formats.
MESH_SUFFIXES = (".glb", ".gltf", ".obj", ".dae", ".ply", ".stl")
MSH = ".msh"
"""MuJoCo's own format of meshes, read where an MJCF file names it."""

_COLLIDES = (
    "coacd",
    "vhacd",
    "cvx",
    "convex(?:hull)?",
    "decomp(?:os(?:ed|ition))?",
    "cv",
    "collisions?|collider",
    "coll?",
    "hulls?",
)
"""What collision shapes are called, the finest first."""
_IS_SEEN = r"visuals?|vis|textured"
_NUMBER = r"(?:parts?|pieces?)[-_. ]?\d+"
_WORDS = rf"(?:{'|'.join(_COLLIDES)}|{_IS_SEEN}|{_NUMBER})"
_PIECE = re.compile(
    rf"(?P<whole>.+?)(?P<tail>[-_. ](?:{_WORDS}|sites?)\d*"
    rf"(?:[-_. ](?:{_WORDS}|mesh|geom|parts?|pieces?)?\d*)*+)"
)
_NUMBERED = re.compile(r"(?P<whole>.+)[-_. ]\d+")
_PIECE_FOLDER = re.compile(
    rf"(?:{'|'.join(_COLLIDES)}|{_IS_SEEN}|sites?)(?:[-_ ]?(?:mesh|geom|part)(?:es|s)?)?"
)
_SEEN_FOLDER = re.compile(rf"(?:{_IS_SEEN})(?:[-_ ]?mesh(?:es)?)?")
_MESH_FOLDER = re.compile(r"(?:.*[-_ ])?(?:mesh(?:es)?|assets|geoms?|geometry)|textured_objs")
_SAYS_NOTHING = re.compile(GENERIC)
_ALONE_IN_ITS_FOLDER = ("model", "mobility")
"""Models that are called so have a folder of their own."""
_UNNAMED = re.compile(r"(original|new)-\d+|visual|collision")
"""What published sets, such as PartNet-Mobility, call the pieces of a model."""


@lru_cache(maxsize=1 << 16)
def whole_of(stem: str) -> str:
    """What a file is a piece of by its name: `mug` of `mug_coacd_3`; empty if the name does not say."""
    named = _PIECE.fullmatch(stem.lower())
    return named["whole"] if named else ""


def is_collision(stem: str) -> bool:
    """Whether a file is a collision shape by its name."""
    whole = whole_of(stem)
    return bool(whole) and _fineness(stem.lower().removeprefix(whole)) is not None


def _is_visible(stem: str) -> bool:
    named = _PIECE.fullmatch(stem.lower())
    return named is not None and re.search(rf"[-_. ](?:{_IS_SEEN})", named["tail"]) is not None


class Belonging:
    """The files of a tree, and which of them belong to others.

    Args:
      files: by folder.
      models: those among them that name files.
      owner: by the real path of a file, a model that names it.
    """

    def __init__(
        self,
        files: dict[Path, list[Path]],
        models: Iterable[ModelFile],
        owner: dict[Path, ModelFile],
    ) -> None:
        self._owners = {folder: _first_owner(here, owner) for folder, here in files.items()}
        self._models: dict[Path, dict[str, ModelFile]] = {folder: {} for folder in files}
        for model in models:
            if not model.fault:
                self._models[model.path.parent].setdefault(model.path.stem.lower(), model)
        self._meshes = {folder: _by_stem(here) for folder, here in files.items()}
        self._chosen = {folder: _representatives(meshes) for folder, meshes in self._meshes.items()}
        self._seen: dict[Path, list[Path]] = {}
        for folder in files:
            if _is(folder, _SEEN_FOLDER):
                self._seen.setdefault(folder.parent, []).append(folder)

    def title(self, mesh: Path) -> str:
        """What an object is called that only its pieces show: `mug` of `mug_vis`; else empty."""
        whole = whole_of(mesh.stem)
        pieces = [stem for stem in self._meshes[mesh.parent] if whole_of(stem) == whole]
        is_chosen = self._chosen[mesh.parent].get(whole) == mesh
        return whole if is_chosen and len(pieces) > 1 else ""

    def why_model(self, model: ModelFile) -> str:
        """Why a model is a piece of another; empty if it is not."""
        stem = model.path.stem.lower()
        here = self._models[model.path.parent]
        whole = here.get(whole_of(stem)) or self._host(model.path.parent)
        if whole is None or whole is model:
            return ""
        if _begins(stem, whole.path.stem.lower()):
            return _by_name(whole.path)
        own = _meshes_of(model)
        is_part = own and own < _meshes_of(whole) and len(whole.bodies) < 2
        return f"its meshes are some of those of {whole.path.name}" if is_part else ""

    def why_mesh(self, mesh: Path) -> str:
        """Why a mesh that no model names is a piece; empty if it is not."""
        if (whole := self._named_whole(mesh)) is not None:
            return _by_name(whole)
        if (whole := self._beside(mesh)) is not None:
            return f"by its folder a piece of {whole.name}"
        raw = (
            each
            for each in self._models[mesh.parent].values()
            if mesh.stem.lower() in _named_wholes(each)
        )
        if (named := next(raw, None)) is not None:
            return f"the raw mesh of a piece of {named.path.name}"
        if (host := self._host_of(mesh)) is not None:
            return f"by its folder a piece of {host.path.name}, which does not use it"
        owner = self._owners[mesh.parent]
        near = next(iter(self._models[mesh.parent].values()), owner)
        return _why_near(mesh, near, owner is not None) if near is not None else ""

    def _named_whole(self, mesh: Path) -> Path | None:
        """What a mesh is a piece of by its name."""
        stem = mesh.stem.lower()
        folder = mesh.parent
        whole = whole_of(stem)
        numbered = _NUMBERED.fullmatch(stem)
        for place in self._around(folder) if whole else ():
            home = place.resolve().parent if _is(place, _PIECE_FOLDER) else place.resolve()
            found = self._at(place, whole)
            if found is None and whole == home.name.lower():
                found = self._object_of_folder(place)
            if found not in (None, mesh):
                return found
        if numbered is None or whole:
            return None
        whole = numbered["whole"]
        if model := self._models[folder].get(whole):
            return model.path
        is_of_folder = whole == folder.resolve().name.lower()
        return self._meshes[folder].get(whole) if is_of_folder else None

    def _around(self, folder: Path) -> list[Path]:
        """A folder; of one called after pieces also that above it, and those there of what is seen."""
        if not _is(folder, _PIECE_FOLDER) or folder.parent not in self._meshes:
            return [folder]
        sisters = [each for each in self._seen.get(folder.parent, ()) if each != folder]
        return [folder, folder.parent, *(sisters if not _is(folder, _SEEN_FOLDER) else ())]

    def _at(self, folder: Path, stem: str) -> Path | None:
        if model := self._models[folder].get(stem):
            return model.path
        return self._meshes[folder].get(stem) or self._chosen[folder].get(stem)

    def _objects(self, folder: Path) -> list[Path]:
        """Models and meshes."""
        return [
            *(each.path for each in self._models[folder].values()),
            *self._meshes[folder].values(),
        ]

    def _object_of_folder(self, folder: Path) -> Path | None:
        """An object whose name says nothing, so that it is called after its folder."""
        return next(
            (each for each in self._objects(folder) if _SAYS_NOTHING.fullmatch(each.stem.lower())),
            None,
        )

    def _beside(self, mesh: Path) -> Path | None:
        """An object beside the folder of a mesh, if that is called after pieces."""
        found = next(filter(None, map(self._objects, self._around(mesh.parent)[1:])), [])
        same = (each for each in found if each.stem.lower() == mesh.stem.lower())
        return next(same, found[0] if found else None)

    def _host(self, folder: Path) -> ModelFile | None:
        """The model that a folder is called after, or made for."""
        here = self._models.get(folder, {})
        names = (folder.resolve().name.lower(), *_ALONE_IN_ITS_FOLDER)
        return next((here[name] for name in names if name in here), None)

    def _host_of(self, mesh: Path) -> ModelFile | None:
        """The model in whose folder a mesh lies: called after it, or with nothing but its pieces in it."""
        host = self._host(mesh.parent)
        if host is not None:
            stem = host.path.stem.lower()
            own = mesh.stem.lower()
            is_its = (
                stem in _ALONE_IN_ITS_FOLDER or _begins(own, stem) or _SAYS_NOTHING.fullmatch(own)
            )
            return host if is_its or is_collision(own) else None
        is_inside = _is(mesh.parent, _PIECE_FOLDER) or _is(mesh.parent, _MESH_FOLDER)
        return self._host(mesh.parent.parent) if is_inside else None


def _begins(stem: str, whole: str) -> bool:
    """Whether a name is another with something behind it."""
    return stem.startswith(whole) and stem[len(whole) : len(whole) + 1] in tuple("-_. ")


def _named_wholes(model: ModelFile) -> set[str]:
    """What the meshes that a model names below its folder are pieces of by their names."""
    home = model.path.resolve().parent
    return {whole_of(each.stem) for each in _meshes_of(model) if each.is_relative_to(home)} - {""}


def _meshes_of(model: ModelFile) -> frozenset[Path]:
    return frozenset(each for each in model.files if each.suffix.lower() in (*MESH_SUFFIXES, MSH))


def _by_name(whole: Path) -> str:
    return f"by its name a piece of {whole.name}"


def _is(folder: Path, kind: re.Pattern[str]) -> bool:
    return kind.fullmatch(folder.name.lower()) is not None


def _first_owner(files: Iterable[Path], owner: dict[Path, ModelFile]) -> ModelFile | None:
    """The model that names one of the meshes."""
    meshes = (each.resolve() for each in files if each.suffix.lower() in (*MESH_SUFFIXES, MSH))
    return next((owner[each] for each in meshes if each in owner), None)


def _by_stem(files: Iterable[Path]) -> dict[str, Path]:
    """Meshes by stem, of several formats the best."""
    meshes = [each for each in files if each.suffix.lower() in MESH_SUFFIXES]
    meshes.sort(
        key=lambda each: (MESH_SUFFIXES.index(each.suffix.lower()), each.name), reverse=True
    )
    return {each.stem.lower(): each for each in meshes}


def _representatives(meshes: dict[str, Path]) -> dict[str, Path]:
    """By what is there in pieces alone, the one that stands for it: it is seen, or at least not numbered."""
    chosen: dict[str, Path] = {}
    order = sorted(meshes, key=lambda stem: (not _is_visible(stem), stem))
    for stem in order:
        if (whole := whole_of(stem)) and whole not in meshes and not stem[-1].isdigit():
            chosen.setdefault(whole, meshes[stem])
    return chosen


def _why_near(mesh: Path, model: ModelFile, is_among_pieces: bool) -> str:
    """Why a mesh is a piece of a model beside it, or of one that names a mesh beside it."""
    is_named_after_folder = _SAYS_NOTHING.fullmatch(model.path.stem.lower()) is not None
    if is_named_after_folder and not model.is_whole and mesh.parent == model.path.parent:
        return f"perhaps one of the files that {model.path.name} names and that are missing"
    stem = mesh.stem.lower()
    if is_collision(stem) and mesh.parent == model.path.parent:
        return f"by its name a collision shape, beside {model.path.name}"
    if _UNNAMED.fullmatch(stem) or (is_named_after_folder and _SAYS_NOTHING.fullmatch(stem)):
        return f"by its name a piece of {model.path.name}, which does not use it"
    is_store = any(_is(each, _MESH_FOLDER) for each in (mesh.parent, mesh.parent.parent))
    if is_among_pieces and is_store and model.path.parent != mesh.parent:
        return f"beside pieces of {model.path.name}, and no model names it"
    return ""


def collision_files(mesh: Path) -> tuple[Path, ...]:
    """The collision shapes that lie beside a mesh file, of several kinds the finest; () if there are none."""
    stem = mesh.stem.lower()
    says_nothing = _SAYS_NOTHING.fullmatch(stem) is not None
    own = {stem, whole_of(stem), mesh.resolve().parent.name.lower() if says_nothing else ""} - {""}
    found: dict[int, list[Path]] = {}
    for file, folder in _files_around(mesh):
        name = file.stem.lower()
        numbered = _NUMBERED.fullmatch(name)
        wholes = {
            whole_of(name),
            *((name, numbered["whole"] if numbered else "") if folder else ()),
        }
        is_alone = says_nothing and (folder or name.startswith("collision"))
        rank = _fineness(folder or name.removeprefix(stem))
        if rank is not None and (is_alone or wholes & own):
            found.setdefault(rank, []).append(file)
    return tuple(sorted(found[min(found)])) if found else ()


def _files_around(mesh: Path) -> Iterator[tuple[Path, str]]:
    """Meshes beside a mesh, and those in folders for collision shapes, with the folder's name."""
    home = mesh.parent.parent if _is(mesh.parent, _SEEN_FOLDER) else mesh.parent
    yield from ((file, "") for file in _by_stem(mesh.parent.iterdir()).values() if file != mesh)
    for folder in home.iterdir():
        if folder.is_dir() and _fineness(folder.name.lower()) is not None:
            yield from ((file, folder.name.lower()) for file in _by_stem(folder.iterdir()).values())


def _fineness(name: str) -> int | None:
    """The place among `_COLLIDES` of the word that a name has; None if it has none of them."""
    kinds = (
        i
        for i, word in enumerate(_COLLIDES)
        if re.search(rf"(?:^|[-_. ])(?:{word})(?![a-z])", name)
    )
    return next(kinds, None)
