"""Images side by side with captions, and images on disk. Needs no OpenGL."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import file_whole

_GAP = 8
_CAPTION_HEIGHT = 24
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
