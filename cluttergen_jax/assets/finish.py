"""Finishes: what a surface's file says of it beside its colour, in the terms of glTF's metallic-roughness."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated

import msgspec
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from cluttergen_jax.assets.shape import Texture

_LARGEST_EXPONENT = 128.0
"""That of OpenGL, which MuJoCo's shininess of 1 stands for."""
_SHARPEST = 1000.0
"""The largest exponent of MTL."""


@dataclass(frozen=True)
class Finish:
    """How a surface reflects light and lets it through.

    The defaults are those of exports for a surface of which nothing is known.

    Attributes:
      roughness: from 0, a mirror, to 1, matte; its square is the width of the distribution of microfacets.
      metallic: from 0 to 1, a bare metal, whose reflections have its colour.
      transmission: from 0 to 1, the share of the light that passes through, as through clear glass.
      normal: a map of normals in tangent space: red is along u, green along v, blue outwards, as in OpenGL
        and glTF. Its values are no colours: they are linear.
      orm: roughness in green and metallic in blue, by which the numbers are multiplied; red is 255. Linear.
    """

    roughness: float = 0.65
    metallic: float = 0.0
    transmission: float = 0.0
    normal: Texture | None = None
    orm: Texture | None = None

    def __post_init__(self) -> None:
        numbers = (self.roughness, self.metallic, self.transmission)
        # A number that is NaN compares as no.
        if not all(0 <= each <= 1 for each in numbers):
            raise ValueError(f"a finish of {numbers}, which are not from 0 to 1")

    @property
    def images(self) -> tuple[Texture, ...]:
        """Its maps."""
        return tuple(each for each in (self.normal, self.orm) if each is not None)

    @cached_property
    def without_maps(self) -> Finish:
        """The finish for what reads no maps: its numbers times the means of their map."""
        if self.orm is None:
            return replace(self, normal=None)
        _, roughness, metallic = (np.asarray(self.orm.image).mean((0, 1)) / 255).round(4).tolist()
        return Finish(self.roughness * roughness, self.metallic * metallic, self.transmission)

    @property
    def specular(self) -> float:
        """How strong OpenGL draws highlights, from 0 to 1: none if matte, most of a polished metal."""
        mean = self.without_maps
        return round(0.5 * (1 + mean.metallic) * (1 - mean.roughness), 6)

    @property
    def exponent(self) -> float:
        """How small highlights are: the exponent of Blinn's model for this roughness; Ns in MTL."""
        return round(min(2 / max(self.without_maps.roughness, 0.01) ** 4 - 2, _SHARPEST), 4)

    @property
    def shininess(self) -> float:
        """The same for OpenGL, from 0 to 1."""
        return round(min(self.exponent / _LARGEST_EXPONENT, 1.0), 6)

    def to_record(self) -> StoredFinish:
        """As it is kept in files."""
        mean = self.without_maps
        return StoredFinish(
            float(self.roughness),
            float(self.metallic),
            float(self.transmission) or None,
            None if self.normal is None else self.normal.digest,
            None if self.orm is None else self.orm.digest,
            None if self.orm is None else (mean.roughness, mean.metallic),
        )


_Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
_Digest = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]


class StoredFinish(msgspec.Struct, omit_defaults=True):
    """A finish as records hold it.

    Attributes:
      transmission: None for 0; normal, orm: SHA-256 of the maps' files.
      mean: roughness and metallic times the means of `orm`, for readers that decode no images.
    """

    roughness: _Share
    metallic: _Share
    transmission: _Share | None = None
    normal: _Digest | None = None
    orm: _Digest | None = None
    mean: tuple[_Share, _Share] | None = None

    def finish(self, image_of: Callable[[str], Texture]) -> Finish:
        """The finish; `image_of` reads the image of a digest."""
        return Finish(
            self.roughness,
            self.metallic,
            self.transmission or 0.0,
            None if self.normal is None else image_of(self.normal),
            None if self.orm is None else image_of(self.orm),
        )
