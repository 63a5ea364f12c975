"""Colours and images of surfaces: of materials as trimesh reads them, and at the vertices of OBJ texts."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from cluttergen_jax.assets.finish import Finish
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece, Texture
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.finishes import Finisher, Open, mtl_alpha, seen_through
from cluttergen_jax.importing.readers.gltf import (
    Json,
    extension_notes,
    is_coloured_by_vertices,
    is_white,
    object_of,
    primitives_of,
    read_document,
)

LEFT_OUT = "its vertex colours are left out: the colour or the image of its material is taken"
MANY = 7
"""How far colours may differ, of 255, for one colour to do for all."""
_COLOUR = rb"([-+.\deE]+)"
_COLOURED = re.compile(
    rb"^[ \t]*v[ \t]+(?:[-+.\deE]+[ \t]+){3}%s[ \t]+%s[ \t]+%s[ \t\r]*$"
    % (_COLOUR, _COLOUR, _COLOUR),
    re.MULTILINE,
)
"""A vertex of an OBJ text with a colour behind its place."""
_PLACE_IN_IMAGE = re.compile(rb"^[ \t]*vt[ \t]", re.MULTILINE)
_USE = re.compile(rb"^[ \t]*usemtl[ \t]*([^\n]*)$", re.MULTILINE)


def coloured_by_vertices(data: bytes) -> tuple[bytes, tuple[str, ...]]:
    """An OBJ text without its materials where its vertices have colours and no image can be laid on it.

    trimesh takes the materials', which say less.

    Returns:
      The text, and notes on colours that are left out.
    """
    used = {name.strip() for name in _USE.findall(data)}
    if not used:
        return data, ()
    try:
        colours = np.array(_COLOURED.findall(data), "S").astype(np.float64).reshape(-1, 3)
    except ValueError:
        # What is no number is reported by whoever reads the vertices.
        return data, ()
    if not vary(colours):
        return data, ()
    if _PLACE_IN_IMAGE.search(data):
        return data, (LEFT_OUT,)
    notes = ("the colours of its materials are left out: those of its vertices are taken",)
    return _USE.sub(b"", data), notes if len(used) > 1 else ()


def vary(colours: np.ndarray) -> bool:
    """Whether f64[N, 3], from 0 to 1 or to 255, are too different for one colour to do for all."""
    if not len(colours) or not np.isfinite(colours).all():
        return False
    top = 255.0 if colours.max() > 1 else 1.0
    return bool(np.ptp(colours, axis=0).max() * 255 / top > MANY)


Rgba = tuple[float, float, float, float]
GREY: Rgba = (0.7, 0.7, 0.7, 1.0)
_OPAQUE = 250
_FAINTEST = 0.2
"""Alpha of what is to be seen."""
_PBR_MAPS = ("occlusionTexture", "emissiveTexture")
_MTL_MAP = re.compile(r"map_(?!k[ad]$|p[rm]$|bump$).+|disp|decal|refl")
_GREYISH = 0.02
"""How far the channels of a grey differ at most, of 1."""
_LIGHT = 0.5
"""A grey Kd from here on is what exporters write beside an image: it gets no note."""


class Dresser:
    """Gives each mesh of a file its colour or its image.

    Args:
      is_linear: whether colours are stored as in glTF, linear.
      max_side: pixels that an image may have a side.
      image: for surfaces that have uv but no image of their own.
      records: the materials of a glTF file as it has them, which trimesh calls by their numbers.
      open_image: opens images that an MTL file names.

    Attributes:
      notes: what was lost, in words.
    """

    def __init__(
        self,
        is_linear: bool,
        max_side: int,
        image: Texture | None = None,
        records: Sequence[Json] = (),
        open_image: Open | None = None,
    ) -> None:
        self._is_linear = is_linear
        self._max_side = max_side
        self._image = image
        self._records = records
        self._open_image = open_image
        self._finisher = Finisher(max_side, self._note)
        self._known: dict[int, tuple[Image.Image, Texture | None]] = {}
        self.notes: list[str] = []

    def piece(self, mesh: Mesh, visual: Any) -> Piece:
        """The mesh with what a trimesh visual lays on it."""
        uv = _uv(visual, len(mesh.vertices))
        image = _image_of(visual)
        if others := _other_maps(getattr(visual, "material", None), is_gltf=bool(self._records)):
            self._note(f"of its materials {', '.join(others)} is not kept")
        finish = self._finish(visual, uv is not None)
        texture = self._image
        rgba = (1.0, 1.0, 1.0, 1.0)
        if image is not None:
            texture = self._texture(image, visual.material)
            rgba = self._factor(visual.material)
        if texture is not None and uv is not None:
            return Piece(mesh, seen_through(rgba, finish), uv, texture, finish=finish)
        if image is not None and uv is None:
            self._note(
                "a surface has an image but no sound texture coordinates: it gets one colour"
            )
        visual = self._coloured(mesh, visual)
        rgba = mean_colour(visual, self._is_linear)
        if visual.kind == "texture" and rgba != GREY:
            alpha = min(mtl_alpha(getattr(visual.material, "kwargs", {})), 1.0)
            rgba = (*rgba[:3], max(round(rgba[3] * alpha, 4), _FAINTEST))
        rgba = seen_through(rgba, finish)
        if visual.kind in ("vertex", "face") and (found := _many_colours(mesh, visual)) is not None:
            mesh, colours = found
            if finish is not None and finish.images:
                self._note("the maps of a surface with colours at its vertices are left out")
                finish = finish.without_maps
            return Piece(mesh, (1.0, 1.0, 1.0, rgba[3]), colours=colours, finish=finish)
        is_mapped = finish is not None and bool(finish.images)
        return Piece(mesh, rgba, uv if is_mapped else None, finish=finish)

    def _finish(self, visual: Any, has_uv: bool) -> Finish | None:
        """What the material of a surface says beside its colour: of glTF and MTL."""
        material = getattr(visual, "material", None)
        if (record := self._record(material)) is not None:
            return self._finisher.of_gltf(material, record, has_uv)
        said = getattr(material, "kwargs", None)
        if said is None or self._open_image is None:
            return None
        return self._finisher.of_mtl(said, self._open_image, has_uv)

    def _record(self, material: Any) -> Json | None:
        """A material of glTF as its file has it."""
        name = str(getattr(material, "name", ""))
        is_one = name.isdecimal() and int(name) < len(self._records)
        return self._records[int(name)] if is_one else None

    def _coloured(self, mesh: Mesh, visual: Any) -> Any:
        """The visual, or that of the colours at its vertices, where its material of glTF is white."""
        colours = getattr(visual, "vertex_attributes", {}).get("color")
        record = self._record(getattr(visual, "material", None))
        if colours is None or record is None or not is_white(record):
            return visual
        if len(colours) != len(mesh.vertices):
            return visual
        return trimesh.Trimesh(
            mesh.vertices, mesh.faces, vertex_colors=colours, process=False
        ).visual

    def _texture(self, image: Image.Image, material: Any) -> Texture | None:
        if id(image) not in self._known:
            try:
                flat = self._without_alpha(image, getattr(material, "alphaMode", None))
                self._known[id(image)] = image, Texture.of(flat, self._max_side)
            except AssetError as error:
                self._note(f"{error.given}: its surface gets one colour")
                self._known[id(image)] = image, None
        return self._known[id(image)][1]

    def _without_alpha(self, image: Image.Image, mode: str | None) -> Image.Image:
        """The image on white where its transparency is meant to be seen, which is not kept."""
        if mode not in ("BLEND", "MASK") or "A" not in image.getbands():
            return image
        try:
            clear = image.convert("RGBA")
        except (OSError, ValueError, SyntaxError) as error:
            raise AssetError(f"an image that cannot be decoded ({error})") from error
        if min(clear.getchannel("A").tobytes()) < _OPAQUE:
            self._note("the transparency of an image is not kept")
        white = Image.new("RGBA", clear.size, (255, 255, 255, 255))
        return Image.alpha_composite(white, clear)

    def _factor(self, material: Any) -> Rgba:
        """What the image is multiplied by: MTL's d, glTF's base colour factor.

        MTL's Kd beside an image is left over in most files, and Blender, MeshLab and others ignore it.
        """
        kept = getattr(material, "kwargs", None)
        if kept is not None:
            colour = _numbers(kept.get("kd"), 3)
            if colour is not None and (
                max(colour) < _LIGHT or max(colour) - min(colour) > _GREYISH
            ):
                text = " ".join(f"{each:g}" for each in colour)
                self._note(
                    f"an image is drawn as it is, not multiplied by its material's colour (Kd {text})"
                )
            return _rgba([1.0, 1.0, 1.0, mtl_alpha(kept)])
        factor = getattr(material, "baseColorFactor", None)
        if factor is None:
            return (1.0, 1.0, 1.0, 1.0)
        rgba = np.asarray(factor, np.float64) / 255
        alpha = rgba[3] if len(rgba) > 3 and not _is_opaque(material) else 1.0
        return _rgba([*(_srgb(rgba[:3]) if self._is_linear else rgba[:3]), alpha])

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)


def _numbers(values: Any, count: int) -> list[float] | None:
    """`count` finite numbers, or None if these are others."""
    try:
        numbers = np.array(values, np.float64).reshape(-1).tolist()
    except (TypeError, ValueError):
        return None
    return numbers if len(numbers) == count and np.isfinite(numbers).all() else None


def _uv(visual: Any, count: int) -> np.ndarray | None:
    """f64[V, 2], or None if there are none, or not of every vertex."""
    uv = getattr(visual, "uv", None)
    if uv is None or np.ndim(uv) != 2 or len(uv) != count or np.shape(uv)[1] < 2:
        return None
    uv = np.asarray(uv, np.float64)[:, :2]
    return uv if np.isfinite(uv).all() else None


def _image_of(visual: Any) -> Image.Image | None:
    """The image of a visual's colours; None where there is none, or what trimesh puts in its stead."""
    if visual.kind != "texture":
        return None
    material = visual.material
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    return image if image is not None and image.format is not None else None


def _other_maps(material: Any, is_gltf: bool) -> list[str]:
    """What a material lays on a surface and is not kept: light, holes, other relief than of glTF and MTL."""
    maps = _PBR_MAPS if is_gltf else (*_PBR_MAPS, "normalTexture")
    named = [name for name in maps if getattr(material, name, None) is not None]
    return named + sorted(key for key in getattr(material, "kwargs", {}) if _MTL_MAP.fullmatch(key))


def _is_opaque(material: Any) -> bool:
    """Whether it is a material of glTF that is opaque whatever its alpha: `OPAQUE` is the default."""
    return hasattr(material, "alphaMode") and material.alphaMode in (None, "OPAQUE")


def _many_colours(mesh: Mesh, visual: Any) -> tuple[Mesh, np.ndarray] | None:
    """The mesh and u8[V, 3], a colour for each of its vertices; None where one colour does for all.

    Of a mesh with colours for its triangles, each triangle gets vertices of its own.
    """
    try:
        if visual.kind == "face":
            colours = np.repeat(np.asarray(visual.face_colors)[:, :3], 3, axis=0)
            mesh = Mesh(mesh.corners.reshape(-1, 3), np.arange(3 * len(mesh.faces)))
        else:
            colours = np.asarray(visual.vertex_colors)[:, :3]
        if len(colours) != len(mesh.vertices) or colours.dtype != np.uint8:
            return None
    except Exception:  # A damaged colour must not cost the object.
        return None
    shown = colours[np.unique(mesh.faces)]
    return (mesh, colours) if np.ptp(shown.astype(int), axis=0).max() > MANY else None


def _srgb(values: np.ndarray) -> np.ndarray:
    """Linear colours as sRGB."""
    return np.where(
        values <= 0.0031308, 12.92 * values, 1.055 * np.maximum(values, 0) ** (1 / 2.4) - 0.055
    )


def _rgba(values: Iterable[float]) -> Rgba:
    """To a 255th: never quite the grey of one half, which MuJoCo takes for no colour at all."""
    r, g, b, a = (round(round(255 * min(max(float(value), 0.0), 1.0)) / 255, 4) for value in values)
    return r, g, b, max(a, _FAINTEST)


def mean_colour(visual: Any, is_linear: bool = False) -> Rgba:
    """One sRGB colour for a trimesh visual; grey where it has none."""
    try:
        if visual.kind == "texture":
            colours = _texture_colours(visual, is_linear)
        elif visual.defined:
            colours = np.atleast_2d(visual.face_colors) / 255.0
        else:
            return GREY
    except Exception:  # A broken texture must not cost the object.
        return GREY
    mean = np.asarray(colours, np.float64).reshape(-1, 4).mean(0).clip(0, 1)
    r, g, b, a = (round(each, 4) for each in mean.tolist())
    return r, g, b, max(a, _FAINTEST)


def _texture_colours(visual: Any, is_linear: bool) -> np.ndarray:
    material = visual.material
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if image is not None and image.format is None:
        # What trimesh puts where a material or its texture is missing.
        return np.array(GREY)
    main = np.asarray(material.main_color, np.float64) / 255.0
    main = np.append(_srgb(main[:3]), main[3:]) if is_linear else main
    return np.append(main[:3], 1.0) if _is_opaque(material) else main


_IMAGES_OF_GLTF = {
    "baseColorTexture": "image",
    "metallicRoughnessTexture": "map of roughness and metalness",
    "normalTexture": "normal map",
}


def gltf_notes(path: Path, materials: Sequence[Any]) -> Iterator[str]:
    """What a glTF file says that is not followed, or that could not be read.

    Args:
      materials: as trimesh has read them, None where there is none.
    """
    document = read_document(path)
    yield from extension_notes(document)
    coloured = [each for each in primitives_of(document) if "COLOR_0" in each["attributes"]]
    dressed = [each for each in coloured if "material" in each]
    if not all(is_coloured_by_vertices(document, each) for each in dressed):
        yield LEFT_OUT
    read = {each.name: each for each in materials if each is not None}
    for index, material in enumerate(document.get("materials", [])):
        # A name is optional.
        own = material.get("name")
        name = f"number {index}" if own is None else own
        look = object_of(material, "pbrMetallicRoughness")
        known = read.get(str(index))
        for key, what in _IMAGES_OF_GLTF.items():
            is_named = key in look or key in material
            if is_named and known is not None and getattr(known, key, None) is None:
                yield f"the {what} of material {name!r} cannot be read"
        image = look.get("baseColorTexture")
        if image is None:
            continue
        if "KHR_texture_transform" in image.get("extensions", {}):
            yield f"the image of material {name!r} is transformed (KHR_texture_transform): that is ignored"
        if image.get("texCoord", 0) != 0:
            yield f"material {name!r} wants other texture coordinates than the first: those are taken"
