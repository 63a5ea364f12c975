"""MJCF geoms as meshes in the world frame, with the colours that MuJoCo gives them."""

from __future__ import annotations

import mujoco
import numpy as np
from PIL import Image

from cluttergen_jax.assets.config import MAX_TEXTURE
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.texture import Texture
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers import primitives

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
    """The geom's surface in the world frame, with its colour, and its image if it is a mesh with one.

    What is asked for although its alpha is 0, because nothing else is seen, is drawn opaque.
    Images that MuJoCo lays around a shape by itself (cube maps, no texture coordinates) are left out.
    """
    r, g, b, alpha = geom_rgba(model, geom)
    colour = (r, g, b, alpha or 1.0)
    texture, mesh = _texture(model, geom, max_side), int(model.geom_dataid[geom])
    is_mesh = geom_kind(model, geom) == _GEOM.mjGEOM_MESH
    if texture is None or not is_mesh or model.mesh_texcoordnum[mesh] == 0:
        return Piece(geom_mesh(model, data, geom), colour)
    whole = geom_mesh(model, data, geom)
    first, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    start, number = model.mesh_texcoordadr[mesh], model.mesh_texcoordnum[mesh]
    uv = model.mesh_texcoord[start : start + number] * [1, -1] + [0, 1]
    # A vertex may have another place in the image in each triangle: each triangle gets vertices of its own.
    corners = Mesh(whole.vertices[whole.faces.ravel()], np.arange(3 * count))
    return Piece(corners, colour, uv[model.mesh_facetexcoord[first : first + count].ravel()], texture)


def _texture(model: mujoco.MjModel, geom: int, max_side: int) -> Texture | None:
    material = int(model.geom_matid[geom])
    index = model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB] if material >= 0 else -1
    if index < 0 or model.tex_type[index] != mujoco.mjtTexture.mjTEXTURE_2D or model.tex_nchannel[index] < 3:
        return None
    height, width, channels = (
        int(of[index]) for of in (model.tex_height, model.tex_width, model.tex_nchannel)
    )
    start = int(model.tex_adr[index])
    pixels = model.tex_data[start : start + height * width * channels].reshape(height, width, channels)
    return Texture.of(Image.fromarray(np.ascontiguousarray(pixels[..., :3])), max_side)


def geom_mesh(model: mujoco.MjModel, data: mujoco.MjData, geom: int, sections: int = 32) -> Mesh:
    """The geom's surface in the world frame of the reference configuration.

    Raises:
      AssetError: it is a plane, or out of all bounds.
    """
    size, data_id = model.geom_size[geom], int(model.geom_dataid[geom])
    kind = geom_kind(model, geom)
    if kind in (_GEOM.mjGEOM_MESH, _GEOM.mjGEOM_SDF):
        # Of an SDF, MuJoCo makes a mesh when it compiles the file.
        mesh = _mesh_asset(model, data_id)
    elif kind == _GEOM.mjGEOM_HFIELD:
        mesh = _height_field(model, data_id)
    elif kind == _GEOM.mjGEOM_BOX:
        mesh = primitives.box(size)
    elif kind == _GEOM.mjGEOM_CYLINDER:
        mesh = primitives.cylinder(size[0], size[1], sections)
    elif kind == _GEOM.mjGEOM_CAPSULE:
        mesh = primitives.capsule(size[0], size[1])
    elif kind == _GEOM.mjGEOM_ELLIPSOID:
        mesh = primitives.ellipsoid(size)
    elif kind == _GEOM.mjGEOM_SPHERE:
        mesh = primitives.ellipsoid(np.full(3, size[0]))
    else:
        raise AssetError(f"a geom of type {kind.name}", "geoms with an inside: all kinds but planes")
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
