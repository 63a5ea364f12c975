"""MJCF bodies: compiled by MuJoCo, geoms turned into meshes that look as its renderer draws them.

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

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

from cluttergen_jax.assets.cloud import sample_surface
from cluttergen_jax.assets.config import MAX_TEXTURE
from cluttergen_jax.assets.deviation import is_within_parts
from cluttergen_jax.assets.finish import Finish
from cluttergen_jax.assets.mass import MassProperties, combine_masses
from cluttergen_jax.assets.mesh import Mesh, join_meshes
from cluttergen_jax.assets.parts import sound_points
from cluttergen_jax.assets.shape import Joint, Piece, Texture
from cluttergen_jax.errors import AssetError, first_names
from cluttergen_jax.importing.readers import primitives
from cluttergen_jax.importing.readers.finishes import Finisher
from cluttergen_jax.importing.readers.mjcf_compile import NO_MASS, compile_with_notes, parse_mjcf
from cluttergen_jax.importing.readers.model import (
    MAX_PARTS,
    Model,
    alone_note,
    check_joints,
    frozen_note,
    opened_joint,
    sound_mass,
    unknown_body,
)
from cluttergen_jax.importing.readers.source import ObjectFile

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


_ROLE = mujoco.mjtTextureRole
_RGB = _ROLE.mjTEXROLE_RGB
_MAPS = (
    _ROLE.mjTEXROLE_NORMAL,
    _ROLE.mjTEXROLE_ORM,
    _ROLE.mjTEXROLE_ROUGHNESS,
    _ROLE.mjTEXROLE_METALLIC,
)
_PROJECTED = (_GEOM.mjGEOM_MESH, _GEOM.mjGEOM_SDF, _GEOM.mjGEOM_HFIELD)
_NOT_CONVEX = (_GEOM.mjGEOM_PLANE, _GEOM.mjGEOM_HFIELD, _GEOM.mjGEOM_SDF)
_ROUND = (_GEOM.mjGEOM_CYLINDER, _GEOM.mjGEOM_CAPSULE)
_DISK = 0.9
"""Cosine between z and a triangle's normal above which it belongs to a cylinder's disk."""
_SHOWN = np.arange(256) / 255
_AS_LIGHT = np.round(
    255 * np.where(_SHOWN <= 0.04045, _SHOWN / 12.92, ((_SHOWN + 0.055) / 1.055) ** 2.4)
).astype(np.uint8)
"""What sRGB says of each value of 8 bits."""
_FARTHEST = 1e6
"""Metres; beyond, the arithmetic of hulls breaks down."""
# What MuJoCo takes for "no colour given": a material's colour holds then.
_DEFAULT_RGBA = np.array([0.5, 0.5, 0.5, 1.0], np.float32)
_NUM_SEEN_GROUPS = 3


@dataclass(frozen=True, eq=False)
class _Picture:
    """A picture of a model that gives colours."""

    model: mujoco.MjModel
    index: int

    @property
    def is_2d(self) -> bool:
        return bool(self.model.tex_type[self.index] == mujoco.mjtTexture.mjTEXTURE_2D)

    @property
    def is_darker(self) -> bool:
        """Whether MuJoCo turns its colours into amounts of light, which it then shows as they are."""
        is_marked = self.model.tex_colorspace[self.index] == mujoco.mjtColorSpace.mjCOLORSPACE_SRGB
        return self.is_2d and bool(is_marked)

    @cached_property
    def pixels(self) -> np.ndarray:
        """u8[H, W, 3]; of a cube map with six pictures one below the other, H = 6 W."""
        of = self.model
        shape = [int(n[self.index]) for n in (of.tex_height, of.tex_width, of.tex_nchannel)]
        start = int(of.tex_adr[self.index])
        pixels = of.tex_data[start : start + math.prod(shape)].reshape(shape)
        pixels = np.ascontiguousarray(pixels[..., :3])
        return _AS_LIGHT[pixels] if self.is_darker else pixels

    @property
    def flat_colour(self) -> np.ndarray | None:
        """f64[3], in [0, 1]: its colour if it has one alone; None if it has several."""
        pixels = self.pixels.reshape(-1, 3)
        return pixels[0] / 255 if (pixels == pixels[0]).all() else None


@dataclass(frozen=True, eq=False)
class Geom:
    """A geom of a model, where `data` has it."""

    model: mujoco.MjModel
    data: mujoco.MjData
    index: int

    @cached_property
    def kind(self) -> mujoco.mjtGeom:
        """As a member of the enum: the model's own integers are not found `in` a tuple of them."""
        return _GEOM(int(self.model.geom_type[self.index]))

    @property
    def is_plane(self) -> bool:
        """Of the kinds that a file can hold, the one without an inside."""
        return self.kind == _GEOM.mjGEOM_PLANE

    @property
    def is_convex(self) -> bool:
        """Whether MuJoCo collides it as a convex body: a mesh counts as its hull."""
        return self.kind not in _NOT_CONVEX

    @property
    def is_visible(self) -> bool:
        """Whether MuJoCo draws it if nobody asks for other groups."""
        return int(self.model.geom_group[self.index]) < _NUM_SEEN_GROUPS and self.rgba[3] > 0

    @cached_property
    def collides(self) -> bool:
        """Whether it can touch another, by its bits or because a pair names it."""
        of = self.model
        is_paired = self.index in of.pair_geom1 or self.index in of.pair_geom2
        return bool(of.geom_contype[self.index] or of.geom_conaffinity[self.index]) or is_paired

    @property
    def rgba(self) -> tuple[float, float, float, float]:
        """The colour that MuJoCo draws it in: its own if it has one, else its material's."""
        own = self.model.geom_rgba[self.index]
        is_given = self._material < 0 or not np.array_equal(own, _DEFAULT_RGBA)
        r, g, b, a = (own if is_given else self.model.mat_rgba[self._material]).tolist()
        return (r, g, b, a)

    @property
    def called(self) -> str:
        """Its name, or else its kind."""
        kind = self.kind.name.removeprefix("mjGEOM_").lower()
        name = self.model.geom(self.index).name
        return repr(name) if name else f"a {kind}"

    def piece(self, max_side: int = MAX_TEXTURE) -> Piece:
        """Its surface in the world frame, with its colour, and its picture as MuJoCo lays it on.

        What is asked for although its alpha is 0, because nothing else is seen, is drawn opaque.
        """
        r, g, b, alpha = self.rgba
        colour = (r, g, b, alpha or 1.0)
        finish, _ = self._finish(max_side)
        picture = self._picture
        if picture is not None and (flat := picture.flat_colour) is not None:
            r, g, b = (flat * colour[:3]).tolist()
            colour = (r, g, b, colour[3])
            picture = None
        # MuJoCo draws no cube map on texture coordinates.
        if picture is not None and (picture.is_2d or not self._has_own_places):
            mesh, uv, texture = self._with_picture(picture, max_side)
            piece = Piece(self._place(mesh), colour, uv, texture, finish=finish)
            return piece if picture.is_2d else piece.without_maps
        if finish is not None and finish.images and self._has_own_places:
            mesh = _with_own_corners(self._own_mesh())
            uv = self._own_places() * [1, -1] + [0, 1]
            return Piece(self._place(mesh), colour, uv, finish=finish)
        return Piece(self.mesh(), colour, finish=None if finish is None else finish.without_maps)

    def mesh(self, sections: int = 32) -> Mesh:
        """Its surface in the world frame.

        Raises:
          AssetError: it is a plane, or out of all bounds.
        """
        return self._place(self._own_mesh(sections))

    def notes(self) -> Iterator[str]:
        """Where its look is not what its file alone lets one expect."""
        yield from self._finish(MAX_TEXTURE)[1]
        if (picture := self._picture) is None:
            return
        name = self.model.texture(picture.index).name
        if picture.is_darker:
            yield f"its image {name!r} is marked as sRGB: it is as dark as MuJoCo draws it"
        if not self._has_own_places:
            return
        repeat = self.model.mat_texrepeat[self._material]
        if not picture.is_2d:
            yield f"its image {name!r} is a cube map on texture coordinates: not drawn, as in MuJoCo"
        elif self._is_uniform or (repeat != 1).any():
            yield "its texture coordinates are taken as they are, without texrepeat"

    @property
    def _material(self) -> int:
        return int(self.model.geom_matid[self.index])

    @property
    def _asset(self) -> int:
        """Its mesh, or height field."""
        return int(self.model.geom_dataid[self.index])

    @property
    def _is_uniform(self) -> bool:
        return bool(self.model.mat_texuniform[self._material])

    @cached_property
    def _picture(self) -> _Picture | None:
        """Its material's, if that is one that MuJoCo can draw."""
        index = int(self.model.mat_texid[self._material, _RGB]) if self._material >= 0 else -1
        is_drawn = index >= 0 and self.model.tex_nchannel[index] >= 3
        return _Picture(self.model, index) if is_drawn else None

    def _finish(self, max_side: int) -> tuple[Finish | None, tuple[str, ...]]:
        """What its material says of roughness and metalness, with its maps; None if nothing. And notes."""
        if self._material < 0:
            return None, ()
        of = self.model
        numbers = (float(of.mat_roughness[self._material]), float(of.mat_metallic[self._material]))
        images = tuple(self._map(role) for role in _MAPS)
        return _finish_of(numbers, images, max_side)

    def _map(self, role: mujoco.mjtTextureRole) -> tuple[bytes, tuple[int, ...]] | None:
        """The pixels, and their shape, of its material's picture in a role other than that of colours."""
        index = int(self.model.mat_texid[self._material, role])
        if index < 0:
            return None
        of = self.model
        shape = tuple(int(n[index]) for n in (of.tex_height, of.tex_width, of.tex_nchannel))
        start = int(of.tex_adr[index])
        return of.tex_data[start : start + math.prod(shape)].tobytes(), shape

    @property
    def _has_own_places(self) -> bool:
        """Whether it is a mesh with texture coordinates."""
        is_mesh = self.kind == _GEOM.mjGEOM_MESH
        return is_mesh and bool(self.model.mesh_texcoordnum[self._asset] > 0)

    def _own_mesh(self, sections: int = 32) -> Mesh:
        """Its surface in its own frame; AssetError where it is a plane or out of all bounds."""
        size = self.model.geom_size[self.index]
        self._check_reach(size)
        match self.kind:
            # Of an SDF, MuJoCo makes a mesh when it compiles the file.
            case _GEOM.mjGEOM_MESH | _GEOM.mjGEOM_SDF:
                return _mesh_asset(self.model, self._asset)
            case _GEOM.mjGEOM_HFIELD:
                return _height_field(self.model, self._asset)
            case _GEOM.mjGEOM_BOX:
                return primitives.box(size)
            case _GEOM.mjGEOM_CYLINDER:
                return primitives.cylinder(size[0], size[1], sections)
            case _GEOM.mjGEOM_CAPSULE:
                return primitives.capsule(size[0], size[1])
            case _GEOM.mjGEOM_ELLIPSOID:
                return primitives.ellipsoid(size)
            case _GEOM.mjGEOM_SPHERE:
                return primitives.ellipsoid(np.full(3, size[0]))
        given = f"a geom of type {self.kind.name}"
        raise AssetError(given, "geoms with an inside: all kinds but planes")

    def _place(self, mesh: Mesh) -> Mesh:
        """A mesh of its frame, in the world frame; AssetError where that is out of all bounds."""
        turn = self.data.geom_xmat[self.index].reshape(3, 3)
        mesh = mesh.transform(turn, self.data.geom_xpos[self.index])
        self._check_reach(mesh.vertices)
        return mesh

    def _check_reach(self, lengths: np.ndarray) -> None:
        """AssetError where its sizes or points are out of all bounds, or no numbers."""
        # A number that is NaN compares as no.
        if not (np.abs(lengths) <= _FARTHEST).all():
            name = self.model.geom(self.index).name or f"number {self.index}"
            given = f"geom {name!r} reaches beyond {_FARTHEST:,.0f} m, or is nowhere"
            raise AssetError(given, "sizes in metres")

    def _with_picture(self, picture: _Picture, max_side: int) -> tuple[Mesh, np.ndarray, Texture]:
        """Its surface in its own frame, each triangle with vertices of its own; f64[V, 2], their uv; image.

        Args:
          max_side: pixels; larger images are shrunk.
        """
        mesh = self._own_mesh()
        pixels = picture.pixels
        if picture.is_2d:
            corners = _with_own_corners(mesh)
            places = self._own_places() if self._has_own_places else self._flat_places(corners)
            return corners, places * [1, -1] + [0, 1], _texture(pixels, max_side)
        width = pixels.shape[1]
        sides = pixels.reshape(-1, width, width, 3)
        image = one_image(np.broadcast_to(sides, (6, width, width, 3)))
        is_one = image.shape[1] == width
        side = min(width, max_side if is_one else max_side // 3)
        mesh, uv = wrap_cube_map(mesh, self._directions(mesh.vertices), is_one, side)
        return mesh, uv, _texture(image, max_side)

    def _own_places(self) -> np.ndarray:
        """f64[3 F, 2]: a mesh's own texture coordinates, to the right and down.

        A vertex may have another place in the image in each triangle.
        """
        of = self.model
        first = of.mesh_faceadr[self._asset]
        faces = of.mesh_facetexcoord[first : first + of.mesh_facenum[self._asset]]
        start = of.mesh_texcoordadr[self._asset]
        places = of.mesh_texcoord[start : start + of.mesh_texcoordnum[self._asset]]
        return np.asarray(places[faces.ravel()], np.float64)

    @property
    def _size(self) -> np.ndarray:
        """f64[3]: half of what it measures, of a capsule without its ends."""
        x, y, z = self.model.geom_size[self.index].tolist()
        if self.kind == _GEOM.mjGEOM_SPHERE:
            return np.full(3, x)
        return np.array([x, x, y] if self.kind in _ROUND else [x, y, z])

    def _flat_places(self, corners: Mesh) -> np.ndarray:
        """f64[3 F, 2]: where MuJoCo lays the corners of triangles in a picture of type 2d, right and down."""
        size = self._size
        repeat = np.array(self.model.mat_texrepeat[self._material], np.float64)
        if self._is_uniform:
            repeat = repeat * size[:2]
        unit = corners.vertices / size
        if self.kind in _PROJECTED:
            return unit[:, :2] * repeat * [0.5, -0.5] - 0.5
        normals = np.repeat(corners.normals / corners.areas[:, None], 3, axis=0)
        is_box = self.kind == _GEOM.mjGEOM_BOX
        places = _on_box(unit, normals) if is_box else _around(unit, self.kind, size)
        if self.kind == _GEOM.mjGEOM_CYLINDER:
            places = np.where(np.abs(normals[:, 2:]) > _DISK, (unit[:, :2] + 1) / 2, places)
        return places * repeat

    def _directions(self, points: np.ndarray) -> np.ndarray:
        """f64[V, 3]: where MuJoCo sees its points from the middle of a cube map."""
        size = self._size
        if self.kind in _PROJECTED:
            return points * size if self._is_uniform else points
        unit = points / size
        if self.kind == _GEOM.mjGEOM_CAPSULE:
            beyond = np.maximum(np.abs(points[:, 2]) - size[2], 0) / size[0]
            unit[:, 2] = np.sign(unit[:, 2]) * (np.minimum(np.abs(unit[:, 2]), 1) + beyond)
        return unit * size if self._is_uniform else unit


@lru_cache(maxsize=4)
def _finish_of(
    numbers: tuple[float, float],
    images: tuple[tuple[bytes, tuple[int, ...]] | None, ...],
    max_side: int,
) -> tuple[Finish | None, tuple[str, ...]]:
    """A finish, made once for all geoms of a material, and notes.

    Args:
      numbers: roughness and metallic, below 0 where the file does not say them.
      images: pixels in the roles `_MAPS`.
    """
    normal, both, roughness, metallic = (None if each is None else _image(*each) for each in images)
    roughness = both or roughness
    metallic = both or metallic
    given = {
        name: value if value >= 0 else 1.0
        for name, value, image in zip(
            ("roughness", "metallic"), numbers, (roughness, metallic), strict=True
        )
        if value >= 0 or image is not None
    }
    notes: list[str] = []
    finisher = Finisher(max_side, notes.append)
    finish = finisher.finish(given, finisher.normal(normal), finisher.orm(roughness, metallic))
    return finish, tuple(notes)


def _image(data: bytes, shape: tuple[int, ...]) -> Image.Image:
    pixels = np.frombuffer(data, np.uint8).reshape(shape)
    return Image.fromarray(
        np.ascontiguousarray(pixels[..., :3] if shape[2] > 2 else pixels[..., 0])
    )


def _with_own_corners(mesh: Mesh) -> Mesh:
    """The mesh with vertices of its own for each triangle."""
    return Mesh(mesh.vertices[mesh.faces.ravel()], np.arange(3 * len(mesh.faces)))


def _texture(pixels: np.ndarray, max_side: int) -> Texture:
    """The image, made once for all geoms of an object."""
    height, width, _ = pixels.shape
    return _encode(pixels.tobytes(), (width, height), max_side)


@lru_cache(maxsize=4)
def _encode(data: bytes, size: tuple[int, int], max_side: int) -> Texture:
    return Texture.of(Image.frombytes("RGB", size, data), max_side)


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


def _mesh_asset(model: mujoco.MjModel, mesh: int) -> Mesh:
    first = model.mesh_vertadr[mesh]
    first_face = model.mesh_faceadr[mesh]
    faces = model.mesh_face[first_face : first_face + model.mesh_facenum[mesh]]
    return Mesh(model.mesh_vert[first : first + model.mesh_vertnum[mesh]], faces)


def _height_field(model: mujoco.MjModel, field: int) -> Mesh:
    rows = int(model.hfield_nrow[field])
    columns = int(model.hfield_ncol[field])
    start = int(model.hfield_adr[field])
    heights = model.hfield_data[start : start + rows * columns].reshape(rows, columns)
    half_x, half_y, highest, base = model.hfield_size[field].tolist()
    return primitives.height_field(heights * highest, half_x, half_y, base)


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

    surface: tuple[Geom, ...]
    colliding: tuple[Geom, ...]
    notes: tuple[str, ...] = ()
    unseen: tuple[Geom, ...] = ()


def roles_of(model: mujoco.MjModel, data: mujoco.MjData, geoms: Iterable[int]) -> Roles:
    """The roles of one body's geoms, as they stand in `data`; planes have none."""
    every = [Geom(model, data, i) for i in geoms]
    solid = [each for each in every if not each.is_plane]
    colliding = [each for each in solid if each.collides]
    shown = [each for each in solid if each.is_visible and not each.collides]
    unseen = [each for each in solid if not each.is_visible and not each.collides]
    stand_ins = _find_stand_ins([each for each in colliding if each.is_visible], shown)
    surface = [each for each in solid if each.is_visible and each not in stand_ins]
    reasons = {
        "left out, as planes have no inside": [each for each in every if each.is_plane],
        "left out, as they are not seen and do not collide": unseen,
        "taken for collision alone, as what is seen covers them": stand_ins,
        "taken for the surface, as nothing else is there to be seen": [] if surface else colliding,
    }
    notes = tuple(
        f"{reason}: {first_names([each.called for each in which], _MOST_NAMES, ', {} more')}"
        for reason, which in reasons.items()
        if which
    )
    return Roles(tuple(surface or colliding), tuple(colliding), notes, tuple(unseen))


def _find_stand_ins(geoms: Sequence[Geom], shown: Sequence[Geom]) -> list[Geom]:
    """Those of `geoms` that stand in for what is shown: it fills a third of them, and reaches as far.

    A sticker fills nothing of its carton, and what a glass holds ends below its rim.
    """
    if not (geoms and shown):
        return []
    others = [_hull(each) for each in shown]
    parts = [each.vertices for each in others]
    lower, upper = join_meshes(others).bounds
    reach = _BEYOND * float(np.linalg.norm(upper - lower))
    covered = []
    for geom in geoms:
        hull = _hull(geom)
        ends = (hull.bounds[0] > lower - reach) & (hull.bounds[1] < upper + reach)
        if ends.all() and is_within_parts(_inner_points(hull), parts).mean() >= _FILLED:
            covered.append(geom)
    return covered


def _hull(geom: Geom) -> Mesh:
    """A geom's hull; what is flat is given a thickness."""
    return Mesh.points(sound_points(geom.mesh(16).vertices)).hull()


def _inner_points(hull: Mesh) -> np.ndarray:
    """f64[256, 3]: points spread through a convex body."""
    center = hull.vertices.mean(0)
    depth = np.random.default_rng(0).uniform(size=(_NUM_POINTS, 1)) ** (1 / 3)
    return center + depth * (sample_surface(hull, _NUM_POINTS, 0) - center)


_JOINT = mujoco.mjtJoint
_MOVABLE = {_JOINT.mjJNT_HINGE: "hinge", _JOINT.mjJNT_SLIDE: "slide", _JOINT.mjJNT_BALL: "ball"}


def read_mjcf(
    source: ObjectFile,
    max_side: int = MAX_TEXTURE,
    opened: Mapping[str, float] | None = None,
) -> Model:
    """One body with all that hangs on it, at the model's reference configuration.

    Pieces are the geoms that are seen, parts those that collide (`mjcf_roles`): MuJoCo takes the convex
    hull of each, so they are convex parts already, but for height fields and SDFs.

    Args:
      source: its body is the body's name, or "#N" for the N-th body of the world, or "" for the only one;
        its bodies are several of the world, named likewise, that are one piece of furniture.
      max_side: pixels; larger images are shrunk.
      opened: where hinges and slides are to be instead, degrees or metres, by name; given for furniture,
        which has what lies in the world itself, too.

    Returns:
      The model; its parts are None if there are more than 32 or one is not convex, its mass is what MuJoCo
      makes of the file.

    Raises:
      AssetError: MuJoCo cannot compile the file (its own message is kept), or nothing of the body is seen
        or collides.
    """
    path = source.path
    body = source.body
    bodies = source.bodies
    model, of_pictures = compile_with_notes(path)
    if model.nflex and not model.ngeom:
        raise AssetError(f"{path} holds soft bodies alone (flex)", "rigid bodies with geoms")
    data = mujoco.MjData(model)
    of_joints = _open_joints(model, data, opened or {}, path)
    mujoco.mj_kinematics(model, data)
    roots = _roots(model, path, body, bodies, opened is not None)
    root = roots[0]
    chosen = sorted(roots)
    # Bodies come behind those that they hang on.
    for index in range(1, model.nbody):
        if index not in roots and int(model.body_parentid[index]) in chosen:
            chosen.append(index)
    chosen.sort()
    geoms = [i for i in range(model.ngeom) if model.geom_bodyid[i] in chosen]
    roles = roles_of(model, data, geoms)
    if not roles.surface:
        why = "; ".join(roles.notes) or "it has no geoms"
        raise AssetError(
            f"{path}: nothing of body {model.body(root).name or body!r} can be an object: {why}",
            "geoms in groups 0 to 2 with an alpha above 0, or geoms that collide; planes do not count",
        )
    of_pictures = (*of_pictures, *(note for geom in roles.surface for note in geom.notes()))
    colliding = tuple(geom.mesh(16) for geom in roles.colliding)
    # One body that was chosen stands still itself.
    movable = [i for i in chosen if i != root or not body]
    frozen = frozen_note(_frozen_joints(model, data, movable))
    parent = int(model.body_parentid[root])
    own = _own_joints(model, root) if body else ()
    alone = alone_note(own, model.body(parent).name if parent else "")
    notes = (*frozen, *alone, *of_joints, *roles.notes)
    if root and not body and not bodies and (beside := len(_in_world(model))):
        notes += (f"left out, as they lie in the world beside the body: {beside} geoms",)
    if kilograms := _mass_of(path, [geom.index for geom in roles.unseen]):
        notes += (f"what is left out weighs {kilograms:.3g} kg: it counts, as in MuJoCo",)
    is_usable = all(geom.is_convex for geom in roles.colliding)
    parts = None
    if is_usable and 0 < len(colliding) <= MAX_PARTS:
        parts = tuple(Mesh.points(each.vertices) for each in colliding)
    weighed = [i for i in chosen if model.body_mass[i] != NO_MASS]
    return Model(
        pieces=[geom.piece(max_side) for geom in roles.surface],
        parts=parts,
        stated=combine_masses([_body_mass(model, data, i) for i in weighed]),
        notes=(*notes, *dict.fromkeys(of_pictures)),
        colliding=colliding,
        joints=_joints(model, data, [geom.index for geom in roles.surface], movable),
    )


def _open_joints(
    model: mujoco.MjModel, data: mujoco.MjData, opened: Mapping[str, float], path: Path
) -> list[str]:
    """Puts joints where they are asked for; what is to be said of that."""
    notes: list[str] = []
    movable = {model.joint(index).name: index for index in _hinges_and_slides(model)}
    check_joints(opened, movable, path)
    for name, value in opened.items():
        index = movable[name]
        lower, upper = (
            model.jnt_range[index].tolist() if model.jnt_limited[index] else (-np.inf, np.inf)
        )
        is_turn = bool(model.jnt_type[index] == _JOINT.mjJNT_HINGE)
        place, said = opened_joint(name, value, lower, upper, is_turn)
        data.qpos[model.jnt_qposadr[index]] = place
        notes += said
    return notes


def _frozen_joints(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: list[int]
) -> Iterator[tuple[str, str, float, bool]]:
    for joint in range(model.njnt):
        kind = mujoco.mjtJoint(int(model.jnt_type[joint]))
        if kind in _MOVABLE and int(model.jnt_bodyid[joint]) in bodies:
            is_ball = kind == _JOINT.mjJNT_BALL
            value = 0.0 if is_ball else float(data.qpos[model.jnt_qposadr[joint]])
            yield (model.joint(joint).name, _MOVABLE[kind], value, kind != _JOINT.mjJNT_SLIDE)


def _own_joints(model: mujoco.MjModel, body: int) -> list[str]:
    """Names of the joints by which a body hangs on another, those aside that leave it free."""
    own = np.flatnonzero(model.jnt_bodyid == body).tolist()
    return [model.joint(k).name for k in own if mujoco.mjtJoint(int(model.jnt_type[k])) in _MOVABLE]


def _hinges_and_slides(model: mujoco.MjModel) -> list[int]:
    """Their numbers. A whole number of NumPy is never found `in` a tuple of MuJoCo's enums."""
    kinds = [int(_JOINT.mjJNT_HINGE), int(_JOINT.mjJNT_SLIDE)]
    return [int(index) for index in np.flatnonzero(np.isin(model.jnt_type, kinds))]


def _joints(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: Sequence[int], bodies: Collection[int]
) -> tuple[Joint, ...]:
    """The hinges and slides of some bodies with what each moves, by number of these geoms."""
    own = [index for index in _hinges_and_slides(model) if int(model.jnt_bodyid[index]) in bodies]
    numbers = {index: number for number, index in enumerate(own)}
    last: dict[int, int] = {0: -1}
    parent: dict[int, int] = {}
    for body in range(1, model.nbody):
        last[body] = last[int(model.body_parentid[body])]
        first = int(model.body_jntadr[body])
        for index in range(first, first + int(model.body_jntnum[body])):
            if index in numbers:
                parent[index], last[body] = last[body], numbers[index]
    moved = [last[int(model.geom_bodyid[geom])] for geom in geoms]
    joints = []
    for index, number in numbers.items():
        dof = model.jnt_dofadr[index]
        joint = Joint(
            name=model.joint(index).name or f"joint_{number}",
            kind="slide" if model.jnt_type[index] == _JOINT.mjJNT_SLIDE else "hinge",
            anchor=tuple(data.xanchor[index].tolist()),
            axis=tuple(data.xaxis[index].tolist()),
            value=float(data.qpos[model.jnt_qposadr[index]]),
            range=tuple(model.jnt_range[index].tolist()) if model.jnt_limited[index] else None,
            parent=parent[index],
            pieces=tuple(place for place, by in enumerate(moved) if by == number),
            damping=_above_zero(model.dof_damping[dof]),
            friction=_above_zero(model.dof_frictionloss[dof]),
            armature=_above_zero(model.dof_armature[dof]),
        )
        own_bodies = [body for body in bodies if last[body] == number]
        masses = [_body_mass(model, data, body) for body in own_bodies]
        joints.append(joint.with_mass(sound_mass(masses)))
    return tuple(joints)


def _above_zero(value: float) -> float | None:
    """What MJCF has for what is not stated is zero."""
    return float(value) if value > 0 else None


def _body_mass(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> MassProperties:
    """One body's own mass in the world frame of the reference configuration."""
    axes = data.ximat[body].reshape(3, 3)
    inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
    return MassProperties(float(model.body_mass[body]), data.xipos[body].copy(), inertia)


def _mass_of(path: Path, geoms: Collection[int]) -> float:
    """Kilograms that geoms add to their bodies; 0 where these state their own, or consist of nothing else."""
    if not geoms:
        return 0.0
    try:
        spec = parse_mjcf(path)[0]
        before = spec.compile().body_mass.sum()
        for geom in spec.geoms:
            if geom.id in geoms:
                geom.mass = 0.0
        return float(before - spec.compile().body_mass.sum())
    except ValueError:
        return 0.0


def world_bodies(model: mujoco.MjModel) -> list[int]:
    """The bodies that hang on the world, in the model's order."""
    return [i for i in range(1, model.nbody) if model.body_parentid[i] == 0]


def _roots(
    model: mujoco.MjModel, path: Path, body: str, bodies: Sequence[str], is_furniture: bool
) -> list[int]:
    """The bodies' ids; 0, the world body, where the geoms lie in the world itself."""
    children = world_bodies(model)
    # Of furniture some parts may lie in the world itself; beside what is free there is scenery.
    kinds = model.jnt_type[np.isin(model.jnt_bodyid, children)]
    is_whole = is_furniture and bool(_in_world(model)) and not (kinds == _JOINT.mjJNT_FREE).any()
    if bodies and is_whole and len(bodies) == len(children):
        return [0]
    if body or bodies:
        return [_body_id(model, path, each) for each in bodies or (body,)]
    if len(children) > 1:
        names = ", ".join(model.body(i).name for i in children)
        raise AssetError(f"{path} holds {len(children)} bodies and none was chosen", names)
    return [0 if is_whole or not children else children[0]]


def _body_id(model: mujoco.MjModel, path: Path, body: str) -> int:
    names = [model.body(i).name for i in range(1, model.nbody)]
    if body in names:
        return 1 + names.index(body)
    number = body.removeprefix("#")
    children = world_bodies(model)
    if number != body and number.isdecimal() and int(number) < len(children):
        return children[int(number)]
    raise unknown_body(body, path, names)


def _in_world(model: mujoco.MjModel) -> list[int]:
    """The geoms of the world body, planes aside."""
    is_plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    return [int(i) for i in np.flatnonzero((model.geom_bodyid == 0) & ~is_plane)]
