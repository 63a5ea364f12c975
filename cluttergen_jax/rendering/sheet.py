"""Finished pictures put together: sheets, captions, rings and frames; and on disk. Needs no OpenGL."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import file_whole

_GAP = 8
_CAPTION_HEIGHT = 24
_FRAME = 5
_PAPER = (255, 255, 255)
_INK = (40, 44, 52)


def contact_sheet(
    images: Sequence[np.ndarray], captions: Sequence[str] | None = None, columns: int = 4
) -> np.ndarray:
    """Lays images out in rows, each with a caption beneath it.

    Args:
      images: uint8[H, W, 3] each; cells are as large as the largest, smaller ones are centred.
      captions: one per image, cut to the cell's width; None leaves no room for any.
      columns: images in a row, at most.

    Returns:
      uint8[rows * (H + gap [+ caption]) + gap, columns * (W + gap) + gap, 3].

    Raises:
      ConfigError: no images, no columns, or not one caption per image.
    """
    if len(images) == 0 or columns < 1 or (captions is not None and len(captions) != len(images)):
        count = "no" if captions is None else len(captions)
        raise ConfigError(
            f"a sheet of {len(images)} images, {count} captions, {columns} columns",
            "at least one image and one column, and a caption for every image or none at all",
        )
    columns = min(columns, len(images))
    rows = -(-len(images) // columns)
    height = max(image.shape[0] for image in images)
    width = max(image.shape[1] for image in images)
    step_y = height + _GAP + (_CAPTION_HEIGHT if captions is not None else 0)
    step_x = width + _GAP
    sheet = Image.new("RGB", (columns * step_x + _GAP, rows * step_y + _GAP), _PAPER)
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(size=14)
    for index, image in enumerate(images):
        left = _GAP + index % columns * step_x
        upper = _GAP + index // columns * step_y
        inset = ((width - image.shape[1]) // 2, (height - image.shape[0]) // 2)
        sheet.paste(
            Image.fromarray(np.asarray(image, np.uint8)), (left + inset[0], upper + inset[1])
        )
        if captions is not None:
            text = captions[index]
            while len(text) > 1 and draw.textlength(text, font=font) > width:
                text = text[:-2].rstrip() + "\N{HORIZONTAL ELLIPSIS}"
            middle = (left + width // 2, upper + height + _CAPTION_HEIGHT // 2)
            draw.text(middle, text, fill=_INK, font=font, anchor="mm")
    return np.asarray(sheet)


def save_png(image: np.ndarray, path: str | os.PathLike[str]) -> Path:
    """Writes uint8[H, W, 3] as a PNG; the file appears whole or not at all. Folders are made as needed."""
    with file_whole(path) as fresh:
        Image.fromarray(np.ascontiguousarray(image)).save(fresh, format="PNG")
    return Path(path)


_FINE = 4
"""Drawn so many times larger, then reduced."""


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


def with_frame(image: np.ndarray, rgb: tuple[float, float, float]) -> np.ndarray:
    """uint8[H, W, 3]: the picture with a frame over its edge."""
    framed = np.empty_like(image)
    framed[:] = _bytes(rgb)
    inside = slice(_FRAME, -_FRAME)
    framed[inside, inside] = image[inside, inside]
    return framed


def _bytes(rgb: tuple[float, float, float]) -> tuple[int, int, int]:
    red, green, blue = (round(255 * value) for value in rgb)
    return red, green, blue
