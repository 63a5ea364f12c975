"""Supports as a look draws them: a block as a table with legs or a cabinet, in wood, marble or cloth.

Only what is seen changes. A support with surfaces of its own keeps them, and collision stays what it is.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import lru_cache

import numpy as np
from PIL import Image

from cluttergen_jax.assets.finish import Finish
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece, Texture
from cluttergen_jax.assets.support import Box, SupportAsset
from cluttergen_jax.errors import AssetError
from cluttergen_jax.geometry import yaw_matrix
from cluttergen_jax.rendering.look import Covering, Look
from cluttergen_jax.rendering.surfaces import KINDS, draw_surface, on_white

# Metres.
_LOWEST_TABLE = 0.3
_BOARD = 0.036
_APRON = 0.07
_LEG = 0.055
_INSET = 0.03
_PLINTH = 0.08
_GAP = 0.004
_BEVEL = 0.003
_WHITE = (1.0, 1.0, 1.0, 1.0)


@lru_cache(32)
def covering_texture(covering: Covering) -> Texture:
    """The image of a covering, drawn or read.

    Raises:
      AssetError: its file holds no image.
    """
    if covering.of in KINDS:
        pixels = draw_surface(covering.of, covering.colours, covering.seed)
        return Texture.of(Image.fromarray(pixels), fast=True)
    try:
        with Image.open(covering.of) as image:
            return Texture.of(on_white(image))
    except (AssetError, OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise AssetError(f"{covering.of}, an image that cannot be decoded ({error})") from error


def furnish(support: SupportAsset, look: Look | None) -> SupportAsset:
    """The support with surfaces of a look; as it is without a look, or if it has surfaces of its own."""
    if look is None or support.pieces or not (support.boxes or support.parts):
        return support
    box = support.boxes[0] if support.boxes else None
    is_block = box is not None and len(support.boxes) == 1 and not support.parts
    if box is not None and is_block and _is_table(box) and look.table != "block":
        pieces = _table(box, look) if look.table == "legs" else _cabinet(box, look)
    else:
        meshes = [each.mesh for each in support.boxes] + [each.hull() for each in support.parts]
        pieces = [_cover(mesh, look.top) for mesh in meshes]
    return replace(support, pieces=tuple(pieces))


def _is_table(box: Box) -> bool:
    """Whether a box stands on the floor and is as high as a table."""
    return box.top >= _LOWEST_TABLE and abs(box.center[2] - box.half_extents[2]) < 0.01


def _table(box: Box, look: Look) -> list[Piece]:
    """A board, an apron around what is under it, and four legs."""
    x, y, _ = box.half_extents
    top = box.top
    leg = min(_LEG, x / 3, y / 3)
    inset = min(_INSET, leg / 2)
    under = top - _BOARD
    pieces = [_part(box, (-x, -y, under), (x, y, top), look.top)]
    for side in (-1, 1):
        edge_x = sorted((side * (x - inset - 0.012), side * (x - inset - 0.034)))
        edge_y = sorted((side * (y - inset - 0.012), side * (y - inset - 0.034)))
        run_x = x - inset - leg
        run_y = y - inset - leg
        low = under - _APRON
        pieces.append(_part(box, (edge_x[0], -run_y, low), (edge_x[1], run_y, under), look.frame))
        pieces.append(_part(box, (-run_x, edge_y[0], low), (run_x, edge_y[1], under), look.frame))
        for other in (-1, 1):
            near = np.array([side * (x - inset), other * (y - inset)])
            far = near - leg * np.array([side, other])
            low_corner = (*np.minimum(near, far), 0.0)
            high_corner = (*np.maximum(near, far), under)
            pieces.append(_part(box, low_corner, high_corner, look.frame, upright=True))
    return pieces


def _cabinet(box: Box, look: Look) -> list[Piece]:
    """A board on a body with doors on all sides, and a plinth."""
    x, y, _ = box.half_extents
    top = box.top
    under = top - _BOARD
    inset = min(0.02, x / 10, y / 10)
    body_x = x - inset - 0.018
    body_y = y - inset - 0.018
    pieces = [
        _part(box, (-x, -y, under), (x, y, top), look.top),
        _part(box, (-body_x, -body_y, _PLINTH), (body_x, body_y, under), look.frame),
        _part(
            box,
            (0.04 - body_x, 0.04 - body_y, 0.0),
            (body_x - 0.04, body_y - 0.04, _PLINTH),
            look.frame,
        ),
    ]
    for side in (-1, 1):
        for low, high in _doors(body_y):
            near = sorted((side * body_x, side * (body_x + 0.018)))
            corners = (near[0], low, _PLINTH + _GAP), (near[1], high, under - _GAP)
            pieces.append(_part(box, *corners, look.frame, upright=True))
        for low, high in _doors(body_x):
            near = sorted((side * body_y, side * (body_y + 0.018)))
            corners = (low, near[0], _PLINTH + _GAP), (high, near[1], under - _GAP)
            pieces.append(_part(box, *corners, look.frame, upright=True))
    return pieces


def _doors(half: float) -> list[tuple[float, float]]:
    """From where to where each of the doors reaches that fill a side, metres from its middle."""
    number = max(1, round(2 * half / 0.45))
    edges = np.linspace(-half, half, number + 1)
    return [(low + _GAP / 2, high - _GAP / 2) for low, high in itertools.pairwise(edges)]


def _part(
    box: Box,
    low: tuple[float, ...],
    high: tuple[float, ...],
    covering: Covering,
    upright: bool = False,
) -> Piece:
    """A board between two corners f[3] in a box's plan frame, its edges broken a little.

    Args:
      upright: its fibres run upwards, not along its longer side.
    """
    lower = np.array(low, np.float64)
    upper = np.array(high, np.float64)
    bevel = min(_BEVEL, *(np.ptp([lower, upper], axis=0) / 4))
    points = []
    for corner in np.stack(np.meshgrid(*[(0, 1)] * 3, indexing="ij"), -1).reshape(-1, 3):
        outer = np.where(corner == 1, upper, lower)
        inner = np.where(corner == 1, upper - bevel, lower + bevel)
        for axis in range(3):
            point = inner.copy()
            point[axis] = outer[axis]
            points.append(point)
    body = Mesh.points(np.array(points)).hull()
    size = upper - lower
    along = 2 if upright else int(size[1] > size[0])
    piece = _cover(body, covering, along)
    middle = np.array([*box.center[:2], 0.0])
    return piece.transform(yaw_matrix(box.yaw), middle)


def _cover(mesh: Mesh, covering: Covering, along: int = 0) -> Piece:
    """A surface with a covering's image laid on it from the six sides.

    Args:
      along: the axis along which its fibres run where they can.
    """
    corners = mesh.corners.reshape(-1, 3)
    side = np.repeat(np.abs(mesh.normals).argmax(1), 3)
    outward = np.repeat(mesh.normals, 3, axis=0)
    uv = np.empty((len(corners), 2))
    for axis in range(3):
        others = [each for each in range(3) if each != axis]
        if others[1] == along:
            others.reverse()
        mine = side == axis
        uv[mine] = corners[mine][:, others] / covering.tile
        # Seen from outside, an image is not mirrored.
        is_right_handed = (others[1] - others[0]) % 3 == 1
        is_mirrored = mine & ((outward[:, axis] > 0) != is_right_handed)
        uv[is_mirrored, 0] *= -1
    faces = np.arange(len(corners)).reshape(-1, 3)
    return Piece(
        Mesh(corners, faces),
        _WHITE,
        uv.astype(np.float32),
        covering_texture(covering),
        finish=Finish(covering.roughness, covering.metallic),
    )
