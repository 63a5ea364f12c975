"""Finishes of surfaces: what glTF, MTL and SDF say of roughness, metalness, relief and transmission.

Of glTF the numbers hold as they are; where a file states one of roughness and metalness, the other is 1, as
glTF has it, and where it states neither, nothing is known of them. MTL states `Pr` and `Pm`, or else Phong's
`Ns`: an exponent n is a roughness r of Blinn's model, r^4 = 2 / (n + 2); Blender writes n = 1000 (1 - r)^2.
Without highlights (`Ks` of 0, or `illum` of 0 or 1) a surface is matte.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from PIL import Image

from cluttergen_jax.assets.finish import Finish
from cluttergen_jax.assets.shape import Texture
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.gltf import TRANSMISSION, Json, object_of

_GLASS = 0.3
"""Alpha of what lets all light through: renderers that know no transmission show it so."""
_NO_HIGHLIGHTS = (0, 1)
"""Of MTL's `illum`."""
_BY_BLENDER = re.compile(rb"^[ \t]*#[ \t]*Blender\b", re.MULTILINE)
_EXPONENT = re.compile(rb"^([ \t]*Ns[ \t]+)([-+.\deE]+)(?=[ \t\r]*$)", re.MULTILINE)
_BUMPS = ("map_bump", "bump")
_UNIT = 0.25
"""How far from 1 the lengths of a map's normals may be: of JPEG files, and of shrunk ones."""
_BLUER = 0.1
_MOST = 0.8
"""Of its pixels."""
_SIDE = 64
_STEEPEST = 1000.0
"""Factor on the slopes of a map of normals."""

Open = Callable[[str], Image.Image]
"""Opens the image that a material names (AssetError: why it cannot be)."""


@dataclass
class Finisher:
    """Makes finishes of what files state, images of theirs once.

    Attributes:
      max_side: pixels that an image may have a side.
      note: takes what is lost, in words.
    """

    max_side: int
    note: Callable[[str], None]
    _known: dict[tuple[Any, ...], tuple[tuple[Any, ...], Texture | None]] = field(
        default_factory=dict
    )

    def of_gltf(self, material: Any, record: Json, has_uv: bool) -> Finish | None:
        """What a material of glTF says; None if it says nothing.

        Args:
          material: as trimesh has read it. record: as the file has it.
          has_uv: whether maps can lie on the surface.
        """
        look = object_of(record, "pbrMetallicRoughness")
        bumps = object_of(record, "normalTexture")
        gloss = object_of(look, "metallicRoughnessTexture")
        normal = self._map(material.normalTexture, bumps, "normal map")
        orm = self._map(material.metallicRoughnessTexture, gloss, "map of roughness and metalness")
        numbers = {"roughness": material.roughnessFactor, "metallic": material.metallicFactor}
        given = {name: value for name, value in numbers.items() if value is not None}
        if given or orm is not None:
            given = {"roughness": 1.0, "metallic": 1.0} | given
        if share := self._transmission(record):
            given["transmission"] = share
        return self.finish(
            given,
            self.normal(normal, bumps.get("scale", 1.0)) if has_uv else None,
            self.orm(orm, orm) if has_uv else None,
            lost=[] if has_uv else [each for each in (normal, orm) if each is not None],
        )

    def of_mtl(self, said: Mapping[str, Any], open_image: Open, has_uv: bool) -> Finish | None:
        """What a material of MTL says; None if it says nothing.

        Args:
          said: its values by lower-case keyword, as trimesh has read them.
        """
        given = {
            name: value
            for name, key in (("roughness", "pr"), ("metallic", "pm"))
            if (value := _number(said.get(key))) is not None
        }
        if "roughness" not in given and (roughness := _phong_roughness(said)) is not None:
            given["roughness"] = roughness
        images = {
            key: self._open(key, said[key], open_image)
            for key in ("norm", *_BUMPS, "map_pr", "map_pm")
            if key in said
        }
        for key in _BUMPS:
            if (bumps := images.get(key)) is not None and not is_normal_map(bumps):
                self.note(f"{key} is left out: it is a map of heights, not of normals")
                images[key] = None
        normal = next(
            (images[key] for key in ("norm", *_BUMPS) if images.get(key) is not None), None
        )
        roughness_map = images.get("map_pr")
        metallic_map = images.get("map_pm")
        # A map stands in place of its number.
        given |= {"roughness": 1.0} if roughness_map is not None else {}
        given |= {"metallic": 1.0} if metallic_map is not None else {}
        maps = [each for each in (normal, roughness_map, metallic_map) if each is not None]
        return self.finish(
            given,
            self.normal(normal) if has_uv else None,
            self.orm(roughness_map, metallic_map) if has_uv else None,
            lost=[] if has_uv else maps,
        )

    def finish(
        self,
        given: Mapping[str, float],
        normal: Texture | None = None,
        orm: Texture | None = None,
        lost: list[Any] | None = None,
    ) -> Finish | None:
        """A finish of numbers, clipped to 0 to 1 with a note; None if there are neither numbers nor maps.

        Args:
          lost: maps that cannot be laid on the surface.
        """
        if lost:
            self.note("a surface has maps but no sound texture coordinates: they are left out")
        numbers = {}
        for name, value in given.items():
            if not math.isfinite(value):
                self.note(f"a {name} of {value:g} is left out")
                continue
            numbers[name] = round(min(max(float(value), 0.0), 1.0), 4)
            if not 0 <= value <= 1:
                self.note(f"a {name} of {value:g} is clipped to 0 to 1")
        if not numbers and normal is None and orm is None:
            return None
        return Finish(**numbers, normal=normal, orm=orm)

    def normal(self, image: Image.Image | None, scale: Any = 1.0) -> Texture | None:
        """A map of normals, its slopes times `scale`; None, with a note, if it cannot be decoded."""
        if image is None:
            return None
        if (factor := _number(scale)) is None or not abs(factor) <= _STEEPEST:
            self.note(f"the scale {scale} of a normal map is left out")
            factor = 1.0

        def make() -> Image.Image:
            if factor == 1:
                return image
            values = np.asarray(image.convert("RGB"), np.float64) / 127.5 - 1
            values[..., :2] *= factor
            values /= np.maximum(np.linalg.norm(values, axis=-1, keepdims=True), 1e-6)
            return Image.fromarray(np.rint((values + 1) * 127.5).clip(0, 255).astype(np.uint8))

        return self._texture((image,), ("normal", factor), make)

    def orm(self, roughness: Image.Image | None, metallic: Image.Image | None) -> Texture | None:
        """Both in one map: green of the one, or its grey, and blue of the other; None if there is none.

        What has no map is white, so that its number holds.
        """
        images = [each for each in (roughness, metallic) if each is not None]
        if not images:
            return None

        def make() -> Image.Image:
            size = max((each.size for each in images), key=math.prod)
            white = Image.new("L", size, 255)
            channels = [white]
            for image, channel in ((roughness, "G"), (metallic, "B")):
                if image is None:
                    channels.append(white)
                    continue
                plain = image.convert("RGB").getchannel(channel)
                channels.append(plain if plain.size == size else plain.resize(size))
            return Image.merge("RGB", channels)

        return self._texture((roughness, metallic), ("orm",), make)

    def _texture(
        self, images: tuple[Any, ...], what: tuple[Any, ...], make: Callable[[], Image.Image]
    ) -> Texture | None:
        key = (*what, *map(id, images))
        if key not in self._known:
            try:
                texture = Texture.of(make(), self.max_side)
            except (AssetError, OSError, ValueError, SyntaxError, MemoryError) as error:
                reason = (
                    error.given
                    if isinstance(error, AssetError)
                    else f"an image that cannot be decoded ({error})"
                )
                self.note(f"a map of its material is left out: {reason}")
                texture = None
            # The images are kept, so that no other has their id.
            self._known[key] = images, texture
        return self._known[key][1]

    def _map(self, image: Any, use: Json, what: str) -> Image.Image | None:
        """The image of a map of glTF, if it lies where the colours' image does."""
        if not isinstance(image, Image.Image):
            return None
        if use.get("texCoord", 0) != 0:
            self.note(f"a {what} wants other texture coordinates than the first: it is left out")
            return None
        if "KHR_texture_transform" in object_of(use, "extensions"):
            self.note(f"a {what} is transformed (KHR_texture_transform): that is ignored")
        return image

    def _transmission(self, record: Json) -> float:
        said = object_of(object_of(record, "extensions"), TRANSMISSION)
        share = _number(said.get("transmissionFactor", 0.0))
        if share is None:
            self.note("a transmission that is no number is left out")
            return 0.0
        if share and "transmissionTexture" in said:
            self.note("a map of transmission is not kept: its surface is opaque")
            return 0.0
        return share

    def _open(self, key: str, words: list[str], open_image: Open) -> Image.Image | None:
        try:
            return open_image(" ".join(words))
        except AssetError as error:
            self.note(f"{key} is left out: {error.given}")
            return None


def with_exponents(text: bytes) -> bytes:
    """An MTL text whose `Ns` are exponents: Blender, which names itself, writes 1000 (1 - roughness)^2."""
    if not _BY_BLENDER.search(text):
        return text

    def exponent(line: re.Match[bytes]) -> bytes:
        try:
            roughness = 1 - math.sqrt(float(line[2]) / 1000)
        except ValueError:
            return line[0]
        return line[1] + b"%.6g" % (2 / min(max(roughness, 0.01), 1.0) ** 4 - 2)

    return _EXPONENT.sub(exponent, text)


def mtl_alpha(said: Mapping[str, Any]) -> float:
    """The alpha of MTL's `d`, or of `Tr` between 0 and 1, which at its ends means opaque to some and clear to
    others; 1 where they say nothing.
    """
    if (opacity := _number(said.get("d"))) is not None and math.isfinite(opacity):
        return opacity
    clear = _number(said.get("tr"))
    return 1 - clear if clear is not None and 0 < clear < 1 else 1.0


def seen_through(
    rgba: tuple[float, float, float, float], finish: Finish | None
) -> tuple[float, float, float, float]:
    """The colour with an alpha that shows glass as such, where its file says it by transmission alone."""
    if finish is None or rgba[3] < 1:
        return rgba
    share = finish.transmission * (1 - finish.metallic)
    return (*rgba[:3], round(1 - (1 - _GLASS) * share, 4))


def is_normal_map(image: Image.Image) -> bool:
    """Whether an image's colours are normals of length 1 that point outwards, not heights."""
    try:
        small = image.convert("RGB")
    except (OSError, ValueError, SyntaxError, MemoryError):
        # Whoever decodes it for good reports that.
        return True
    small.thumbnail((_SIDE, _SIDE), Image.Resampling.BOX)
    values = np.asarray(small, np.float64) / 127.5 - 1
    is_normal = np.abs(np.linalg.norm(values, axis=-1) - 1) < _UNIT
    # Of greys all three are equal.
    is_outwards = values[..., 2] > values[..., :2].max(-1) + _BLUER
    return bool((is_normal & is_outwards).mean() > _MOST)


def _phong_roughness(said: Mapping[str, Any]) -> float | None:
    """The roughness of MTL's `Ks` and `Ns`; None if they say nothing of it."""
    highlights = np.atleast_1d(np.array(said.get("ks", [1.0]), np.float64))
    illum = _number(said.get("illum"))
    if illum in _NO_HIGHLIGHTS or not highlights.any():
        return 1.0 if "ks" in said or "ns" in said else None
    exponent = _number(said.get("ns"))
    if exponent is None or not exponent >= 0:
        return exponent
    return float((2 / (exponent + 2)) ** 0.25)


def _number(value: Any) -> float | None:
    """The first of some words, or a number; None where there is none."""
    words = value if isinstance(value, list | tuple) else [value]
    try:
        return float(words[0])
    except (TypeError, ValueError, IndexError, OverflowError):
        return None
