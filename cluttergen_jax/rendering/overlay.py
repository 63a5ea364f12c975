"""Rings, numbers and captions drawn over a finished picture, with smooth edges. Needs no OpenGL."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

_FINE = 4
"""Drawn so many times larger, then reduced."""
_INK = (40, 44, 52)


@dataclass(frozen=True)
class Ring:
    """An ellipse around something in a picture.

    Attributes:
      center: pixels from the upper left corner.
      radii: pixels.
      rgb: each in [0, 1].
      label: a word or two in a disc on the ring's upper right, or nothing.
    """

    center: tuple[float, float]
    radii: tuple[float, float]
    rgb: tuple[float, float, float]
    label: str = ""


def ring_around(
    pixels: np.ndarray, rgb: tuple[float, float, float], label: str, room: float
) -> Ring:
    """The upright ellipse around points f[P, 2] of a picture, `room` pixels away from them.

    It has the shape of the points' box and is as large as it takes to hold them all.
    """
    low = pixels.min(0)
    high = pixels.max(0)
    center = (low + high) / 2
    half = np.maximum((high - low) / 2, 1.0)
    # A ring much thinner than long is hard to see as one.
    half = np.maximum(half, half.max() * 0.45)
    reach = np.linalg.norm((pixels - center) / half, axis=1).max()
    radii = half * reach + room
    return Ring(
        (float(center[0]), float(center[1])), (float(radii[0]), float(radii[1])), rgb, label
    )


def with_rings(image: np.ndarray, rings: Sequence[Ring]) -> np.ndarray:
    """uint8[H, W, 3]: the picture with rings over it; later ones lie on top."""
    height, width, _ = image.shape
    layer = Image.new("RGBA", (width * _FINE, height * _FINE), (255, 255, 255, 0))
    draw = ImageDraw.Draw(layer)
    line = max(2.0, height / 240) * _FINE
    for ring in rings:
        center = np.array(ring.center) * _FINE
        radii = np.array(ring.radii) * _FINE
        box = [*(center - radii), *(center + radii)]
        draw.ellipse(box, outline=(255, 255, 255, 150), width=round(line * 1.8))
        inner = [box[0] + line * 0.4, box[1] + line * 0.4, box[2] - line * 0.4, box[3] - line * 0.4]
        draw.ellipse(inner, outline=(*_bytes(ring.rgb), 255), width=round(line))
    for ring in rings:
        if ring.label:
            _add_label(draw, ring, height)
    small = layer.resize((width, height), Image.Resampling.BOX)
    return np.asarray(
        Image.alpha_composite(Image.fromarray(image).convert("RGBA"), small).convert("RGB")
    )


def _add_label(draw: ImageDraw.ImageDraw, ring: Ring, height: int) -> None:
    font = ImageFont.load_default(size=height / 32 * _FINE)
    at = np.array(ring.center) + np.array(ring.radii) * [0.7071, -0.7071]
    x, y = at * _FINE
    left, top, right, bottom = draw.textbbox((x, y), ring.label, font=font, anchor="mm")
    room = height / 90 * _FINE
    radius = (bottom - top) / 2 + room
    wide = max((right - left) / 2 + room, radius)
    box = (x - wide, y - radius, x + wide, y + radius)
    draw.rounded_rectangle(
        box, radius, fill=(*_bytes(ring.rgb), 255), outline=(255, 255, 255, 255), width=_FINE * 2
    )
    draw.text((x, y), ring.label, fill=(255, 255, 255, 255), font=font, anchor="mm")


def with_caption(
    image: np.ndarray, text: str, rgb: tuple[float, float, float] | None = None
) -> np.ndarray:
    """uint8[H, W, 3]: the picture with a line of text at its lower left; `rgb` colours a dot before it."""
    if not text:
        return image
    height, width, _ = image.shape
    size = max(11.0, height / 30) * _FINE
    # All of it grows with the letters; on a narrow picture they are as large as it takes to fit.
    needed = 4.2 * size + ImageFont.load_default(size=size).getlength(text)
    size *= min(1.0, width * _FINE / needed)
    font = ImageFont.load_default(size=size)
    strip = Image.new("RGBA", (width * _FINE, round(3.2 * size)), (255, 255, 255, 0))
    draw = ImageDraw.Draw(strip)
    left = size
    middle = strip.height / 2
    room = 0.55 * size
    dot = 0.36 * size if rgb is not None else 0.0
    start = left + room + 2.8 * dot
    end = start + draw.textlength(text, font=font) + room
    box = (left, middle - 0.95 * size, end, middle + 0.95 * size)
    draw.rounded_rectangle(box, 0.95 * size, fill=(255, 255, 255, 225))
    if rgb is not None:
        x = left + room + dot
        draw.ellipse((x - dot, middle - dot, x + dot, middle + dot), fill=(*_bytes(rgb), 255))
    draw.text((start, middle), text, fill=_INK, font=font, anchor="lm")
    small = strip.resize((width, strip.height // _FINE), Image.Resampling.BOX)
    picture = Image.fromarray(image).convert("RGBA")
    picture.alpha_composite(small, (0, height - small.height))
    return np.asarray(picture.convert("RGB"))


def with_frame(image: np.ndarray, rgb: tuple[float, float, float], width: int = 5) -> np.ndarray:
    """uint8[H, W, 3]: the picture with a frame over its edge, so many pixels wide."""
    framed = np.empty_like(image)
    framed[:] = _bytes(rgb)
    inside = (slice(width, -width), slice(width, -width))
    framed[inside] = image[inside]
    return framed


def _bytes(rgb: tuple[float, float, float]) -> tuple[int, int, int]:
    red, green, blue = (round(255 * value) for value in rgb)
    return red, green, blue
