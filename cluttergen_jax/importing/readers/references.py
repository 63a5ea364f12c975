"""What URDF, SDF and MJCF files name: the files that belong to them, and the bodies that they hold."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass
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
        return ModelFile(
            path, "", _named_in_text(path), is_whole=False, fault="not well-formed XML"
        )
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
        return ModelFile(path, "urdf", _named_in_text(path), is_whole=False)
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
        return ModelFile(path, "mjcf", _named_in_text(path), is_whole=False)
    includes = {path.resolve()}
    root = _expand_includes(path, path.parent, includes)
    includes.discard(path.resolve())
    if root is None:
        return ModelFile(path, "mjcf", _named_in_text(path), is_whole=False)
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


def _named_in_text(path: Path) -> frozenset[Path]:
    """Real paths of what a file names that is no well-formed XML, as far as it is there."""
    try:
        text = as_utf8(read_file(path, MOST_XML)).decode(errors="replace")
    except OSError:
        return frozenset()
    places = (mesh_place(path, name) for name in dict.fromkeys(_NAMED.findall(text)))
    return frozenset(each.resolve() for each in places if each is not None)


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
