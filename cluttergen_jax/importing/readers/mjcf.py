"""MJCF bodies: compiled by MuJoCo itself, geoms turned into meshes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

from cluttergen_jax.assets.config import MAX_TEXTURE
from cluttergen_jax.assets.inertia import MassProperties
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.stated_mass import combined
from cluttergen_jax.assets.texture import Texture
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers import primitives
from cluttergen_jax.importing.readers.model import MAX_PARTS, Model, frozen, frozen_note

_GEOM = mujoco.mjtGeom
_JOINT = mujoco.mjtJoint
_MOVABLE = {_JOINT.mjJNT_HINGE: "hinge", _JOINT.mjJNT_SLIDE: "slide", _JOINT.mjJNT_BALL: "ball"}


def read_mjcf(path: Path, body: str = "", max_side: int = MAX_TEXTURE) -> Model:
    """One body with all that hangs on it, at the model's reference configuration.

    Pieces are the geoms that collide with nothing, or all of them where every geom collides. Parts are
    the colliding geoms: MuJoCo takes the convex hull of each, so they are convex parts already.

    Args:
      path: the MJCF file.
      body: the body's name, or "#N" for the N-th body of the world, or "" for the only one.
      max_side: pixels; larger images are shrunk.

    Returns:
      The model; its parts are None if there are more than 32, its mass is what MuJoCo makes of the file.

    Raises:
      AssetError: MuJoCo cannot compile the file (its own message is kept), or the body has no geoms.
    """
    model = compiled(path)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    root = _root(model, path, body)
    bodies = [i for i in range(model.nbody) if _hangs_on(model, i, root)]
    solid = [i for i in range(model.ngeom) if model.geom_bodyid[i] in bodies and is_solid(model, i)]
    if not solid:
        raise AssetError(f"{path}: body {body or root!r} has no geoms that are solid")
    is_colliding = {i: bool(model.geom_contype[i] or model.geom_conaffinity[i]) for i in solid}
    visual = [i for i in solid if not is_colliding[i]] or solid
    pieces = [geom_piece(model, data, i, max_side) for i in visual]
    parts = tuple(Mesh.points(geom_mesh(model, data, i, 16).vertices) for i in solid if is_colliding[i])
    return Model(
        pieces=pieces,
        parts=parts if 0 < len(parts) <= MAX_PARTS else None,
        stated=combined([_body_mass(model, data, i) for i in bodies]),
        notes=frozen_note(_frozen_joints(model, bodies)),
    )


def _frozen_joints(model: mujoco.MjModel, bodies: list[int]) -> Iterator[str]:
    for joint in range(model.njnt):
        kind = mujoco.mjtJoint(int(model.jnt_type[joint]))
        if kind in _MOVABLE and int(model.jnt_bodyid[joint]) in bodies:
            is_ball = kind == _JOINT.mjJNT_BALL
            value = 0.0 if is_ball else float(model.qpos0[model.jnt_qposadr[joint]])
            yield frozen(model.joint(joint).name, _MOVABLE[kind], value, kind != _JOINT.mjJNT_SLIDE)


def _body_mass(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> MassProperties:
    """One body's own mass in the world frame of the reference configuration."""
    axes = data.ximat[body].reshape(3, 3)
    inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
    return MassProperties(float(model.body_mass[body]), data.xipos[body].copy(), inertia)


def compiled(path: Path) -> mujoco.MjModel:
    """The model of an MJCF file, whose names are text.

    Raises:
      AssetError: MuJoCo cannot compile it (its own message is kept), or a name is not UTF-8.
    """
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
        # MuJoCo takes any bytes for a name; they would come to light wherever one is first read.
        model.names.decode()
    except (ValueError, OSError) as error:
        told = " ".join(str(error).split())
        raise AssetError(f"{path} cannot be compiled as MJCF: {told}", "an MJCF file") from error
    return model


def _root(model: mujoco.MjModel, path: Path, body: str) -> int:
    """The body's id; 0, the world body, where the geoms lie in the world itself."""
    children = [i for i in range(1, model.nbody) if model.body_parentid[i] == 0]
    if body.startswith("#"):
        return children[int(body[1:])]
    if body:
        return int(model.body(body).id)
    if len(children) > 1:
        names = ", ".join(model.body(i).name for i in children)
        raise AssetError(f"{path} holds {len(children)} bodies and none was chosen", names)
    return children[0] if children else 0


def _hangs_on(model: mujoco.MjModel, body: int, root: int) -> bool:
    while body not in (root, 0):
        body = int(model.body_parentid[body])
    return body == root


def is_solid(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a geom has an inside that a mesh can show: all but planes, height fields and SDFs."""
    return model.geom_type[geom] not in (_GEOM.mjGEOM_PLANE, _GEOM.mjGEOM_HFIELD, _GEOM.mjGEOM_SDF)


def geom_piece(model: mujoco.MjModel, data: mujoco.MjData, geom: int, max_side: int = MAX_TEXTURE) -> Piece:
    """The geom's surface in the world frame, with its colour, and its image if it is a mesh with one.

    Images that MuJoCo lays around a shape by itself (cube maps, no texture coordinates) are left out.
    """
    colour = geom_colour(model, geom)
    texture, mesh = _texture(model, geom, max_side), int(model.geom_dataid[geom])
    is_mesh = model.geom_type[geom] == _GEOM.mjGEOM_MESH
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


def geom_colour(model: mujoco.MjModel, geom: int) -> tuple[float, float, float, float]:
    """The colour of a geom's material, or its own."""
    material = int(model.geom_matid[geom])
    r, g, b, a = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    return (float(r), float(g), float(b), float(a))


def geom_mesh(model: mujoco.MjModel, data: mujoco.MjData, geom: int, sections: int = 32) -> Mesh:
    """The geom's surface in the world frame of the reference configuration."""
    size = model.geom_size[geom]
    kind = model.geom_type[geom]
    if kind == _GEOM.mjGEOM_MESH:
        mesh = _mesh_asset(model, int(model.geom_dataid[geom]))
    elif kind == _GEOM.mjGEOM_BOX:
        mesh = primitives.box(size)
    elif kind == _GEOM.mjGEOM_CYLINDER:
        mesh = primitives.cylinder(size[0], size[1], sections)
    elif kind == _GEOM.mjGEOM_CAPSULE:
        mesh = primitives.capsule(size[0], size[1])
    else:
        mesh = primitives.ellipsoid(size if kind == _GEOM.mjGEOM_ELLIPSOID else np.full(3, size[0]))
    return mesh.transformed(data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom])


def _mesh_asset(model: mujoco.MjModel, mesh: int) -> Mesh:
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    first_face, face_count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    faces = model.mesh_face[first_face : first_face + face_count]
    return Mesh(model.mesh_vert[first : first + count], faces)
