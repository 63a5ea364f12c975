"""MJCF geoms as meshes in the world frame, with the colours and pictures that MuJoCo's renderer gives them.

Pictures are laid on as uv of one image:

- A mesh with texture coordinates keeps its own: MuJoCo 3.17 multiplies them by `texrepeat`, versions up to
  3.10, for which most files were written, do not. Without, a picture of type 2d is seen from above (z), and
  one of type cube from the middle of the mesh.
- On other shapes a picture of type 2d is laid on each face of a box, around a cylinder, a capsule and a
  sphere, and on both disks of a cylinder; one of type cube is seen from the middle.
- `texrepeat` holds for type 2d alone; with `texuniform` it counts by the metre, else by the shape.
- A picture of type 2d whose file says that it is sRGB is drawn darker, as MuJoCo takes it for light itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
from PIL import Image

from cluttergen_jax.assets.cloud import sample_surface
from cluttergen_jax.assets.config import MAX_TEXTURE
from cluttergen_jax.assets.deviation import is_within_parts
from cluttergen_jax.assets.mesh import Mesh, join_meshes
from cluttergen_jax.assets.parts import sound_points
from cluttergen_jax.assets.shape import Piece, Texture
from cluttergen_jax.errors import AssetError, first_names
from cluttergen_jax.importing.readers import primitives

_GEOM = mujoco.mjtGeom
_CLOSE = 1e-6
"""Share of an edge that is not cut off at its end."""
_ERROR = 0.02
"""Of the image's side: what a place in the middle of an edge may be away from where it belongs."""
_PASSES = 5
_MOST = 20_000
"""Triangles of which none is made finer."""
# OpenGL's rule: the sides +x, -x, +y, -y, +z, -z, and for each, which coordinates run to the right in its
# image and down, and their signs.
_ACROSS = np.array([2, 2, 0, 0, 0, 0]), np.array([-1, 1, 1, 1, 1, -1])
_DOWN = np.array([1, 1, 2, 2, 1, 1]), np.array([-1, -1, 1, -1, -1, -1])


def one_image(sides: np.ndarray) -> np.ndarray:
    """u8[H, W, 3]: the only picture of u8[6, w, w, 3] if all are equal, else all six in two rows."""
    if (sides == sides[0]).all():
        return sides[0]
    width = sides.shape[1]
    rows = sides.reshape(2, 3, width, width, 3).transpose(0, 2, 1, 3, 4)
    return rows.reshape(2 * width, 3 * width, 3)


def wrap_cube_map(
    mesh: Mesh, directions: np.ndarray, is_one: bool, width: int
) -> tuple[Mesh, np.ndarray]:
    """The mesh, each triangle with vertices of its own and on one side of the cube, and their uv.

    Neighbours are cut at the same places, so that what was closed stays closed.

    Args:
      directions: f64[V, 3], where from the middle of the cube each vertex is seen; linear on every triangle.
      is_one: whether `one_image` has one picture for all sides.
      width: pixels of one side; half a pixel at its rim is left out, so that no colour comes from beyond it.

    Returns:
      The mesh, and f64[3 F, 2].
    """
    points = np.hstack([mesh.vertices, directions])
    faces = mesh.faces.astype(np.int64)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        for sign in (-1, 1):
            points, faces = _cut(points, faces, _at_plane(a, b, sign))
    for _ in range(_PASSES):
        before = len(faces)
        points, faces = _cut(points, faces, _middle_of_bent) if before < _MOST else (points, faces)
        if len(faces) == before:
            break
    corners = points[faces]
    side = np.repeat(_side(corners[..., 3:].mean(1)), 3)
    places = 0.5 / width + (1 - 1 / width) * _places(corners[..., 3:].reshape(-1, 3), side).clip(
        0, 1
    )
    if not is_one:
        places = (places + np.column_stack([side % 3, side // 3])) / [3, 2]
    return Mesh(corners[..., :3].reshape(-1, 3), np.arange(len(side))), places * [1, -1] + [0, 1]


def _side(directions: np.ndarray) -> np.ndarray:
    """i64[N]: on which of the six sides f64[N, 3] are seen."""
    axis = np.abs(directions).argmax(1)
    return 2 * axis + (np.take_along_axis(directions, axis[:, None], 1)[:, 0] < 0)


def _places(directions: np.ndarray, side: np.ndarray) -> np.ndarray:
    """f64[N, 2]: to the right and down in the pictures of the sides i64[N], each from 0 to 1."""
    row = np.arange(len(side))
    away = np.maximum(np.abs(directions[row, side // 2]), 1e-12)
    across, down = (
        sign[side] * directions[row, axis[side]] / away for axis, sign in (_ACROSS, _DOWN)
    )
    return (np.column_stack([across, down]) + 1) / 2


def _at_plane(a: int, b: int, sign: int) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Where edges cross the plane on which the directions' coordinates a and b are equal, or opposite."""

    def share(start: np.ndarray, end: np.ndarray) -> np.ndarray:
        first, last = (ends[:, 3 + a] + sign * ends[:, 3 + b] for ends in (start, end))
        crosses = first * last < 0
        at = np.divide(first, first - last, out=np.zeros(len(first)), where=crosses)
        return np.where((at > _CLOSE) & (at < 1 - _CLOSE), at, np.nan)

    return share


def _middle_of_bent(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The middle of edges along which the image does not run evenly."""
    middle = (start[:, 3:] + end[:, 3:]) / 2
    side = _side(middle)
    first, between, last = (_places(each, side) for each in (start[:, 3:], middle, end[:, 3:]))
    is_bent = np.abs(between - (first + last) / 2).max(1) > _ERROR
    return np.where(is_bent, 0.5, np.nan)


def _cut(
    points: np.ndarray, faces: np.ndarray, share: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Triangles cut at their edges.

    Args:
      points: f64[V, D].
      faces: i64[F, 3].
      share: of the points at both ends of edges, f64[E, D] each: where between them they are cut, NaN where
        not.
    """
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1), axis=-1).reshape(-1, 2)
    edges, which = np.unique(ends @ [len(points), 1], return_inverse=True)
    start = points[edges // len(points)]
    end = points[edges % len(points)]
    at = share(start, end)[:, None]
    is_cut = np.isfinite(at[:, 0])
    made = np.where(is_cut, len(points) + np.cumsum(is_cut) - 1, -1)
    added = (start + at * (end - start))[is_cut]
    return np.concatenate([points, added]), _pieces(faces, made[which.reshape(-1, 3)])


def _pieces(faces: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """Triangles i64[F, 3] cut at points i64[F, 3] on the edges behind each corner, -1 where there is none."""
    is_cut = middles >= 0
    count = is_cut.sum(1)
    # Turned so that of one cut edge it is the first, and of two they are the first two.
    first = np.where(count == 2, is_cut.argmin(1) + 1, is_cut.argmax(1))
    turn = (first[:, None] + np.arange(3)) % 3
    corners = np.hstack([np.take_along_axis(each, turn, 1) for each in (faces, middles)])
    # Names of corners: 0, 1, 2, and 3, 4, 5 the points on the edges behind them.
    patterns = [
        [(0, 1, 2)],
        [(0, 3, 2), (3, 1, 2)],
        [(3, 1, 4), (0, 3, 4), (0, 4, 2)],
        [(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)],
    ]
    return np.concatenate(
        [
            corners[count == n][:, np.array(pattern)].reshape(-1, 3)
            for n, pattern in enumerate(patterns)
        ]
    )


_RGB = mujoco.mjtTextureRole.mjTEXROLE_RGB
_PROJECTED = (_GEOM.mjGEOM_MESH, _GEOM.mjGEOM_SDF, _GEOM.mjGEOM_HFIELD)
_DISK = 0.9
"""Cosine between z and a triangle's normal above which it belongs to a cylinder's disk."""
_SHOWN = np.arange(256) / 255
_AS_LIGHT = np.round(
    255 * np.where(_SHOWN <= 0.04045, _SHOWN / 12.92, ((_SHOWN + 0.055) / 1.055) ** 2.4)
).astype(np.uint8)
"""What sRGB says of each value of 8 bits."""


def picture_id(model: mujoco.MjModel, geom: int) -> int:
    """The picture of a geom's material that gives its colours; -1 if there is none that MuJoCo can draw."""
    material = int(model.geom_matid[geom])
    index = int(model.mat_texid[material, _RGB]) if material >= 0 else -1
    return index if index >= 0 and model.tex_nchannel[index] >= 3 else -1


def flat_colour(model: mujoco.MjModel, picture: int) -> np.ndarray | None:
    """f64[3], in [0, 1]: the colour of a picture that has one alone; None if it has several."""
    pixels = _pixels(model, picture).reshape(-1, 3)
    return pixels[0] / 255 if (pixels == pixels[0]).all() else None


def picture_notes(model: mujoco.MjModel, geoms: Iterable[int]) -> Iterator[str]:
    """Where the look of geoms is not what their files alone let one expect."""
    for geom in geoms:
        if (picture := picture_id(model, geom)) < 0:
            continue
        name = model.texture(picture).name
        material = int(model.geom_matid[geom])
        if _is_darker(model, picture):
            yield f"its image {name!r} is marked as sRGB: it is as dark as MuJoCo draws it"
        if not _has_own_places(model, geom):
            continue
        if not _is_2d(model, picture):
            yield f"its image {name!r} is a cube map on texture coordinates: not drawn, as in MuJoCo"
        elif model.mat_texuniform[material] or (model.mat_texrepeat[material] != 1).any():
            yield "its texture coordinates are taken as they are, without texrepeat"


def with_picture(
    model: mujoco.MjModel, geom: int, mesh: Mesh, picture: int, max_side: int
) -> tuple[Mesh, np.ndarray, Texture] | None:
    """A geom's surface with its picture.

    Args:
      mesh: the surface in the geom's own frame.
      max_side: pixels; larger images are shrunk.

    Returns:
      The same surface, each triangle with vertices of its own; f64[V, 2], their uv; the image. None for a
      cube map on a mesh that has texture coordinates: MuJoCo does not draw it.
    """
    pixels = _pixels(model, picture)
    is_mapped = _has_own_places(model, geom)
    if _is_2d(model, picture):
        corners = Mesh(mesh.vertices[mesh.faces.ravel()], np.arange(3 * len(mesh.faces)))
        places = _own_places(model, geom) if is_mapped else _flat_places(model, geom, corners)
        return corners, places * [1, -1] + [0, 1], _texture(pixels, max_side)
    if is_mapped:
        return None
    width = pixels.shape[1]
    image = one_image(np.broadcast_to(pixels.reshape(-1, width, width, 3), (6, width, width, 3)))
    is_one = image.shape[1] == width
    side = min(width, max_side if is_one else max_side // 3)
    mesh, uv = wrap_cube_map(mesh, _directions(model, geom, mesh.vertices), is_one, side)
    return mesh, uv, _texture(image, max_side)


def _texture(pixels: np.ndarray, max_side: int) -> Texture:
    """The image, made once for all geoms of an object."""
    height, width, _ = pixels.shape
    return _encode(pixels.tobytes(), (width, height), max_side)


@lru_cache(maxsize=4)
def _encode(data: bytes, size: tuple[int, int], max_side: int) -> Texture:
    return Texture.of(Image.frombytes("RGB", size, data), max_side)


def geom_kind(model: mujoco.MjModel, geom: int) -> mujoco.mjtGeom:
    """A geom's type, as a member of the enum: the model's own integers are not found `in` a tuple of them."""
    return _GEOM(int(model.geom_type[geom]))


def _is_2d(model: mujoco.MjModel, picture: int) -> bool:
    return bool(model.tex_type[picture] == mujoco.mjtTexture.mjTEXTURE_2D)


def _is_darker(model: mujoco.MjModel, picture: int) -> bool:
    """Whether MuJoCo turns the picture's colours into amounts of light, which it then shows as they are."""
    is_marked = model.tex_colorspace[picture] == mujoco.mjtColorSpace.mjCOLORSPACE_SRGB
    return _is_2d(model, picture) and bool(is_marked)


def _has_own_places(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a geom is a mesh with texture coordinates."""
    is_mesh = geom_kind(model, geom) == _GEOM.mjGEOM_MESH
    return is_mesh and bool(model.mesh_texcoordnum[model.geom_dataid[geom]] > 0)


def _pixels(model: mujoco.MjModel, picture: int) -> np.ndarray:
    """u8[H, W, 3]; of a cube map with six pictures one below the other, H = 6 W."""
    height, width, channels = (
        int(of[picture]) for of in (model.tex_height, model.tex_width, model.tex_nchannel)
    )
    start = int(model.tex_adr[picture])
    pixels = model.tex_data[start : start + height * width * channels].reshape(
        height, width, channels
    )
    pixels = np.ascontiguousarray(pixels[..., :3])
    return _AS_LIGHT[pixels] if _is_darker(model, picture) else pixels


def _own_places(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """f64[3 F, 2]: a mesh's own texture coordinates, to the right and down.

    A vertex may have another place in the image in each triangle.
    """
    mesh = int(model.geom_dataid[geom])
    first = model.mesh_faceadr[mesh]
    count = model.mesh_facenum[mesh]
    start = model.mesh_texcoordadr[mesh]
    number = model.mesh_texcoordnum[mesh]
    places = model.mesh_texcoord[start : start + number]
    return np.asarray(places[model.mesh_facetexcoord[first : first + count].ravel()], np.float64)


def _size(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """f64[3]: half of what a geom measures, of a capsule without its ends."""
    x, y, z = (float(each) for each in model.geom_size[geom])
    if geom_kind(model, geom) == _GEOM.mjGEOM_SPHERE:
        return np.full(3, x)
    return np.array(
        [x, x, y]
        if geom_kind(model, geom) in (_GEOM.mjGEOM_CYLINDER, _GEOM.mjGEOM_CAPSULE)
        else [x, y, z]
    )


def _flat_places(model: mujoco.MjModel, geom: int, corners: Mesh) -> np.ndarray:
    """f64[3 F, 2]: where MuJoCo lays the corners of triangles in a picture of type 2d, right and down."""
    material = int(model.geom_matid[geom])
    size = _size(model, geom)
    kind = geom_kind(model, geom)
    repeat = np.array(model.mat_texrepeat[material], np.float64)
    if model.mat_texuniform[material]:
        repeat = repeat * size[:2]
    unit = corners.vertices / size
    if kind in _PROJECTED:
        return unit[:, :2] * repeat * [0.5, -0.5] - 0.5
    normals = np.repeat(corners.normals / corners.areas[:, None], 3, axis=0)
    places = _on_box(unit, normals) if kind == _GEOM.mjGEOM_BOX else _around(unit, kind, size)
    if kind == _GEOM.mjGEOM_CYLINDER:
        places = np.where(np.abs(normals[:, 2:]) > _DISK, (unit[:, :2] + 1) / 2, places)
    return places * repeat


def _on_box(unit: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """f64[N, 2]: on each face of a box from -1 to 1 the two axes in it, x before y before z, z up."""
    across = np.array([1, 0, 0])[np.abs(normals).argmax(1)]
    up = np.array([2, 2, 1])[np.abs(normals).argmax(1)]
    row = np.arange(len(unit))
    return np.column_stack([1 + unit[row, across], 1 - unit[row, up]]) / 2


def _around(unit: np.ndarray, kind: mujoco.mjtGeom, size: np.ndarray) -> np.ndarray:
    """f64[3 F, 2]: the angle about z, and from the top down the height, or of a ball the angle."""
    turn = np.mod(np.arctan2(unit[:, 1], unit[:, 0]) / (2 * np.pi), 1.0).reshape(-1, 3)
    turn = np.where(turn.max(1, keepdims=True) - turn > 0.5, turn + 1, turn)
    # A pole has no angle of its own: it lies between the other two corners.
    is_pole = np.hypot(unit[:, 0], unit[:, 1]).reshape(-1, 3) < 1e-6
    others = np.where(is_pole, np.nan, turn)
    turn = np.where(is_pole, np.nanmean(others, axis=1, keepdims=True), turn)
    if kind == _GEOM.mjGEOM_CYLINDER:
        down = (1 - unit[:, 2]) / 2
    elif kind == _GEOM.mjGEOM_CAPSULE:
        down = _down_a_capsule(unit[:, 2], size)
    else:
        down = 0.5 - np.arcsin(unit[:, 2].clip(-1, 1)) / np.pi
    return np.column_stack([turn.ravel(), down])


def _down_a_capsule(height: np.ndarray, size: np.ndarray) -> np.ndarray:
    """f64[3 F]: the picture comes three times: on the cylinder, from 1 to -1, and on each end."""
    middle = np.repeat(height.reshape(-1, 3).mean(1), 3)
    lift = np.arcsin((((np.abs(height) - 1) * size[2]) / size[0]).clip(0, 1)) / (np.pi / 2)
    return np.where(middle > 1, 1 - lift, np.where(middle < -1, lift, (1 - height) / 2))


def _directions(model: mujoco.MjModel, geom: int, points: np.ndarray) -> np.ndarray:
    """f64[V, 3]: where MuJoCo sees the points of a geom from the middle of a cube map."""
    size = _size(model, geom)
    kind = geom_kind(model, geom)
    is_uniform = bool(model.mat_texuniform[int(model.geom_matid[geom])])
    if kind in _PROJECTED:
        return points * size if is_uniform else points
    unit = points / size
    if kind == _GEOM.mjGEOM_CAPSULE:
        beyond = np.maximum(np.abs(points[:, 2]) - size[2], 0) / size[0]
        unit[:, 2] = np.sign(unit[:, 2]) * (np.minimum(np.abs(unit[:, 2]), 1) + beyond)
    return unit * size if is_uniform else unit


_FARTHEST = 1e6
"""Metres; beyond, the arithmetic of hulls breaks down."""
# What MuJoCo takes for "no colour given": a material's colour holds then.
_DEFAULT_RGBA = np.array([0.5, 0.5, 0.5, 1.0], np.float32)


def is_plane(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a geom is a plane: of the kinds that a file can hold, the one without an inside."""
    return geom_kind(model, geom) == _GEOM.mjGEOM_PLANE


def is_convex(model: mujoco.MjModel, geom: int) -> bool:
    """Whether MuJoCo collides a geom as a convex body: a mesh counts as its hull."""
    return geom_kind(model, geom) not in (_GEOM.mjGEOM_PLANE, _GEOM.mjGEOM_HFIELD, _GEOM.mjGEOM_SDF)


def geom_rgba(model: mujoco.MjModel, geom: int) -> tuple[float, float, float, float]:
    """The colour that MuJoCo draws a geom in: its own if it has one, else its material's."""
    material = int(model.geom_matid[geom])
    own = model.geom_rgba[geom]
    is_given = material < 0 or not np.array_equal(own, _DEFAULT_RGBA)
    r, g, b, a = own if is_given else model.mat_rgba[material]
    return (float(r), float(g), float(b), float(a))


def geom_piece(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, max_side: int = MAX_TEXTURE
) -> Piece:
    """The geom's surface in the world frame, with its colour, and its picture as MuJoCo lays it on.

    What is asked for although its alpha is 0, because nothing else is seen, is drawn opaque.
    """
    r, g, b, alpha = geom_rgba(model, geom)
    colour = (r, g, b, alpha or 1.0)
    picture = picture_id(model, geom)
    if picture < 0:
        return Piece(geom_mesh(model, data, geom), colour)
    if (flat := flat_colour(model, picture)) is not None:
        r, g, b = (flat * colour[:3]).tolist()
        return Piece(geom_mesh(model, data, geom), (r, g, b, colour[3]))
    if (found := with_picture(model, geom, _own_mesh(model, geom), picture, max_side)) is None:
        return Piece(geom_mesh(model, data, geom), colour)
    mesh, uv, texture = found
    return Piece(_place(model, data, geom, mesh), colour, uv, texture)


def geom_mesh(model: mujoco.MjModel, data: mujoco.MjData, geom: int, sections: int = 32) -> Mesh:
    """The geom's surface in the world frame of the reference configuration.

    Raises:
      AssetError: it is a plane, or out of all bounds.
    """
    return _place(model, data, geom, _own_mesh(model, geom, sections))


def _own_mesh(model: mujoco.MjModel, geom: int, sections: int = 32) -> Mesh:
    """The geom's surface in its own frame."""
    size = model.geom_size[geom]
    data_id = int(model.geom_dataid[geom])
    kind = geom_kind(model, geom)
    if kind in (_GEOM.mjGEOM_MESH, _GEOM.mjGEOM_SDF):
        # Of an SDF, MuJoCo makes a mesh when it compiles the file.
        return _mesh_asset(model, data_id)
    if kind == _GEOM.mjGEOM_HFIELD:
        return _height_field(model, data_id)
    if kind == _GEOM.mjGEOM_BOX:
        return primitives.box(size)
    if kind == _GEOM.mjGEOM_CYLINDER:
        return primitives.cylinder(size[0], size[1], sections)
    if kind == _GEOM.mjGEOM_CAPSULE:
        return primitives.capsule(size[0], size[1])
    if kind == _GEOM.mjGEOM_ELLIPSOID:
        return primitives.ellipsoid(size)
    if kind == _GEOM.mjGEOM_SPHERE:
        return primitives.ellipsoid(np.full(3, size[0]))
    raise AssetError(f"a geom of type {kind.name}", "geoms with an inside: all kinds but planes")


def _place(model: mujoco.MjModel, data: mujoco.MjData, geom: int, mesh: Mesh) -> Mesh:
    """A mesh in the geom's frame, in the world frame; AssetError where that is out of all bounds."""
    mesh = mesh.transform(data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom])
    # A number that is NaN compares as no.
    if not (np.abs(mesh.vertices) <= _FARTHEST).all():
        name = model.geom(geom).name or f"number {geom}"
        raise AssetError(
            f"geom {name!r} reaches beyond {_FARTHEST:,.0f} m, or is nowhere", "sizes in metres"
        )
    return mesh


def _mesh_asset(model: mujoco.MjModel, mesh: int) -> Mesh:
    first = model.mesh_vertadr[mesh]
    count = model.mesh_vertnum[mesh]
    first_face = model.mesh_faceadr[mesh]
    face_count = model.mesh_facenum[mesh]
    faces = model.mesh_face[first_face : first_face + face_count]
    return Mesh(model.mesh_vert[first : first + count], faces)


def _height_field(model: mujoco.MjModel, field: int) -> Mesh:
    rows = int(model.hfield_nrow[field])
    columns = int(model.hfield_ncol[field])
    start = int(model.hfield_adr[field])
    heights = model.hfield_data[start : start + rows * columns].reshape(rows, columns)
    half_x, half_y, highest, base = (float(each) for each in model.hfield_size[field])
    return primitives.height_field(heights * highest, half_x, half_y, base)


_NUM_SEEN_GROUPS = 3
# What a geom stands in for fills its volume to this share at least, and ends nowhere sooner than it by more
# than this share of its size.
_FILLED = 1 / 3
_BEYOND = 0.05
_NUM_POINTS = 256
_MOST_NAMES = 5


@dataclass(frozen=True)
class Roles:
    """What the geoms of a body are there for.

    Attributes:
      surface: the geoms that are the object to the eye; empty if nothing is seen or collides.
      colliding: the geoms that collide, some of them perhaps surface as well.
      notes: what was decided, in words.
      unseen: the geoms that neither are seen nor collide.
    """

    surface: tuple[int, ...]
    colliding: tuple[int, ...]
    notes: tuple[str, ...] = ()
    unseen: tuple[int, ...] = ()


def roles_of(model: mujoco.MjModel, data: mujoco.MjData, geoms: Iterable[int]) -> Roles:
    """The roles of one body's geoms, as they stand in `data`; planes have none."""
    geoms = list(geoms)
    solid = [i for i in geoms if not is_plane(model, i)]
    colliding = [i for i in solid if collides(model, i)]
    others = [i for i in solid if i not in colliding]
    shown = [i for i in others if is_visible(model, i)]
    shown_colliding = [i for i in colliding if is_visible(model, i)]
    stand_ins = _find_stand_ins(model, data, shown_colliding, shown)
    surface = [i for i in solid if i in shown or (i in shown_colliding and i not in stand_ins)]
    unseen = tuple(i for i in others if i not in shown)
    reasons = {
        "left out, as planes have no inside": [i for i in geoms if i not in solid],
        "left out, as they are not seen and do not collide": unseen,
        "taken for collision alone, as what is seen covers them": stand_ins,
        "taken for the surface, as nothing else is there to be seen": [] if surface else colliding,
    }
    notes = tuple(f"{reason}: {_names(model, which)}" for reason, which in reasons.items() if which)
    return Roles(tuple(surface or colliding), tuple(colliding), notes, unseen)


def is_visible(model: mujoco.MjModel, geom: int) -> bool:
    """Whether MuJoCo draws a geom if nobody asks for other groups."""
    return int(model.geom_group[geom]) < _NUM_SEEN_GROUPS and geom_rgba(model, geom)[3] > 0


def collides(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a geom can touch another, by its bits or because a pair names it."""
    is_paired = bool((model.pair_geom1 == geom).any() or (model.pair_geom2 == geom).any())
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom]) or is_paired


def _find_stand_ins(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: Sequence[int], shown: Sequence[int]
) -> list[int]:
    """Those of `geoms` that stand in for what is shown: it fills a third of them, and reaches as far.

    A sticker fills nothing of its carton, and what a glass holds ends below its rim.
    """
    if not (geoms and shown):
        return []
    others = [_convex(model, data, i) for i in shown]
    lower, upper = join_meshes(others).bounds
    reach = _BEYOND * float(np.linalg.norm(upper - lower))
    covered = []
    for geom in geoms:
        mesh = _convex(model, data, geom)
        ends = (mesh.bounds[0] > lower - reach) & (mesh.bounds[1] < upper + reach)
        if (
            ends.all()
            and is_within_parts(_inner_points(mesh), [each.vertices for each in others]).mean()
            >= _FILLED
        ):
            covered.append(geom)
    return covered


def _convex(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> Mesh:
    """A geom's hull; what is flat is given a thickness."""
    return Mesh.points(sound_points(geom_mesh(model, data, geom, 16).vertices)).hull()


def _inner_points(hull: Mesh) -> np.ndarray:
    """f64[256, 3]: points spread through a convex body."""
    center = hull.vertices.mean(0)
    depth = np.random.default_rng(0).uniform(size=(_NUM_POINTS, 1)) ** (1 / 3)
    return center + depth * (sample_surface(hull, _NUM_POINTS, 0) - center)


def _names(model: mujoco.MjModel, geoms: Sequence[int]) -> str:
    """The first few geoms by their names, or else by their kinds."""
    names = []
    for geom in geoms:
        kind = geom_kind(model, geom).name.removeprefix("mjGEOM_").lower()
        name = model.geom(geom).name
        names.append(repr(name) if name else f"a {kind}")
    return first_names(names, _MOST_NAMES, ", {} more")
