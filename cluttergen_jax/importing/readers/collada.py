"""COLLADA files: their unit of length, and what their parser would lose without a word."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from cluttergen_jax.errors import AssetError

Element = ElementTree.Element
_BROKEN = (OSError, ElementTree.ParseError, ValueError, LookupError)
"""What a file that is no XML, or in no known encoding, raises; the parser of meshes tells of it."""


def unit_of(path: Path) -> float:
    """Metres in the file's unit of length: what its <unit> says, 1 if it says nothing.

    Raises:
      AssetError: the unit is no length.
    """
    text = _declared_unit(path)
    try:
        unit = float(text)
    except ValueError:
        unit = math.nan
    if not (math.isfinite(unit) and unit > 0):
        raise AssetError(f'{path}: <unit meter="{text}">', "metres in one unit: a number above 0")
    return unit


def _declared_unit(path: Path) -> str:
    try:
        for _, element in ElementTree.iterparse(path):
            if _tag(element) == "asset":
                return next((each.get("meter", "1") for each in element if _tag(each) == "unit"), "1")
    except _BROKEN:
        pass
    return "1"


def with_image_paths(path: Path) -> bytes | None:
    """The file with a name in place of each image's missing path; None if none is missing.

    pycollada drops an image without a path, and with it the effect, the material and the surfaces.
    """
    tree = _parsed(path)
    is_changed = False
    for image in _all(tree, "image"):
        places = [each for each in image if _tag(each) == "init_from"]
        if any((each.text or "").strip() for each in places):
            continue
        is_changed = True
        place = places[0] if places else ElementTree.SubElement(image, image.tag[:-5] + "init_from")
        # COLLADA 1.5 has the path one level deeper.
        place.text = next((each.text for each in place if each.text), f"{image.get('id')} (no path is given)")
    return ElementTree.tostring(tree) if tree is not None and is_changed else None


def collada_notes(path: Path) -> Iterator[str]:
    """What is not read of a COLLADA file."""
    if skins := sum(1 for _ in _all(_parsed(path), "instance_controller")):
        yield f"{skins} surfaces with a skeleton or a morph (<instance_controller>) are left out"


def _parsed(path: Path) -> Element | None:
    try:
        return ElementTree.parse(path).getroot()
    except _BROKEN:
        return None


def _all(tree: Element | None, tag: str) -> Iterator[Element]:
    return (each for each in (() if tree is None else tree.iter()) if _tag(each) == tag)


def _tag(element: Element) -> str:
    """Without its namespace."""
    return str(element.tag).rpartition("}")[2]
