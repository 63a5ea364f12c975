"""COLLADA files: their unit of length, and what their parser would lose without a word."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.xml_tree import BROKEN, Element, parse_xml, plain_tag


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
            if plain_tag(element) == "asset":
                return next((each.get("meter", "1") for each in element if plain_tag(each) == "unit"), "1")
    except BROKEN:
        pass
    return "1"


def with_image_paths(path: Path) -> bytes | None:
    """The file with a name in place of each image's missing path; None if none is missing.

    pycollada drops an image without a path, and with it the effect, the material and the surfaces.
    """
    tree = parse_xml(path)
    is_changed = False
    for image in _all(tree, "image"):
        places = [each for each in image if plain_tag(each) == "init_from"]
        if any((each.text or "").strip() for each in places):
            continue
        is_changed = True
        place = places[0] if places else ElementTree.SubElement(image, image.tag[:-5] + "init_from")
        # COLLADA 1.5 has the path one level deeper.
        place.text = next((each.text for each in place if each.text), f"{image.get('id')} (no path is given)")
    return ElementTree.tostring(tree) if tree is not None and is_changed else None


def collada_notes(path: Path) -> Iterator[str]:
    """What is not read of a COLLADA file."""
    tree = parse_xml(path)
    if holes := sum(1 for _ in _all(tree, "ph")):
        yield f"{holes} polygons with holes (<ph>) are left out"
    if skins := sum(1 for _ in _all(tree, "instance_controller")):
        yield f"{skins} surfaces with a skeleton or a morph (<instance_controller>) are left out"


def _all(tree: Element | None, tag: str) -> Iterator[Element]:
    return (each for each in (() if tree is None else tree.iter()) if plain_tag(each) == tag)
