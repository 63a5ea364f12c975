"""Colours at the vertices of surfaces as an image: each triangle has its own place in it.

A place is a small square of pixels, a corner of the triangle in the middle of each of three of its corner
pixels. Colours between the corners follow the triangle's plane on the whole square, so that an image which
is drawn smoothly shows them exactly. Triangles of like colours share a place, and places of like colours lie
near one another, so that the image may be shrunk as drawing programs do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from PIL import Image
from scipy.spatial import cKDTree

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.texture import Texture

_SIDE = 8
"""Pixels a side of a place, at most."""
_PULL = 1 / 6
"""How far a sample of a triangle's corner lies on the way to its middle."""
_BITS = 8


def bake_colours(pieces: Sequence[Piece], max_side: int) -> tuple[Piece, ...]:
    """The pieces, those with colours at their vertices with one image of these between them instead.

    Args:
      max_side: pixels that the image may have a side. Where it has not a pixel for each triangle, those of
        nearly the same colour share one.
    """
    coloured = [piece for piece in pieces if piece.colours is not None]
    if not coloured:
        return tuple(pieces)
    corners = np.concatenate([_corner_colours(piece) for piece in coloured])
    kinds, index = _distinct(corners.reshape(len(corners), -1))
    side = _place_side(len(kinds), max_side)
    if side < 2:
        corners = np.broadcast_to(_mean(corners, 1)[:, None], corners.shape)
        kinds, index = _few_enough(corners.reshape(len(corners), -1), max_side)
        side = _place_side(len(kinds), max_side)
    texture, spots, uv = _lay_out(_squares(kinds.reshape(-1, 3, 3), side), index)
    out: list[Piece] = []
    start = 0
    for piece in pieces:
        if piece.colours is None:
            out.append(piece)
            continue
        stop = start + len(piece.mesh.faces)
        plain = replace(piece, colours=None, baked_side=max_side)
        out.append(_with_image(plain, piece.mesh, spots[start:stop], uv, texture))
        start = stop
    return tuple(out)


def bake_again(piece: Piece, mesh: Mesh) -> Piece:
    """A piece whose image was baked, with `mesh` in place of its own and a new image of the same colours.

    Args:
      mesh: lies where the piece's own lay, of fewer triangles.
    """
    assert piece.uv is not None
    assert piece.texture is not None
    side = _place_side(len(mesh.faces), piece.baked_side)
    weights = _weights(max(side, 1))
    spots = np.einsum("tk,fkd->ftd", weights, mesh.corners)
    colours = _colours_near(piece, spots.reshape(-1, 3)).reshape(len(mesh.faces), -1)
    kinds, index = _distinct(colours)
    if side < 1:
        kinds, index = _few_enough(colours, piece.baked_side)
    side = max(side, 1)
    texture, spots, uv = _lay_out(kinds.reshape(-1, side, side, 3), index)
    return _with_image(piece, mesh, spots, uv, texture)


def _corner_colours(piece: Piece) -> np.ndarray:
    """u8[F, 3, 3]: the colour at each corner of each triangle."""
    assert piece.colours is not None
    return piece.colours[piece.mesh.faces]


def _distinct(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of u8[N, D] each row once, those of like mean colours near one another; i64[N], the place of each."""
    packed = np.ascontiguousarray(rows).view(np.dtype((np.void, rows.shape[1]))).ravel()
    _, first, index = np.unique(packed, return_index=True, return_inverse=True)
    kinds = rows[first]
    order = np.argsort(_curve(_mean(kinds.reshape(len(kinds), -1, 3), 1), _BITS), kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    return kinds[order], place[index.reshape(-1)]


def _few_enough(rows: np.ndarray, max_side: int) -> tuple[np.ndarray, np.ndarray]:
    """As `_distinct`, with colours in ever coarser steps until an image of that side has a pixel for each."""
    for step in range(_BITS + 1):
        coarse = ((rows.astype(np.int64) >> step) << step) + ((1 << step) >> 1)
        kinds, index = _distinct(np.minimum(coarse, 255).astype(np.uint8))
        if _place_side(len(kinds), max_side) >= 1:
            break
    return kinds, index


def _place_side(count: int, max_side: int) -> int:
    """Pixels a side of each of so many places in an image of that side; 0 if they are too many."""
    return min(_SIDE, max_side // _num_columns(count))


def _num_columns(count: int) -> int:
    """A power of two whose square is at least `count`."""
    return 1 << -(-(count - 1).bit_length() // 2)


def _squares(corners: np.ndarray, side: int) -> np.ndarray:
    """u8[P, side, side, 3]: squares whose colours follow the planes through three corners' u8[P, 3, 3]."""
    steps = np.linspace(0, 1, side) if side > 1 else np.zeros(1)
    across, down = np.meshgrid(steps, steps)
    weights = np.stack([1 - across - down, across, down], -1)
    colours = np.einsum("yxk,pkc->pyxc", weights, corners.astype(float))
    return np.clip(np.rint(colours), 0, 255).astype(np.uint8)


def _weights(side: int) -> np.ndarray:
    """f64[side * side, 3]: for each pixel of a place, the point of the triangle whose colour it shows.

    Beyond the triangle's longest side it is the point of this side that lies next on the way to the corner.
    """
    if side == 1:
        return np.full((1, 3), 1 / 3)
    steps = np.linspace(0, 1, side)
    across, down = (each.ravel() for each in np.meshgrid(steps, steps))
    beyond = np.maximum(across + down, 1)
    across = across / beyond
    down = down / beyond
    return np.stack([1 - across - down, across, down], -1)


def _lay_out(squares: np.ndarray, index: np.ndarray) -> tuple[Texture, np.ndarray, np.ndarray]:
    """The image of squares, and where triangles lie in it.

    Args:
      squares: u8[P, S, S, 3], along a curve on which like colours are near one another.
      index: i64[F], the square of each triangle.

    Returns:
      The image; i64[F, 3], the spot of each corner; and f32[N, 2], the uv of each spot.
    """
    count, side = squares.shape[:2]
    columns = _num_columns(count)
    x, y = _uncurve(np.arange(columns**2))
    rows = int(y[:count].max()) + 1
    pixels = np.empty((columns, columns, side, side, 3), np.uint8)
    pixels[y, x] = squares[np.minimum(np.arange(columns**2), count - 1)]
    image = pixels[:rows].transpose(0, 2, 1, 3, 4).reshape(rows * side, columns * side, 3)
    corners = 0.5 + (side - 1) * np.array([[0, 0], [1, 0], [0, 1]])
    is_even = (squares == squares[:, :1, :1]).reshape(count, -1).all(1)
    inside = np.where(is_even[:, None, None], side / 2, corners)
    at = (np.stack([x, y], -1)[:count, None] * side + inside) / (columns * side, rows * side)
    uv = (at * [1, -1] + [0, 1]).reshape(-1, 2).astype(np.float32)
    # Of a square of one colour one spot does for all corners.
    spots = 3 * index[:, None] + np.where(is_even[index][:, None], 0, np.arange(3))
    return Texture.of(Image.fromarray(image), columns * side), spots, uv


def _with_image(
    piece: Piece, mesh: Mesh, spots: np.ndarray, uv: np.ndarray, texture: Texture
) -> Piece:
    """The piece with another mesh and an image; spots, i64[F, 3], say which of f32[N, 2] each corner has."""
    keys = mesh.faces.astype(np.int64) * len(uv) + spots
    _, first, inverse = np.unique(keys.ravel(), return_index=True, return_inverse=True)
    return replace(
        piece,
        mesh=Mesh(mesh.vertices[mesh.faces.ravel()[first]], inverse.reshape(-1, 3)),
        uv=uv[spots.ravel()[first]],
        texture=texture,
    )


def _colours_near(piece: Piece, points: np.ndarray) -> np.ndarray:
    """u8[N, 3]: the colours of a piece's image next to points f64[N, 3]."""
    assert piece.uv is not None
    assert piece.texture is not None
    weights = np.concatenate([(1 - _PULL) * np.eye(3) + _PULL / 3, np.full((1, 3), 1 / 3)])
    spots = np.einsum("sk,fkd->fsd", weights, piece.mesh.corners).reshape(-1, 3)
    uv = np.einsum("sk,fkd->fsd", weights, piece.uv[piece.mesh.faces].astype(float)).reshape(-1, 2)
    nearest = cKDTree(spots).query(points)[1]
    return np.rint(255 * piece.texture.at(uv[nearest])).astype(np.uint8)


def _mean(colours: np.ndarray, axis: int) -> np.ndarray:
    return np.rint(colours.mean(axis)).astype(np.uint8)


def _curve(values: np.ndarray, bits: int) -> np.ndarray:
    """i64[N]: places of i[N, D] on a curve through all of them that leaves near ones near (Morton's)."""
    values = values.astype(np.int64)
    out = np.zeros(len(values), np.int64)
    for bit in range(bits):
        for axis in range(values.shape[1]):
            out |= ((values[:, axis] >> bit) & 1) << (bit * values.shape[1] + axis)
    return out


def _uncurve(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """i64[N] twice: the points (x, y) at places of such a curve in the plane."""
    x = np.zeros_like(places)
    y = np.zeros_like(places)
    for bit in range(32):
        x |= ((places >> (2 * bit)) & 1) << bit
        y |= ((places >> (2 * bit + 1)) & 1) << bit
    return x, y
