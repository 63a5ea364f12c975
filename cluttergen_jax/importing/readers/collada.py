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
from cluttergen_jax.importing.readers.materials import LEFT_OUT, vary
from cluttergen_jax.importing.readers.polygons import CROSSING, cut_with_holes, cuts
from cluttergen_jax.importing.readers.xml_tree import (
    BROKEN,
    Element,
    parse_numbers,
    parse_xml,
    plain_tag,
)


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
                return next(
                    (each.get("meter", "1") for each in element if plain_tag(each) == "unit"), "1"
                )
    except BROKEN:
        pass
    return "1"


def plain_collada(path: Path) -> bytes | None:
    """The file with a name in place of each image's missing path, and polygons with holes as triangles.

    pycollada drops an image without a path, and with it the effect, the material and the surfaces; and it
    drops polygons with holes (<ph>). Surfaces whose vertices have colours, and on which no image can lie, are
    without their materials: trimesh takes these, which say less. None if there are none of the three.
    """
    if (tree := parse_xml(path)) is None:
        return None
    is_changed = _name_images(tree)
    for surface in _coloured_by_vertices(tree):
        if not _can_have_image(tree, surface):
            is_changed |= surface.attrib.pop("material", None) is not None
    for polygons in list(_all(tree, "polygons")):
        try:
            is_changed |= _cut_holes(tree, polygons)
        except (LookupError, ValueError, TypeError):
            # They stay, are dropped, and `collada_notes` says so.
            continue
    return ElementTree.tostring(tree) if is_changed else None


def _coloured_by_vertices(tree: Element) -> Iterator[Element]:
    """The surfaces at whose vertices colours differ."""
    sources = {each.get("id"): each for each in _all(tree, "source")}
    for tag in ("triangles", "polylist", "polygons", "tristrips", "trifans"):
        for surface in _all(tree, tag):
            named = [
                each.get("source", "")[1:] for each in surface if each.get("semantic") == "COLOR"
            ]
            found = sources.get(named[0]) if named else None
            if found is not None and vary(_colours(found)):
                yield surface


def _colours(source: Element) -> np.ndarray:
    """f64[N, 3]; none if the source is not of colours."""
    values = (
        next((parse_numbers(each.text or "") for each in _all(source, "float_array")), None) or []
    )
    stride = next((each.get("stride", "1") for each in _all(source, "accessor")), "3")
    step = int(stride) if stride.isdecimal() else 0
    if step < 3 or len(values) % step:
        return np.zeros((0, 3))
    return np.array(values).reshape(-1, step)[:, :3]


def _can_have_image(tree: Element, surface: Element) -> bool:
    has_places = any(each.get("semantic") == "TEXCOORD" for each in surface)
    return has_places and next(_all(tree, "texture"), None) is not None


def _name_images(tree: Element) -> bool:
    is_changed = False
    for image in _all(tree, "image"):
        places = [each for each in image if plain_tag(each) == "init_from"]
        if any((each.text or "").strip() for each in places):
            continue
        is_changed = True
        place = places[0] if places else ElementTree.SubElement(image, image.tag[:-5] + "init_from")
        # COLLADA 1.5 has the path one level deeper.
        place.text = next(
            (each.text for each in place if each.text), f"{image.get('id')} (no path is given)"
        )
    return is_changed


def _cut_holes(tree: Element, polygons: Element) -> bool:
    """Puts triangles in place of the <ph> of one <polygons>; whether there were some that can be cut."""
    inputs = [each for each in polygons if plain_tag(each) == "input"]
    width = 1 + max(int(each.get("offset", 0)) for each in inputs)
    (vertex,) = (each for each in inputs if each.get("semantic") == "VERTEX")
    points = _positions(tree, vertex.get("source", "")[1:])
    is_changed = False
    for polygon in [each for each in polygons if plain_tag(each) == "ph"]:
        rings = [
            np.array((each.text or "").split(), np.int64).reshape(-1, width) for each in polygon
        ]
        outlines = [points[ring[:, int(vertex.get("offset", 0))]] for ring in rings]
        if (triangles := cut_with_holes(outlines)) is None:
            continue
        corners = np.concatenate(rings)
        tag = polygon.tag[:-2] + "p"
        for triangle in triangles:
            words = corners[triangle].reshape(-1).tolist()
            ElementTree.SubElement(polygons, tag).text = " ".join(map(str, words))
        polygons.remove(polygon)
        is_changed = True
    if is_changed:
        polygons.set("count", str(sum(plain_tag(each) in ("p", "ph") for each in polygons)))
    return is_changed


def _positions(tree: Element, vertices: str) -> np.ndarray:
    """f64[V, 3]: where the vertices of an id are."""
    by_id = {each.get("id"): each for each in tree.iter() if each.get("id")}
    (place,) = (each for each in by_id[vertices] if each.get("semantic") == "POSITION")
    source = by_id[place.get("source", "")[1:]]
    (array,) = (each for each in source if plain_tag(each) == "float_array")
    (accessor,) = _all(source, "accessor")
    numbers = np.array((array.text or "").split(), np.float64)
    return numbers[int(accessor.get("offset", 0)) :].reshape(-1, int(accessor.get("stride", 1)))[
        :, :3
    ]


def collada_notes(path: Path) -> Iterator[str]:
    """What is not read of a COLLADA file."""
    data = plain_collada(path)
    tree = parse_xml(path) if data is None else ElementTree.fromstring(data)
    if holes := sum(1 for _ in _all(tree, "ph")):
        yield f"{holes} polygons with holes (<ph>) cannot be cut into triangles and are left out"
    if skins := sum(1 for _ in _all(tree, "instance_controller")):
        yield f"{skins} surfaces with a skeleton or a morph (<instance_controller>) are left out"
    if tree is not None and any(
        _can_have_image(tree, each) for each in _coloured_by_vertices(tree)
    ):
        yield LEFT_OUT


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
            polylist._triangleset = TriangleSet(
                polylist.sources, polylist.material, index, polylist.xmlnode
            )
        return cut_into_fans(polylist)

    with patch.object(Polylist, "triangleset", triangleset):
        yield notes


def _corners(polylist: Any, notes: list[str]) -> np.ndarray | None:
    """i64[F, 3]: rows of the list's index that make its triangles; None where fans will do."""
    named = polylist.vertex_index
    points = polylist.vertex
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
    fans = {
        n: np.array([[0, i + 1, i + 2] for i in range(n - 2)])
        for n in set(polylist.vcounts.tolist())
    }
    return np.concatenate(
        [start + found.get(i, fans[len(polygons[i])]) for i, start in enumerate(starts.tolist())]
    )
