"""A slab with a picture on it, in every format that can carry one: each corner has its own colour."""


import numpy as np
import trimesh
from PIL import Image

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.texture import Texture

SIZE = (0.12, 0.10, 0.03)
"""Metres."""
QUADRANTS = {(-1, 1): (220, 30, 30), (1, 1): (30, 200, 30), (-1, -1): (30, 30, 220), (1, -1): (230, 210, 20)}
"""The colour over each quarter of the top, by the signs of x and y: the image's upper left is at -x, +y."""


def picture(side=64):
    """The image: four colours, and grey in a strip below them for the other faces."""
    pixels = np.zeros((side, side, 3), np.uint8)
    half = side // 2
    for (x, y), colour in QUADRANTS.items():
        rows = slice(0, half) if y > 0 else slice(half, side)
        pixels[rows, slice(half, side) if x > 0 else slice(0, half)] = colour
    return Image.fromarray(pixels)




def slab():
    """f64[V, 3], i[F, 3], f64[V, 2]: a box, each face with vertices of its own; v runs up the image.

    The picture is seen upright on the top, with x to the right and y up; the other faces show one place each.
    """
    box = trimesh.creation.box(SIZE)
    vertices = box.vertices[box.faces].reshape(-1, 3)
    faces = np.arange(len(vertices)).reshape(-1, 3)
    uv = vertices[:, :2] / SIZE[:2] + 0.5
    is_top = np.repeat(box.face_normals[:, 2] > 0.5, 3)
    return vertices, faces, np.where(is_top[:, None], uv, [0.25, 0.75])


def colour_at(piece, x, y):
    """u8[3]: what a piece of the slab shows at a place of its top, by its own uv and image."""
    triangles = piece.mesh.vertices[piece.mesh.faces]
    is_top = (triangles[..., 2] > triangles[..., 2].max() - 1e-4).all(1)
    for face, corners in zip(piece.mesh.faces[is_top], triangles[is_top], strict=True):
        weights = np.linalg.solve(np.vstack([corners[:, :2].T, np.ones(3)]), [x, y, 1.0])
        if weights.min() >= -1e-9:
            shown = piece.texture.at((weights @ piece.uv[face])[None])[0] * piece.rgba[:3]
            return tuple(np.round(255 * shown).astype(int).tolist())
    raise AssertionError("no triangle of the top is there")


def quarters():
    """The middle of each quarter of the top, x and y in metres, and the colour that belongs there."""
    return [((x * SIZE[0] / 4, y * SIZE[1] / 4), colour) for (x, y), colour in QUADRANTS.items()]














def piece():
    """The slab as a reader hands it on."""
    vertices, faces, uv = slab()
    return Piece(Mesh(vertices, faces), (1.0, 1.0, 1.0, 1.0), uv, Texture.of(picture()))






def assert_upright(piece, factor=1.0):
    """Each quarter of the slab's top has the colour that belongs there."""
    for (x, y), colour in quarters():
        np.testing.assert_allclose(colour_at(piece, x, y), np.array(colour) * factor, atol=3)
