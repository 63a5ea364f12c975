"""OGRE's material scripts, by which Gazebo's models name colours and images."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cluttergen_jax.importing.readers.materials import Rgba
from cluttergen_jax.importing.readers.places import find_named
from cluttergen_jax.importing.readers.text import utf8

_MATERIAL = re.compile(r"^[ \t]*material[ \t]+(\S+)(?:[ \t]*:[ \t]*(\S+))?[^{\n]*\s*\{", re.MULTILINE)
_IMAGE = re.compile(r"^[ \t]*texture[ \t]+(\"[^\"]+\"|\S+)", re.MULTILINE)
_COLOUR = re.compile(r"^[ \t]*diffuse[ \t]+([-+.\deE \t]+?)[ \t\r]*$", re.MULTILINE)
_COMMENT = re.compile(r"//[^\n]*")


@dataclass(frozen=True)
class Paint:
    """What a material lays on a surface.

    Attributes:
      colour: None where it says nothing.
      image: what it calls its image, empty if it has none; file: where that is, None if it is not there.
    """

    colour: Rgba | None = None
    image: str = ""
    file: Path | None = None


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
        text = _COMMENT.sub("", utf8(script.read_bytes()).decode())
        for start in _MATERIAL.finditer(text):
            name, parent = start[1], found.get(start[2] or "", Paint())
            found.setdefault(name, _paint(_block(text, start.end()), script.parent, parent))
    return paints | found


def _block(text: str, start: int) -> str:
    """What follows, up to the bracket that closes it."""
    depth = 1
    for place in re.finditer(r"[{}]", text[start:]):
        depth += 1 if place[0] == "{" else -1
        if not depth:
            return text[start : start + place.start()]
    return text[start:]


def _paint(block: str, folder: Path, parent: Paint) -> Paint:
    colour, image = _COLOUR.search(block), _IMAGE.search(block)
    rgba = parent.colour if colour is None else _rgba(colour[1])
    if image is None:
        return Paint(rgba, parent.image, parent.file)
    name = image[1].strip('"')
    return Paint(rgba, name, find_named(folder, name))


def _rgba(text: str) -> Rgba | None:
    """Three or four numbers; None where they are others."""
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        return None
    if len(values) not in (3, 4):
        return None
    r, g, b, a = np.clip([*values, 1.0][:4], 0, 1).tolist()
    return (r, g, b, a)
