"""SDF, Gazebo's format: what files include, links at their poses, nested models, materials, masses.

Includes are put where Gazebo and Drake put them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
import trimesh

from cluttergen_jax.assets.config import MAX_TEXTURE
from cluttergen_jax.errors import AssetError
from cluttergen_jax.files import MOST_WORDS
from cluttergen_jax.importing.readers.damage import refuse_stand_in
from cluttergen_jax.importing.readers.links import Link, SurfaceLook, Surfaces, check_unique, rigid
from cluttergen_jax.importing.readers.materials import GREY, Rgba
from cluttergen_jax.importing.readers.model import Model, frozen_note, unknown_body
from cluttergen_jax.importing.readers.opening import (
    as_utf8,
    find_named,
    folder_place,
    mesh_place,
    read_file,
)
from cluttergen_jax.importing.readers.source import ObjectFile
from cluttergen_jax.importing.readers.xml_tree import (
    BROKEN,
    Element,
    number,
    numbers,
    parse_numbers,
    read_xml,
    wrong_attribute,
)

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


# Possessive: no script makes them try the same text again and again.
_MATERIAL = re.compile(r"^[ \t]*+material[ \t]++([^\s{]++)([^{\n]*+)\s*+\{", re.MULTILINE)
_IMAGE = re.compile(r"^[ \t]*+texture[ \t]++(\"[^\"\n]++\"|\S++)", re.MULTILINE)
_COLOUR = re.compile(r"^[ \t]*+diffuse[ \t]++([-+.\deE \t\r]++)$", re.MULTILINE)
_COMMENT = re.compile(r"//[^\n]*+")
_INHERITS = re.compile(r"[ \t]*+:[ \t]*+(\S++)")


@dataclass(frozen=True)
class Paint:
    """What a material lays on a surface.

    Attributes:
      colour: None where it says nothing.
      image: what it calls its image, empty if it has none; file: where that is, None if it is not there.
      numbers: of its finish. maps: the files of its finish's maps, by the tags of SDF.
    """

    colour: Rgba | None = None
    image: str = ""
    file: Path | None = None
    numbers: Mapping[str, float] = field(default_factory=dict)
    maps: Mapping[str, str] = field(default_factory=dict)


# Gazebo's own, which lie in its program's folder.
_OWN: dict[str, tuple[float, float, float]] = {
    "White": (1, 1, 1), "Grey": (0.7, 0.7, 0.7), "DarkGrey": (0.175, 0.175, 0.175), "Black": (0, 0, 0),
    "Red": (1, 0, 0), "Green": (0, 1, 0), "Blue": (0, 0, 1), "Yellow": (1, 1, 0), "Orange": (1, 0.51, 0.15),
    "Purple": (1, 0, 1), "Turquoise": (0, 1, 1), "SkyBlue": (0.13, 0.44, 0.7), "Gold": (0.8, 0.65, 0.25),
}  # fmt: skip


def read_paints(scripts: Iterable[Path]) -> dict[str, Paint]:
    """The materials of scripts by name, Gazebo's plain colours among them; of one name the first holds.

    Of a material the first pass counts: its image, its diffuse colour, and what it inherits of these.
    """
    paints = {f"Gazebo/{name}": Paint((*rgb, 1.0)) for name, rgb in _OWN.items()}
    found: dict[str, Paint] = {}
    for script in scripts:
        text = _COMMENT.sub("", as_utf8(read_file(script, MOST_WORDS)).decode())
        starts = list(_MATERIAL.finditer(text))
        ends = [each.start() for each in starts[1:]] + [len(text)] * bool(starts)
        for start, end in zip(starts, ends, strict=True):
            inherits = _INHERITS.match(start[2])
            parent = found.get(inherits[1] if inherits else "", Paint())
            found.setdefault(
                start[1], _paint(_block(text[start.end() : end]), script.parent, parent)
            )
    return paints | found


def _block(text: str) -> str:
    """The text up to the bracket that closes what was opened before it."""
    depth = 1
    for place in re.finditer(r"[{}]", text):
        depth += 1 if place[0] == "{" else -1
        if not depth:
            return text[: place.start()]
    return text


def _paint(block: str, folder: Path, parent: Paint) -> Paint:
    colour = _COLOUR.search(block)
    image = _IMAGE.search(block)
    rgba = parent.colour if colour is None else _rgba(colour[1])
    if image is None:
        return Paint(rgba, parent.image, parent.file)
    name = image[1].strip('"')
    return Paint(rgba, name, find_named(folder, name))


def _rgba(text: str) -> Rgba | None:
    """Three or four numbers; None where they are others."""
    values = parse_numbers(text)
    if values is None or len(values) not in (3, 4):
        return None
    r, g, b, a = np.clip([*values, 1.0][:4], 0, 1).tolist()
    return (r, g, b, a)


_FORMS = ("mesh", "box", "cylinder", "sphere", "capsule", "ellipsoid")
_MOST_FRAMES = 100
"""Frames that hang on each other in a row."""
_SCRIPTS = ("materials/scripts", ".")
_MAPS = ("normal_map", "roughness_map", "metalness_map")


def read_sdf(source: ObjectFile, max_side: int = MAX_TEXTURE) -> Model:
    """One model of a file as one rigid thing, all its joints as they are drawn.

    Its own pose turns it, as where it is put into an empty world. Meshes are taken in their own frame, in
    the unit that they declare, as Gazebo does.

    Args:
      source: its body is the model's name, or "#" and its number; or a link of the only one, taken alone; the
        only model if empty. Its bodies are several models, named likewise, that are one piece of furniture.
      max_side: pixels; larger images are shrunk.

    Raises:
      AssetError: the file, or one that it names, is missing or cannot be understood; the message names it.
      ConfigError: it has no model or link of that name.
    """
    path = source.path
    name = source.body
    tree = read_sdf_tree(path)
    found = dict(models(tree.root))
    chosen = [found[each] for each in source.bodies or (name,) if each in found]
    if not chosen:
        own = [each for each in found.values() if not is_from_elsewhere(each)]
        chosen = [*own, *found.values()][:1]
    if not chosen:
        raise AssetError(f"{path} holds no model", "a <model> with links")
    surfaces = Surfaces(path, max_side, "uri", _FORMS)
    links = [
        link
        for model in chosen
        for link in _links(path, model, _pose(path, model) @ _from_placement_frame(path, model))
    ]
    if name and name not in found:
        known = [*found, *(link.name for link in links if len(found) == 1)]
        links = [link for link in links if link.name == name and len(found) == 1]
        if not links:
            raise unknown_body(name, path, known, "model or link")
    looks = _Looks(surfaces, chosen[0] if len(chosen) == 1 else tree.root)
    notes = [note for model in chosen for note in _notes(model)]
    notes += [f"left out of its world: {each.given}" for each in tree.missing]
    return rigid(links, surfaces, looks.of, notes)


def models(root: Element) -> Iterator[tuple[str, Element]]:
    """The models of a file, its world's among them, by name; by "#" and a number where names are no help."""
    found = [*root.findall("model"), *root.findall("world/model")]
    names = [each.get("name", "") for each in found]
    for index, (name, model) in enumerate(zip(names, found, strict=True)):
        yield name if name and names.count(name) == 1 else f"#{index}", model


def _from_placement_frame(path: Path, model: Element) -> np.ndarray:
    """f64[4, 4] from a model to the frame of it that its pose is of: its own, unless it names another."""
    return np.linalg.inv(_Frames(path, model).pose_of(model.get("placement_frame", "")))


def _links(path: Path, model: Element, pose: np.ndarray) -> Iterator[Link]:
    """The links of a model and of those nested in it.

    Args:
      pose: f64[4, 4] from the model to the outermost frame.
    """
    for tag in ("link", "joint", "model"):
        check_unique(path, model.findall(tag))
    frames = _Frames(path, model)
    frames.check_joints(model)
    for link in model.findall("link"):
        yield Link(link, pose, partial(frames.pose_of_element, parent=link.get("name", "")))
    for inner in model.findall("model"):
        yield from _links(path, inner, pose @ frames.pose_of(inner.get("name", "")))


def placed_links(path: Path, model: Element, world: Element) -> list[Link]:
    """The links of a model of a world, and of models nested in it; errors are those of `read_sdf`."""
    pose = _Frames(path, world).pose_of_element(model, "")
    return list(_links(path, model, pose @ _from_placement_frame(path, model)))


def axis_of(
    path: Path, model: Element, joint: Element, child: Link
) -> tuple[np.ndarray, np.ndarray | None]:
    """f64[3] each in the world: where a joint of a model is, and its axis, None if it has none.

    Args:
      child: the link that the joint moves, as `placed_links` has it.

    Raises:
      AssetError: a frame is not there, or the axis has no direction.
    """
    frames = _Frames(path, model)
    to_world = child.pose
    anchor = (to_world @ frames.pose_of(joint.get("name", "")))[:3, 3]
    axis = joint.find("axis")
    if axis is None:
        return anchor, None
    direction = numbers(path, axis, "xyz", 3, "0 0 1")
    if not direction.any():
        raise wrong_attribute(path, axis, "xyz", "a direction")
    written = axis.find("xyz")
    other = "" if written is None else written.get("expressed_in", "")
    turn = to_world @ frames.pose_of(other or joint.get("name", ""))
    return anchor, turn[:3, :3] @ (direction / np.linalg.norm(direction))


class _Frames:
    """The frames of a model: of its links, joints, nested models, and those that are frames alone."""

    def __init__(self, path: Path, model: Element) -> None:
        self._path = path
        tags = ("link", "joint", "model", "frame")
        self._named = {each.get("name", ""): each for tag in tags for each in model.findall(tag)}

    def check_joints(self, model: Element) -> None:
        """Refuses a joint between what is not there; `other::link` is in a nested model (AssetError)."""
        for joint in model.findall("joint"):
            for tag in ("parent", "child"):
                name = joint.findtext(tag, "").strip()
                if name.partition("::")[0] not in ("", "world", "__model__", *self._named):
                    given = f"{self._path}: joint {joint.get('name')!r} has the {tag} {name!r}, which is none"
                    raise AssetError(given, ", ".join(map(repr, self._named)))

    def pose_of_element(
        self, element: Element, parent: str, below: tuple[str, ...] = ()
    ) -> np.ndarray:
        """f64[4, 4] from an element to the model.

        Args:
          parent: the frame that holds where the element names none.
          below: frames that hang on this one.

        Raises:
          AssetError: a frame is named that is not there, or that hangs on itself.
        """
        pose = element.find("pose")
        other = "" if pose is None else pose.get("relative_to") or pose.get("frame") or ""
        return self.pose_of(other or parent, below) @ _pose(self._path, element)

    def pose_of(self, name: str, below: tuple[str, ...] = ()) -> np.ndarray:
        """f64[4, 4] from a frame to the model; see `pose_of_element`."""
        if name in ("", "__model__"):
            return np.eye(4)
        if name not in self._named or name in below or len(below) > _MOST_FRAMES:
            fault = "hangs on itself" if name in below else "is named and nowhere defined"
            if len(below) > _MOST_FRAMES:
                fault = f"hangs on more than {_MOST_FRAMES} others in a row"
            raise AssetError(
                f"{self._path}: frame {name!r} {fault}", ", ".join(map(repr, self._named))
            )
        frame = self._named[name]
        if frame.tag == "model":
            outer = self.pose_of_element(frame, "", (*below, name))
            return outer @ _from_placement_frame(self._path, frame)
        parent = (
            frame.findtext("child", "") if frame.tag == "joint" else frame.get("attached_to", "")
        )
        return self.pose_of_element(frame, parent.strip(), (*below, name))


def _pose(path: Path, element: Element) -> np.ndarray:
    """f64[4, 4]: the <pose> of an element in the frame that it is given in; none is the identity."""
    place = element.find("pose")
    form = "" if place is None else place.get("rotation_format", "euler_rpy")
    if place is None or not (place.text or "").strip():
        return np.eye(4)
    if form == "quat_xyzw":
        x, y, z, *turn = numbers(path, element, "pose", 7)
        matrix = trimesh.transformations.quaternion_matrix(np.roll(turn, 1))
    elif form == "euler_rpy":
        x, y, z, *angles = numbers(path, element, "pose", 6)
        roll, pitch, yaw = (
            np.radians(angles) if place.get("degrees", "") in ("true", "1") else angles
        )
        matrix = trimesh.transformations.euler_matrix(roll, pitch, yaw, "sxyz")
    else:
        raise wrong_attribute(path, place, "rotation_format", "euler_rpy or quat_xyzw")
    matrix[:3, 3] = x, y, z
    return matrix


def _notes(model: Element) -> Iterator[str]:
    if any((each.text or "").strip() in ("true", "1") for each in model.findall("static")):
        yield "its file says <static>: there it is scenery, which nothing moves"
    movable = [joint for joint in model.iter("joint") if joint.get("type", "fixed") != "fixed"]
    yield from frozen_note(
        (joint.get("name", ""), kind, 0.0, kind != "prismatic")
        for joint in movable
        if (kind := joint.get("type", ""))
    )


class _Looks:
    """The colours and images that the materials of a model name."""

    def __init__(self, surfaces: Surfaces, model: Element) -> None:
        self._surfaces = surfaces
        self._path = surfaces.path
        uris = [(each.text or "").strip() for each in model.iter("uri")]
        folders = [folder_place(self._path, uri) for uri in dict.fromkeys((*_SCRIPTS, *uris))]
        files = [file for folder in folders if folder for file in sorted(folder.glob("*.material"))]
        named = [mesh_place(self._path, uri) for uri in uris if uri.endswith(".material")]
        self._paints = read_paints(dict.fromkeys([*files, *filter(None, named)]))

    def of(self, element: Element) -> SurfaceLook:
        """Of a <visual>: an image for physically based rendering goes before a script, that before a colour.
        The finish is that of the workflow with metalness.

        A surface whose mesh has an image keeps it.
        """
        material = element.find("material")
        paint = Paint() if material is None else self._paint(material)
        colour = GREY if paint.colour is None else paint.colour
        if element.find("transparency") is not None:
            share = float(np.clip(number(self._path, element, "transparency"), 0, 1))
            colour = (*colour[:3], colour[3] * (1 - share))
        texture = self._surfaces.image(paint.image, paint.file) if paint.image else None
        maps = {tag: self._surfaces.picture(name) for tag, name in paint.maps.items()}
        finisher = self._surfaces.finisher
        finish = finisher.finish(
            paint.numbers,
            finisher.normal(maps.get("normal_map")),
            finisher.orm(maps.get("roughness_map"), maps.get("metalness_map")),
        )
        return SurfaceLook(colour, texture, finish)

    def _paint(self, material: Element) -> Paint:
        tag = next((each for each in ("diffuse", "ambient") if material.find(each) is not None), "")
        colour = self._surfaces.colour(material, tag) if tag else None
        paint = Paint(colour)
        if (said := material.find("pbr/metal")) is not None:
            paint = Paint(colour, numbers=self._numbers(said), maps=_maps(said))
        for workflow in ("metal", "specular"):
            if image := (material.findtext(f"pbr/{workflow}/albedo_map") or "").strip():
                return replace(paint, image=image, file=mesh_place(self._path, image))
        name = (material.findtext("script/name") or "").strip()
        if name and name not in self._paints:
            self._surfaces.notes.append(f"material {name!r} is named and nowhere defined")
        scripted = self._paints.get(name, paint)
        return replace(scripted, numbers=paint.numbers, maps=paint.maps)

    def _numbers(self, said: Element) -> dict[str, float]:
        """Roughness and metalness; a map stands in place of its number."""
        maps = _maps(said)
        numbers = {}
        for name, tag in (("roughness", "roughness"), ("metallic", "metalness")):
            if f"{tag}_map" in maps:
                numbers[name] = 1.0
            elif said.find(tag) is not None:
                numbers[name] = number(self._path, said, tag, is_finite=False)
        return numbers


def _maps(said: Element) -> dict[str, str]:
    """What a description of physically based rendering calls its maps, by their tags."""
    named = {tag: (said.findtext(tag) or "").strip() for tag in _MAPS}
    return {tag: name for tag, name in named.items() if name}
