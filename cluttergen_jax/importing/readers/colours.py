"""Colours at the vertices of a surface: whether they differ, and OBJ texts that have them."""

from __future__ import annotations

import re

import numpy as np

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
