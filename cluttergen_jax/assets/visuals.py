"""Visual surfaces: colours at vertices as an image, and one piece per colour or image, of few triangles.

Each triangle has its own place in the image: a small square of pixels, a corner of the triangle in the middle
of each of three of its corner pixels. Colours between the corners follow the triangle's plane on the whole
square, so that an image which is drawn smoothly shows them exactly. Triangles of like colours share a place,
and places of like colours lie near one another, so that the image may be shrunk as drawing programs do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import fast_simplification
import numpy as np
import trimesh
from PIL import Image
from scipy.spatial import cKDTree

from cluttergen_jax.assets.mesh import UV_DIGITS, Mesh, clean_mesh, join_meshes, unique_rows, weld
from cluttergen_jax.assets.shape import Piece, Texture

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
    across, down = np.meshgrid(*2 * [np.linspace(0, 1, side)])
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
    corners = spots.ravel()
    return _with_corners(piece, mesh, uv[corners], corners, texture)


def _with_corners(
    piece: Piece, mesh: Mesh, uv: np.ndarray, key: np.ndarray, texture: Texture | None
) -> Piece:
    """The piece with another mesh and an image; corners of one vertex and one key become one vertex again.

    Args:
      uv: f32[3 F, 2], of each corner; key: [3 F, ...], by which corners are told apart.
    """
    owner = mesh.faces.ravel()
    first, index = unique_rows(owner, key)
    joined = Mesh(mesh.vertices[owner[first]], index.reshape(-1, 3))
    return replace(piece, mesh=joined, uv=uv[first], texture=texture)


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


_NEAR = 16
"""Triangles among which the nearest is looked for."""
_STRETCH = 3.0
"""Times the stretch of the image at a triangle's middle by which it may be stretched up to a corner."""


def transfer_texture(piece: Piece, mesh: Mesh) -> Piece:
    """A piece with images on `mesh` instead of its own, each corner's uv taken from the nearest old place.

    The image is cut along seams, and what lies beyond a seam is elsewhere in the image. So the place of a new
    triangle's middle is found first, and its corners' places are taken only where the image runs on from
    there; elsewhere it is continued as it lies on the old triangle in the middle.
    """
    assert piece.uv is not None
    old = piece.mesh
    uv = piece.uv.astype(np.float64)
    tree = cKDTree(old.vertices[old.faces].mean(1))
    corners = mesh.corners
    middle = corners.mean(1)
    places, away, owner = _candidates(old, uv, tree, middle)
    best = np.argmin(away, axis=1)
    row = np.arange(len(middle))
    start = places[row, best]
    triangle = owner[row, best]
    stretch = _STRETCH * _scale(old, uv)[triangle]
    found = np.empty((len(middle), 3, 2))
    for k in range(3):
        places, away, _ = _candidates(old, uv, tree, corners[:, k])
        step = np.linalg.norm(places - start[:, None], axis=2)
        runs_on = step <= (stretch * np.linalg.norm(corners[:, k] - middle, axis=1))[:, None] + 1e-6
        best = np.argmin(np.where(runs_on, away, np.inf), axis=1)
        continued = _places(old, uv, triangle, corners[:, k])
        found[:, k] = np.where(runs_on.any(1)[:, None], places[row, best], continued)
    places = found.reshape(-1, 2)
    key = np.round(places, UV_DIGITS)
    return _with_corners(piece, mesh, places.astype(np.float32), key, piece.texture)


def _candidates(
    mesh: Mesh, uv: np.ndarray, tree: cKDTree, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each of P points the nearest places on C triangles near it.

    Returns:
      f64[P, C, 2], their uv; f64[P, C], how far they are, metres; i[P, C], the triangles.
    """
    near = tree.query(points, min(_NEAR, len(mesh.faces)))[1].reshape(len(points), -1)
    triangles = mesh.vertices[mesh.faces[near.ravel()]]
    targets = np.repeat(points, near.shape[1], axis=0)
    closest = trimesh.triangles.closest_point(triangles, targets)
    places = _places(mesh, uv, near.ravel(), closest)
    away = np.linalg.norm(closest - targets, axis=1)
    return places.reshape(*near.shape, 2), away.reshape(near.shape), near


def _scale(mesh: Mesh, uv: np.ndarray) -> np.ndarray:
    """f64[F]: the most that the image moves on a triangle, in uv for each metre."""
    corners = mesh.corners
    places = uv[mesh.faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    steps = np.linalg.norm(places - np.roll(places, 1, axis=1), axis=2)
    return (steps / np.maximum(sides, 1e-9)).max(1)


def _places(mesh: Mesh, uv: np.ndarray, triangle: np.ndarray, points: np.ndarray) -> np.ndarray:
    """f64[P, 2]: uv at points in the planes of triangles i[P], beyond their edges as if they went on."""
    faces = mesh.faces[triangle]
    weights = trimesh.triangles.points_to_barycentric(mesh.vertices[faces], points)
    weights = np.where(np.isfinite(weights).all(1)[:, None], weights, 1 / 3)
    return np.asarray((uv[faces] * weights[..., None]).sum(1))


MAX_TRIANGLES = 6000
MAX_TEXTURED = 20000
"""Triangles with images: they cost more to simplify, and what is seen is the image."""
_COLOUR_STEPS = 32


def simplify_pieces(pieces: Sequence[Piece], max_textured: int = MAX_TEXTURED) -> tuple[Piece, ...]:
    """Pieces of like colour, image and finish joined, welded and simplified.

    To about 6,000 triangles in all without an image, and `max_textured` in all with one. Sheets are given
    their second side later, which can double their number.
    """
    groups: dict[tuple[object, ...], list[Piece]] = {}
    for piece in pieces:
        colour = tuple(round(c * _COLOUR_STEPS) for c in piece.rgba)
        groups.setdefault((piece.texture, piece.finish, *colour), []).append(piece)
    merged = [_merge(group) for group in groups.values()]
    merged = [piece for piece in merged if len(piece.mesh.faces)]
    plain = sum(len(piece.mesh.faces) for piece in merged if piece.uv is None)
    textured = sum(len(piece.mesh.faces) for piece in merged) - plain
    out = []
    for piece in merged:
        if piece.uv is None:
            small = _simplify(piece.mesh, min(1.0, MAX_TRIANGLES / plain))
            out.append(replace(piece, mesh=small))
        else:
            out.append(_simplify_textured(piece, min(1.0, max_textured / textured)))
    return tuple(out)


def _merge(group: Sequence[Piece]) -> Piece:
    mesh = join_meshes([each.mesh for each in group])
    uvs = [each.uv for each in group if each.uv is not None]
    if not uvs:
        return replace(group[0], mesh=clean_mesh(mesh))
    uv = np.concatenate(uvs)
    small, kept = weld(mesh, uv)
    return replace(group[0], mesh=small, uv=uv[kept])


def _simplify(mesh: Mesh, share: float) -> Mesh:
    target = int(share * len(mesh.faces))
    if share >= 1 or target < 12:
        return mesh
    points, faces = fast_simplification.simplify(
        np.ascontiguousarray(mesh.vertices, np.float32),
        np.ascontiguousarray(mesh.faces, np.int32),
        target_count=target,
    )
    small = clean_mesh(Mesh(points, faces))
    return small if len(small.faces) else mesh


def _simplify_textured(piece: Piece, share: float) -> Piece:
    """Simplified without regard to the image, which is then laid over the new triangles again."""
    if share >= 1:
        return piece
    whole = clean_mesh(piece.mesh)
    small = _simplify(whole, share * len(piece.mesh.faces) / len(whole.faces))
    if small is whole:
        return piece
    return bake_again(piece, small) if piece.baked_side else transfer_texture(piece, small)
