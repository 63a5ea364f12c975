"""Objects and supports as MuJoCo bodies: the one place where an asset becomes geoms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.shading import shade
from cluttergen_jax.assets.shape import Piece, Texture
from cluttergen_jax.assets.support import PART_RGBA, SupportAsset
from cluttergen_jax.config import AIR_WALLS, ContactConfig, StabilityConfig
from cluttergen_jax.geometry import yaw_quaternion

VISUAL_GROUP = 2
COLLISION_GROUP = 3
# Of matte surfaces.
SPECULAR = 0.25
SHININESS = 0.35

MAX_FRICTION = 10.0
"""Sliding coefficients of objects from here on are all alike to MuJoCo's choice between two of them."""
_HIGHEST_PRIORITY = 100_000
_KNOWN_TO_ALL = mujoco.mjtMeshInertia.mjMESH_INERTIA_LEGACY
"""How a mesh weighs where nothing is said of it: files that say something do not open before MuJoCo 3.3."""
# Metres.
_PARKING_START = 50.0
_PARKING_HEIGHT = 10.0
_PARKING_GAP = 0.1


def new_spec(timestep: float, contact: ContactConfig) -> mujoco.MjSpec:
    """An empty model with the time step, the solver and the default contact parameters set."""
    spec = mujoco.MjSpec()
    spec.option.timestep = timestep
    spec.option.gravity = (0.0, 0.0, -contact.gravity)
    spec.option.cone = {
        "elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC,
        "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL,
    }[contact.cone]
    spec.option.impratio = contact.impratio
    spec.option.iterations = contact.iterations
    spec.option.noslip_iterations = contact.noslip_iterations
    spec.default.geom.friction = contact.friction
    spec.default.geom.solref = contact.solref
    spec.default.geom.solimp = contact.solimp
    spec.default.geom.condim = contact.condim
    return spec


def own_contact(
    friction: float, default: Sequence[float]
) -> tuple[tuple[float, float, float], int]:
    """Friction and priority of the geoms of an object that has a friction of its own.

    MuJoCo takes both from the geom of higher priority, and the larger friction of two that are equal. The
    priority grows as the friction falls, so an object's own friction holds against all that has none, be it
    more or less slippery, and the more slippery of two objects decides.

    Args:
      friction: the object's sliding coefficient.
      default: the contact's sliding, torsional and rolling coefficients (`ContactConfig.friction`).

    Returns:
      The three coefficients in the same proportions as the contact's, which scale with the contact's: the
      sliding one is `friction` under the default `ContactConfig`. Then the priority, from 1 on.
    """
    factor = friction / ContactConfig().friction[0]
    sliding, torsional, rolling = (factor * each for each in default)
    return (sliding, torsional, rolling), max(
        1, round(_HIGHEST_PRIORITY * (1 - friction / MAX_FRICTION))
    )


def set_surface(mesh: mujoco.MjsMesh, piece: Piece) -> None:
    """Gives a mesh the triangles of a piece, and normals and texture coordinates if it has an image."""
    vertices = piece.mesh.vertices
    faces = piece.mesh.faces
    if piece.uv is not None:
        # MuJoCo's own normals would show each seam of the image as an edge.
        vertices, normals, faces, uv = shade(piece.mesh, piece.uv)
        assert uv is not None
        mesh.usernormal = normals.ravel()
        # Its v runs down the image.
        mesh.usertexcoord = (uv * [1, -1] + [0, 1]).astype(np.float32).ravel()
    mesh.uservert = vertices.astype(np.float32).ravel()
    mesh.userface = faces.astype(np.int32).ravel()


def _add_visuals(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, pieces: tuple[Piece, ...]
) -> None:
    for index, piece in enumerate(pieces):
        mesh = spec.add_mesh(name=f"{name}.visual-{index}")
        set_surface(mesh, piece)
        _add_visual(body, mesh, piece, add_texture(spec, piece.texture)).name = mesh.name


def _add_visual(
    body: mujoco.MjsBody, mesh: mujoco.MjsMesh, piece: Piece, material: str
) -> mujoco.MjsGeom:
    """Adds a geom that is drawn and neither collides nor weighs anything."""
    # A shell's volume is never singular.
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    return body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=mesh.name,
        rgba=piece.rgba,
        material=material,
        contype=0,
        conaffinity=0,
        group=VISUAL_GROUP,
        mass=0,
    )


def add_texture(spec: mujoco.MjSpec, texture: Texture | None, folder: str = "") -> str:
    """Adds an image and a material that shows it, once; the material's name, empty if there is no image.

    The image is a file among `spec.assets`: to save the spec as XML, save these beside it.

    Args:
      folder: where the file will lie, relative to the XML, such as `../textures/`.
    """
    if texture is None:
        return ""
    name = texture.file_name.removesuffix(".png")
    if spec.texture(name) is None:
        image = spec.add_texture(
            name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, file=folder + texture.file_name
        )
        spec.assets = {**spec.assets, folder + texture.file_name: texture.data}
        material = spec.add_material(name=name, specular=SPECULAR, shininess=SHININESS)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = image.name
    return name


def add_part(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, vertices: np.ndarray
) -> mujoco.MjsGeom:
    """Adds a geom, and a mesh of the same name, which is the hull of f[V, 3]."""
    mesh = spec.add_mesh(name=name)
    mesh.uservert = vertices.astype(np.float32).ravel()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    return body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)


def add_object(
    spec: mujoco.MjSpec, asset: ObjectAsset, name: str, *, visual: bool = False
) -> mujoco.MjsBody:
    """Adds a free body called `name` whose frame is the object frame.

    The free joint's qpos is the object's pose: position, then quaternion wxyz. Mass and inertia are the
    asset's own, never those of the collision parts.
    """
    body = spec.worldbody.add_body(name=name)
    body.add_freejoint(name=name)
    body.mass = asset.mass
    body.ipos = asset.center_of_mass
    inertia = np.asarray(asset.inertia)
    body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    body.explicitinertial = True
    for index, part in enumerate(asset.parts):
        geom = add_part(spec, body, f"{name}.part-{index}", part.vertices)
        geom.group = COLLISION_GROUP
        geom.rgba = (0.6, 0.6, 0.65, 1.0)
    if asset.friction is not None:
        for geom in body.geoms:
            geom.friction, geom.priority = own_contact(asset.friction, spec.default.geom.friction)
    if visual:
        _add_visuals(spec, body, name, asset.pieces)
    return body


def add_support(spec: mujoco.MjSpec, support: SupportAsset, *, visual: bool = False) -> None:
    """Adds the support's boxes and convex parts to the world body, and its visual pieces if asked for."""
    body = spec.worldbody.add_body(name="support")
    is_drawn = visual and not support.pieces
    for index, box in enumerate(support.boxes):
        body.add_geom(
            name=f"support.box-{index}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=box.center,
            quat=yaw_quaternion(box.yaw),
            size=box.half_extents,
            rgba=box.rgba,
            group=VISUAL_GROUP if is_drawn else COLLISION_GROUP,
        )
    for index, part in enumerate(support.parts):
        geom = add_part(spec, body, f"support.part-{index}", part.vertices)
        geom.rgba = PART_RGBA
        geom.group = VISUAL_GROUP if is_drawn else COLLISION_GROUP
    if visual:
        _add_visuals(spec, body, "support", support.pieces)


def add_air_walls(spec: mujoco.MjSpec) -> None:
    """Adds four unseen planes without friction to the world body; where they stand is for the user to say."""
    for name in AIR_WALLS:
        spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=(1, 1, 0.1),
            condim=1,
            priority=_HIGHEST_PRIORITY + 1,
            group=COLLISION_GROUP,
        )


def populated_spec(
    names: Sequence[str],
    objects: Sequence[ObjectAsset],
    support: SupportAsset | None,
    timestep: float,
    contact: ContactConfig,
    *,
    poses: np.ndarray | None = None,
    visual: bool = False,
) -> mujoco.MjSpec:
    """A support and free objects on it, ready to be compiled; its only joints are theirs, in this order.

    Args:
      names: N unique names, of the bodies and their joints.
      support: None leaves it out.
      timestep: seconds.
      poses: f[N, 7], T_world_object, metres, wxyz. None parks the objects in the air, unturned, far from the
        support and from each other, so that they touch nothing.
      visual: whether coloured surfaces come along.
    """
    spec = new_spec(timestep, contact)
    if support is not None:
        add_support(spec, support, visual=visual)
    x = _PARKING_START
    for index, (name, asset) in enumerate(zip(names, objects, strict=True)):
        body = add_object(spec, asset, name, visual=visual)
        if poses is not None:
            body.pos = poses[index, :3]
            body.quat = poses[index, 3:]
            continue
        x += asset.radius
        body.pos = (x, 0.0, _PARKING_HEIGHT)
        x += asset.radius + _PARKING_GAP
    return spec


def object_xml(
    asset: ObjectAsset, surfaces: tuple[str, ...], files: Mapping[str, bytes], images: str = ""
) -> bytes:
    """One object alone as MJCF text: a free body called after it, with default contact parameters.

    Parts stand inline, surfaces are named by their files.

    Args:
      asset: the object.
      surfaces: the name of each piece's OBJ file, relative to where the text will be saved.
      files: their contents, by name.
      images: where the images of the surfaces will lie, relative to the text; beside it if empty.
    """
    spec = new_spec(StabilityConfig().timestep, ContactConfig())
    spec.modelname = asset.name
    body = add_object(spec, asset, asset.name)
    spec.worldbody.add_light(pos=(0, 0, 2), dir=(0, 0, -1))
    for index, (piece, surface) in enumerate(zip(asset.pieces, surfaces, strict=True)):
        mesh = spec.add_mesh(name=f"{asset.name}.visual-{index}", file=surface)
        _add_visual(body, mesh, piece, add_texture(spec, piece.texture, images))
        mesh.inertia = _KNOWN_TO_ALL if not piece.is_flat else mesh.inertia
    for geom in body.geoms:
        if geom.group == COLLISION_GROUP:
            spec.mesh(geom.meshname).inertia = _KNOWN_TO_ALL
    spec.assets = {**spec.assets, **{name: files[name] for name in surfaces}}
    spec.compile()
    return spec.to_xml().encode()
