"""One object to be read: where it is, what it is called, how it is read."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import get_args

import numpy as np
from anyascii import anyascii

from cluttergen_jax.assets.config import MAX_TEXTURE
from cluttergen_jax.assets.object_files import RESERVED
from cluttergen_jax.assets.shape import Provenance
from cluttergen_jax.config import ByVolume, Collision, check_positive
from cluttergen_jax.errors import ConfigError

AUTO = "auto"
FILE = "file"
AXES = ("x", "y", "z", "-x", "-y", "-z")
_VECTORS = {
    sign + name: (-1.0 if sign else 1.0) * np.eye(3)[index]
    for sign in ("", "-")
    for index, name in enumerate("xyz")
}


@dataclass(frozen=True)
class UpAxis:
    """The axis that was taken for up, and why, in words.

    Attributes:
      is_stated: by the file or by its format's standard; False where neither says anything.
    """

    axis: str
    reason: str
    is_stated: bool = True


def own_up(path: Path, kind: str) -> UpAxis:
    """What a file says about its vertical axis, or else its format.

    Args:
      kind: "mesh", "urdf", "sdf" or "mjcf".
    """
    if kind != "mesh":
        return UpAxis("z", f"{kind.upper()}'s standard")
    suffix = path.suffix.lower()
    if suffix in (".glb", ".gltf"):
        return UpAxis("y", "GLTF's standard")
    if suffix == ".dae":
        declared = re.search(rb"<up_axis>\s*([XYZ])_UP", path.read_bytes())
        if declared:
            return UpAxis(declared.group(1).decode().lower(), "the file's declaration")
        return UpAxis("y", "COLLADA's standard")
    return UpAxis("z", f"by default: {suffix[1:].upper()} does not say", is_stated=False)


def check_axes(up: str, front: str) -> None:
    """Raises ConfigError if these are no axes, or not at a right angle."""
    for name, axis in (("up", up), ("front", front)):
        words = (AUTO, FILE) if name == "up" else (AUTO,)
        if axis not in (*words, *AXES):
            raise ConfigError(f"{name} = {axis!r}", ", ".join((*words, *AXES)))
    if {up, front} <= set(AXES) and up[-1] == front[-1]:
        raise ConfigError(f"up = {up!r} with front = {front!r}", "two axes at a right angle")


def turn_of(up: str, front: str = AUTO) -> np.ndarray:
    """f64[3, 3]: the rotation that takes a file's `up` to z and its `front` to x.

    Raises:
      ConfigError: they are not at a right angle.
    """
    if front == AUTO:
        front = "-y" if up.endswith("x") else "x"
    check_axes(up, front)
    z = _VECTORS[up]
    x = _VECTORS[front]
    return np.array([x, np.cross(z, x), z])


# File names of which one in a folder is the object that the folder is called after.
GENERIC = (
    r"mobility|model|models|object|mesh|meshes|textured|nontextured|textured_objs|visual|collision"
    r"|scene|base|main|urdf|mjcf|google_\d+k|textured_simple(_reordered)?|assets|untitled"
)
_SAYS_NOTHING = re.compile(
    rf"\d{{1,2}}|{GENERIC}|(model|mesh|textured)[-_ ](normali[sz]ed|simplified|watertight)|normali[sz]ed"
    r"|(base|root)[-_ ]?link|root|world|body|objects|(visual|collision|textured)[-_ ]mesh(es)?"
    r"|visuals|collisions|objs?|stls?|glbs?|gltfs?|dae|ply|geometry([-_ ]?\d+)?"
)
"""Names of files, folders and bodies that say nothing about the object."""
_LONGEST = 200
"""Letters of a name: a folder is called so, and may get a number behind it."""


@dataclass(frozen=True)
class ReadOptions:
    """How files are read, and what they do not say.

    Attributes:
      scale: factor from the file's unit to metres.
      up: the file's axis that points up: x, y, z, -x, -y or -z; "file" takes what the file or its format says
        (`own_up`). All of these keep the authored pose; "auto" begins with the file's axis. Where the
        file or its format states that axis and the object stands so, it keeps that pose; else it is turned
        into the pose in which people put it (`assets.stances`).
      front: the file's axis that becomes the object's +x, at a right angle to `up`, and keeps the pose too;
        "auto" takes x, or -y where x is up.
      density: kg/m^3, for objects whose mass is not known.
      mass: kilograms for every object, instead of volume times density; "volume" takes the latter even where
        a file states a mass.
      friction: sliding coefficient of the object; None leaves it to the contact's.
      licence, attribution: on which terms the object may be passed on; empty where the source says it.
      max_texture: pixels a side that an image may have; larger ones are shrunk.
      collision: "keep" takes collision shapes that lie beside a mesh file (`pieces.collision_files`) as its
        parts; "auto" cuts the mesh itself. Models have their own.
    """

    scale: float = 1.0
    up: str = "auto"
    density: float = 500.0
    mass: float | ByVolume | None = None
    front: str = "auto"
    friction: float | None = None
    licence: str = ""
    attribution: str = ""
    max_texture: int = MAX_TEXTURE
    collision: str = "auto"

    def __post_init__(self) -> None:
        check_positive(self, "scale", "density", "max_texture")
        for name in ("mass", "friction"):
            if getattr(self, name) is not None and (name, getattr(self, name)) != (
                "mass",
                "volume",
            ):
                check_positive(self, name)
        check_axes(self.up, self.front)
        if self.collision not in get_args(Collision):
            raise ConfigError(f"collision = {self.collision!r}", ", ".join(get_args(Collision)))


@dataclass(frozen=True)
class ObjectFile:
    """One object to be read.

    Attributes:
      path: the mesh, URDF, SDF or MJCF file.
      kind: "mesh", "urdf", "sdf" or "mjcf".
      name: `[a-z0-9_-]+`, unique among the sources found together.
      label: what people call it.
      body: the body's or model's name, where an MJCF or SDF file holds several objects.
      bodies: of furniture, the bodies or models that are one piece of it together.
      notes: known faults, passed on as flags.
      parts: files of collision shapes that are to be its parts.
      synset: what kind of thing it is, as its file or its settings say.
      outside: files that it takes from outside its folder (`Provenance.outside`).
      plain: the name without the number that sets it apart from others.
      stretch: factors along a mesh file's axes, beside `scale`.
      decisions: what was decided before it is read, in words; passed on as notes.
    """

    path: Path
    kind: str
    name: str
    label: str
    body: str = ""
    bodies: tuple[str, ...] = ()
    provenance: Provenance | None = None
    notes: tuple[str, ...] = ()
    parts: tuple[Path, ...] = ()
    synset: str = ""
    outside: tuple[str, ...] = ()
    plain: str = ""
    stretch: tuple[float, float, float] = (
        1.0,
        1.0,
        1.0,
    )
    decisions: tuple[str, ...] = ()


_OF_NO_UNIT = (".obj", ".stl", ".ply")


def states_unit(source: ObjectFile) -> bool:
    """Whether its format has a unit: URDF, SDF, MJCF and glTF have metres, and DAE files state theirs."""
    return source.kind != "mesh" or source.path.suffix.lower() not in _OF_NO_UNIT


def make_source(path: Path, kind: str, title: str = "", behind: str = "") -> ObjectFile:
    """The source of a file.

    Args:
      title: what it is called; if that says nothing, the part of its path is taken that says most.
      behind: what follows that part, where there is no title.
    """
    if not says_something(title):
        title = telling_name(path) + behind
    name = plain_name(title)
    return ObjectFile(path, kind, name, label_of(title), plain=name)


def says_something(title: str) -> bool:
    """Whether a name says what the object is."""
    return bool(title) and not _SAYS_NOTHING.fullmatch(title.lower())


def telling_name(path: Path) -> str:
    """The innermost part of a path that says what the object is."""
    parts = [path.stem, *(each.name for each in path.resolve().parents)]
    return next(filter(says_something, parts), path.stem)


def label_of(title: str) -> str:
    """What people call an object, in their own script."""
    return re.sub(r"^\d+[-_ ]+", "", title).replace("_", " ").strip() or title


def plain_name(text: str) -> str:
    """`text` in the letters allowed for names: other scripts and accents as their nearest Latin letters."""
    text = anyascii(unicodedata.normalize("NFC", text))[:_LONGEST]
    return re.sub(r"[^a-z0-9_-]+", "_", text.lower()).strip("_") or "object"


def make_names_distinct(sources: Sequence[ObjectFile]) -> list[ObjectFile]:
    """Distinct names: where several objects share one, all but the first get the next free number.

    One called `support`, as the body of a scene's support is, gets a number too.
    """
    taken = {RESERVED}
    out = []
    for source in sources:
        numbered = (f"{source.name}-{number}" for number in count(2))
        name = (
            source.name if source.name not in taken else next(n for n in numbered if n not in taken)
        )
        taken.add(name)
        out.append(replace(source, name=name))
    return out
