"""MJCF geoms as meshes in the world frame, with the colours that MuJoCo gives them."""

from __future__ import annotations

import mujoco
import numpy as np

from cluttergen_jax.assets.config import MAX_TEXTURE
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers import primitives
from cluttergen_jax.importing.readers.mjcf_pictures import flat_colour, picture_id, with_picture

_GEOM = mujoco.mjtGeom
_FARTHEST = 1e6
"""Metres; beyond, the arithmetic of hulls breaks down."""
# What MuJoCo takes for "no colour given": a material's colour holds then.
_DEFAULT_RGBA = np.array([0.5, 0.5, 0.5, 1.0], np.float32)


def geom_kind(model: mujoco.MjModel, geom: int) -> mujoco.mjtGeom:
    """A geom's type, as a member of the enum: the model's own integers are not found `in` a tuple of them."""
    return _GEOM(int(model.geom_type[geom]))


def is_plane(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a geom is a plane: of the kinds that a file can hold, the one without an inside."""
    return geom_kind(model, geom) == _GEOM.mjGEOM_PLANE


def is_convex(model: mujoco.MjModel, geom: int) -> bool:
    """Whether MuJoCo collides a geom as a convex body: a mesh counts as its hull."""
    return geom_kind(model, geom) not in (_GEOM.mjGEOM_PLANE, _GEOM.mjGEOM_HFIELD, _GEOM.mjGEOM_SDF)


def geom_rgba(model: mujoco.MjModel, geom: int) -> tuple[float, float, float, float]:
    """The colour that MuJoCo draws a geom in: its own if it has one, else its material's."""
    material, own = int(model.geom_matid[geom]), model.geom_rgba[geom]
    is_given = material < 0 or not np.array_equal(own, _DEFAULT_RGBA)
    r, g, b, a = own if is_given else model.mat_rgba[material]
    return (float(r), float(g), float(b), float(a))


def geom_piece(model: mujoco.MjModel, data: mujoco.MjData, geom: int, max_side: int = MAX_TEXTURE) -> Piece:
    """The geom's surface in the world frame, with its colour, and its picture as MuJoCo lays it on.

    What is asked for although its alpha is 0, because nothing else is seen, is drawn opaque.
    """
    r, g, b, alpha = geom_rgba(model, geom)
    colour, picture = (r, g, b, alpha or 1.0), picture_id(model, geom)
    if picture < 0:
        return Piece(geom_mesh(model, data, geom), colour)
    if (flat := flat_colour(model, picture)) is not None:
        r, g, b = (flat * colour[:3]).tolist()
        return Piece(geom_mesh(model, data, geom), (r, g, b, colour[3]))
    if (found := with_picture(model, geom, _own_mesh(model, geom), picture, max_side)) is None:
        return Piece(geom_mesh(model, data, geom), colour)
    mesh, uv, texture = found
    return Piece(_placed(model, data, geom, mesh), colour, uv, texture)


def geom_mesh(model: mujoco.MjModel, data: mujoco.MjData, geom: int, sections: int = 32) -> Mesh:
    """The geom's surface in the world frame of the reference configuration.

    Raises:
      AssetError: it is a plane, or out of all bounds.
    """
    return _placed(model, data, geom, _own_mesh(model, geom, sections))


def _own_mesh(model: mujoco.MjModel, geom: int, sections: int = 32) -> Mesh:
    """The geom's surface in its own frame."""
    size, data_id = model.geom_size[geom], int(model.geom_dataid[geom])
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


def _placed(model: mujoco.MjModel, data: mujoco.MjData, geom: int, mesh: Mesh) -> Mesh:
    """A mesh in the geom's frame, in the world frame; AssetError where that is out of all bounds."""
    mesh = mesh.transformed(data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom])
    # A number that is NaN compares as no.
    if not (np.abs(mesh.vertices) <= _FARTHEST).all():
        name = model.geom(geom).name or f"number {geom}"
        raise AssetError(f"geom {name!r} reaches beyond {_FARTHEST:,.0f} m, or is nowhere", "sizes in metres")
    return mesh


def _mesh_asset(model: mujoco.MjModel, mesh: int) -> Mesh:
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    first_face, face_count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    faces = model.mesh_face[first_face : first_face + face_count]
    return Mesh(model.mesh_vert[first : first + count], faces)


def _height_field(model: mujoco.MjModel, field: int) -> Mesh:
    rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    start = int(model.hfield_adr[field])
    heights = model.hfield_data[start : start + rows * columns].reshape(rows, columns)
    half_x, half_y, highest, base = (float(each) for each in model.hfield_size[field])
    return primitives.height_field(heights * highest, half_x, half_y, base)
