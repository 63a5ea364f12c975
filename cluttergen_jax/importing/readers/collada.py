"""COLLADA files: their unit, what their parser would lose without a word, and polygons that it would fold."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch
from xml.etree import ElementTree

import numpy as np

from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.polygons import CROSSING, cuts
from cluttergen_jax.importing.readers.xml_tree import BROKEN, Element, parse_numbers, parse_xml, plain_tag


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
            polylist._triangleset = TriangleSet(polylist.sources, polylist.material, index, polylist.xmlnode)
        return cut_into_fans(polylist)

    with patch.object(Polylist, "triangleset", triangleset):
        yield notes


def _corners(polylist: Any, notes: list[str]) -> np.ndarray | None:
    """i64[F, 3]: rows of the list's index that make its triangles; None where fans will do."""
    named, points = polylist.vertex_index, polylist.vertex
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
    fans = {n: np.array([[0, i + 1, i + 2] for i in range(n - 2)]) for n in set(polylist.vcounts.tolist())}
    return np.concatenate(
        [start + found.get(i, fans[len(polygons[i])]) for i, start in enumerate(starts.tolist())]
    )
