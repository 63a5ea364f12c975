"""An image that is laid over a surface: PNG bytes, 8 bits, red, green and blue."""

from __future__ import annotations

import hashlib
import io
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from PIL import Image

from cluttergen_jax.assets.config import MAX_TEXTURE
from cluttergen_jax.errors import AssetError


@dataclass(frozen=True)
class Texture:
    """An image for surfaces. Textures of equal bytes are equal.

    Attributes:
      data: a PNG file, RGB, 8 bits a channel, as shown (sRGB).
    """

    data: bytes

    @staticmethod
    def of(image: Image.Image, max_side: int = MAX_TEXTURE) -> Texture:
        """The image, shrunk until no side is longer than `max_side` pixels; transparency is dropped.

        Raises:
          AssetError: its file is broken.
        """
        try:
            # A JPEG file can be read at a fraction of its size.
            image.draft("RGB", (max_side, max_side))
            pixels = image.convert("RGB")
        except (
            OSError,
            ValueError,
            SyntaxError,
            MemoryError,
            Image.DecompressionBombError,
        ) as error:
            raise AssetError(f"an image that cannot be decoded ({error})") from error
        pixels.thumbnail((max_side, max_side), Image.Resampling.LANCZOS)
        buffer = io.BytesIO()
        pixels.save(buffer, "PNG")
        return Texture(buffer.getvalue())

    @cached_property
    def digest(self) -> str:
        """Hex SHA-256 of the file."""
        return hashlib.sha256(self.data).hexdigest()

    @property
    def file_name(self) -> str:
        """What it is called wherever it is stored: equal images have equal names."""
        return texture_name(self.digest)

    @cached_property
    def image(self) -> Image.Image:
        """The image, decoded; not to be changed.

        Raises:
          ValueError: the bytes are no PNG image.
        """
        try:
            image = Image.open(io.BytesIO(self.data), formats=["PNG"])
            return image.convert("RGB")
        except (OSError, SyntaxError, MemoryError, Image.DecompressionBombError) as error:
            raise ValueError(f"a texture that is no PNG image ({error})") from error

    def at(self, uv: np.ndarray) -> np.ndarray:
        """f64[N, 3], in [0, 1]: the nearest pixel's colour at f[N, 2]; the image is repeated beyond [0, 1].

        (0, 0) is the lower left corner of the image, (1, 1) the upper right one.
        """
        pixels = np.asarray(self.image)
        height, width = pixels.shape[:2]
        u, v = np.mod(np.asarray(uv, np.float64), 1.0).T
        x = np.minimum((u * width).astype(int), width - 1)
        y = np.minimum(((1 - v) * height).astype(int), height - 1)
        return pixels[y, x] / 255.0


def texture_name(digest: str) -> str:
    """The file name of the image whose bytes have that SHA-256."""
    return f"texture-{digest[:12]}.png"
