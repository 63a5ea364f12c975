"""SDF files with what they include (`<include>`), as Gazebo and Drake put it there."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.damage import refuse_stand_in
from cluttergen_jax.importing.readers.places import folder_place, mesh_place
from cluttergen_jax.importing.readers.xml_tree import BROKEN, Element, read_xml

SUFFIX = ".sdf"
CONFIG = "model.config"
ROOTS = ("sdf", "gazebo")
"""The latter up to version 1.2, and by habit in later files."""
_HOLDERS = ("sdf", "gazebo", "world", "model")
_NAMES_A_FILE = ("uri", "albedo_map")
_MARK = "{cluttergen_jax}included"
_MOST = 1000
"""Files that one file may include, all together."""
_FROM_THE_NET = ("http://", "https://", "fuel://")


@dataclass
class SdfTree:
    """A file in which models stand in place of the <include> of them.

    Attributes:
      root: its <sdf>.
      files: real paths of what it includes.
      count: how many times anything was included.
      missing: what a world includes that cannot be read, in words.
    """

    root: Element
    files: set[Path] = field(default_factory=set)
    count: int = 0
    missing: list[AssetError] = field(default_factory=list)


def read_sdf_tree(path: Path) -> SdfTree:
    """A file with what it includes.

    Of a folder that is included, model.config names the file; a name, a pose, a placement frame and <static>
    of the <include> go before the model's own.

    Raises:
      AssetError: a file is missing, is no SDF, or includes itself; the message names it.
    """
    tree = SdfTree(_parse(path))
    _expand(path, tree.root, (path.resolve(),), tree)
    if tree.missing and not (tree.root.findall("model") or tree.root.findall("world/model")):
        raise tree.missing[0]
    return tree


def is_from_elsewhere(model: Element) -> bool:
    """Whether a world includes the model: it is in the file of that."""
    return model.get(_MARK) is not None


def config_of(path: Path) -> tuple[str, str]:
    """What the `model.config` beside a file says: the model's name, and the SDF file of the latest version.

    Both are empty where there is none, or it does not say.
    """
    try:
        root = read_xml(path.parent / CONFIG)
    except (*BROKEN, AssetError):
        return "", ""
    versions = {each.get("version", ""): (each.text or "").strip() for each in root.findall("sdf")}
    latest = max(versions, key=_version, default="")
    return " ".join((root.findtext("name") or "").split()), versions.get(latest, "")


def _version(text: str) -> list[int]:
    # The length is limited: numbers of any number of digits take for ever.
    return [int(each) for each in text.split(".") if each.isdecimal() and len(each) < 10]


def _parse(path: Path) -> Element:
    try:
        root = read_xml(path)
    except BROKEN as error:
        refuse_stand_in(path)
        raise AssetError(f"{path} cannot be read as SDF: {error}") from error
    if root.tag not in ROOTS:
        raise AssetError(
            f"{path} is no SDF: its root is <{root.tag}>", "a file whose root is <sdf>"
        )
    return root


def _expand(path: Path, holder: Element, above: tuple[Path, ...], tree: SdfTree) -> None:
    """Puts models in place of every <include> below an element of a file.

    Args:
      above: real paths of the files that are being included, this one last.
    """
    for index, child in enumerate(list(holder)):
        if child.tag == "include":
            try:
                holder[index] = _read_included(path, child, above, tree)
            except AssetError as error:
                if holder.tag == "model" or len(above) > 1:
                    raise
                # The other models of a world are what they are without it.
                tree.missing.append(error)
                continue
            if holder.tag != "model":
                holder[index].set(_MARK, "true")
        elif child.tag in _HOLDERS:
            _expand(path, child, above, tree)


def _read_included(path: Path, include: Element, above: tuple[Path, ...], tree: SdfTree) -> Element:
    uri = (include.findtext("uri") or "").strip()
    file = _file_of(path, uri)
    real = file.resolve()
    if real in above:
        way = " -> ".join(each.name for each in (*above[above.index(real) :], real))
        raise AssetError(f"{path} includes itself: {way}", "includes that come to an end")
    tree.files.add(real)
    tree.count += 1
    if tree.count > _MOST:
        raise AssetError(f"{above[0]} includes more than {_MOST:,} files", f"up to {_MOST:,}")
    if include.get("merge", "").strip() in ("true", "1"):
        raise AssetError(
            f"{path}: an <include merge='true'> of {uri!r}",
            "one without `merge`",
            _written_out(path),
        )
    root = _parse(file)
    _expand(file, root, (*above, real), tree)
    model = next(iter((*root.findall("model"), *root.findall("world/model"))), None)
    if model is None:
        raise AssetError(f"{path} includes {uri!r}, which holds no model", "a <model> in that file")
    _name_files_from_root(file, model)
    return _with_overrides(model, include)


def _file_of(path: Path, uri: str) -> Path:
    """The SDF file that a uri names: itself, or of a folder the one of the latest version."""
    if uri.startswith(_FROM_THE_NET):
        raise AssetError(
            f"{path} includes {uri!r} from the internet", "files on this machine", "fetching it"
        )
    if (file := mesh_place(path, uri) if uri else None) is not None:
        return file
    folder = folder_place(path, uri) if uri else None
    if folder is None:
        raise AssetError(
            f"{path} includes {uri!r}, which is not there",
            hint="restoring the file, or the model's folder beside this one",
        )
    name = config_of(folder / CONFIG)[1]
    files = [folder / name] if name else sorted(folder.glob(f"*{SUFFIX}"))
    if len(files) != 1 or not files[0].is_file():
        raise AssetError(
            f"{path} includes {uri!r}: {folder} has {name or f'{len(files)} SDF files'}",
            f"a {CONFIG} that names its SDF file, which is there",
        )
    return files[0]


def _name_files_from_root(file: Path, model: Element) -> None:
    """What the model of another file names, by whole paths: it is named from that file on."""
    for element in model.iter():
        if element.tag in _NAMES_A_FILE and (name := (element.text or "").strip()):
            there = mesh_place(file, name) or folder_place(file, name)
            element.text = name if there is None else str(there.absolute())


def _with_overrides(model: Element, include: Element) -> Element:
    if name := (include.findtext("name") or "").strip():
        model.set("name", name)
    if (frame := (include.findtext("placement_frame") or "").strip()) and include.find(
        "pose"
    ) is not None:
        model.set("placement_frame", frame)
    for tag in ("pose", "static"):
        if (own := include.find(tag)) is not None:
            for old in model.findall(tag):
                model.remove(old)
            model.append(own)
    return model


def _written_out(path: Path) -> str:
    return f"gz sdf -p {path.name} > whole.sdf"
