"""Objects and supports as MuJoCo bodies: the one place where an asset becomes geoms."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from cluttergen_jax.assets.finish import Finish
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
DOOR_MASS = 1.0
"""Kilograms of a door while it is closed: a hand leads it, whatever it weighs."""
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
    """Gives a mesh the triangles of a piece, and normals and texture coordinates if it has images."""
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
        _add_visual(body, mesh, piece, add_material(spec, piece)).name = mesh.name


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
    name = add_image(spec, texture, folder)
    if spec.material(name) is None:
        material = spec.add_material(name=name, specular=SPECULAR, shininess=SHININESS)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    return name


def add_image(spec: mujoco.MjSpec, texture: Texture, folder: str = "") -> str:
    """Adds an image, once; its name."""
    name = texture.file_name.removesuffix(".png")
    if spec.texture(name) is None:
        file = folder + texture.file_name
        spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, file=file)
        spec.assets = {**spec.assets, file: texture.data}
    return name


def add_material(spec: mujoco.MjSpec, piece: Piece, folder: str = "") -> str:
    """Adds the material of a piece, once; its name, empty if the piece has one colour and no finish.

    A finish gives it `roughness`, `metallic`, the layers of its maps, and highlights for MuJoCo's own
    renderer, which reads none of these. What lets light through says so by the alpha of its colour.

    Args:
      folder: where images will lie (`add_texture`).
    """
    if piece.finish is None:
        return add_texture(spec, piece.texture, folder)
    name = finish_name(piece)
    if spec.material(name) is None:
        material = spec.add_material(name=name, rgba=piece.rgba)
        for key, value in finish_numbers(piece.finish).items():
            setattr(material, key, value)
        for role, image in layers_of(piece).items():
            index = int(getattr(mujoco.mjtTextureRole, f"mjTEXROLE_{role.upper()}"))
            material.textures[index] = add_image(spec, image, folder)
    return name


def finish_numbers(finish: Finish) -> dict[str, float]:
    """Attributes of a material in MJCF; highlights are those of the mean of a map."""
    return {
        "specular": finish.specular,
        "shininess": finish.shininess,
        "roughness": finish.roughness,
        "metallic": finish.metallic,
    }


def layers_of(piece: Piece) -> dict[str, Texture]:
    """The images of a piece by their role in MJCF."""
    finish = piece.finish
    maps = {} if finish is None else {"normal": finish.normal, "orm": finish.orm}
    images = {"rgb": piece.texture} | maps
    return {role: image for role, image in images.items() if image is not None}


def finish_name(piece: Piece) -> str:
    """What the material of a piece with a finish is called: pieces of equal looks share one."""
    finish = piece.finish
    assert finish is not None
    numbers = [float(each) for each in (finish.roughness, finish.metallic, finish.transmission)]
    images = (piece.texture, finish.normal, finish.orm)
    names = [None if each is None else each.file_name for each in images]
    text = json.dumps([list(map(float, piece.rgba)), numbers, names])
    return f"finish-{hashlib.sha256(text.encode()).hexdigest()[:12]}"


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


def add_support(
    spec: mujoco.MjSpec,
    support: SupportAsset,
    *,
    visual: bool = False,
    moving: Mapping[int, mujoco.MjsBody] | None = None,
) -> None:
    """Adds the support's boxes and convex parts to the world body, and its visual pieces if asked for.

    Args:
      moving: bodies of some of its joints, by number, to which what they move is added instead.
    """
    still = spec.worldbody.add_body(name="support")
    bodies = {
        (kind, index): body
        for number, body in (moving or {}).items()
        for kind in ("boxes", "parts")
        for index in getattr(support.joints[number], kind)
    }
    is_drawn = visual and not support.pieces
    for index, box in enumerate(support.boxes):
        body = bodies.get(("boxes", index), still)
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
        body = bodies.get(("parts", index), still)
        geom = add_part(spec, body, f"support.part-{index}", part.vertices)
        geom.rgba = PART_RGBA
        geom.group = VISUAL_GROUP if is_drawn else COLLISION_GROUP
    if visual:
        _add_visuals(spec, still, "support", support.pieces)


def add_door_bodies(
    spec: mujoco.MjSpec, support: SupportAsset, numbers: Sequence[int]
) -> dict[int, mujoco.MjsBody]:
    """Adds a weightless body and a joint for each of some joints of a support: 0 where it stands.

    Returns:
      The bodies, by the number of every joint that moves them: joints that stay as they are move with those
      that they hang on.
    """
    bodies: dict[int, mujoco.MjsBody] = {}

    def body_of(number: int) -> mujoco.MjsBody | None:
        if number < 0 or number in bodies:
            return bodies.get(number)
        joint = support.joints[number]
        above = body_of(joint.parent)
        if number not in numbers:
            if above is not None:
                bodies[number] = above
            return above
        body = (above or spec.worldbody).add_body(name=f"door.{number}", gravcomp=1.0)
        points = [support.boxes[k].mesh.vertices for k in joint.boxes]
        points += [support.parts[k].vertices for k in joint.parts]
        corners = np.concatenate(points or [np.array([joint.anchor])])
        size = np.maximum(np.ptp(corners, axis=0), 0.02)
        body.mass = DOOR_MASS
        body.ipos = (corners.min(0) + corners.max(0)) / 2
        body.inertia = DOOR_MASS / 12 * (np.square(size).sum() - np.square(size))
        body.explicitinertial = True
        kind = mujoco.mjtJoint.mjJNT_HINGE
        if joint.kind == "slide":
            kind = mujoco.mjtJoint.mjJNT_SLIDE
        body.add_joint(name=f"door.{number}", type=kind, pos=joint.anchor, axis=joint.axis)
        bodies[number] = body
        return body

    for number in range(len(support.joints)):
        body_of(number)
    return bodies


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
    doors: Sequence[int] = (),
) -> mujoco.MjSpec:
    """A support and free objects on it, ready to be compiled; its only joints are theirs, in this order.

    Args:
      names: N unique names, of the bodies and their joints.
      support: None leaves it out.
      timestep: seconds.
      poses: f[N, 7], T_world_object, metres, wxyz. None parks the objects in the air, unturned, far from the
        support and from each other, so that they touch nothing.
      visual: whether coloured surfaces come along.
      doors: joints of the support, by number, that move: theirs come behind the objects', each with an
        actuator for its position. Nothing of the support touches another part of it.
    """
    spec = new_spec(timestep, contact)
    if support is not None and not doors:
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
    if support is not None and doors:
        bodies = add_door_bodies(spec, support, doors)
        add_support(spec, support, visual=visual, moving=bodies)
        names = ["support", *dict.fromkeys(body.name for body in bodies.values())]
        for one, other in itertools.combinations(names, 2):
            spec.add_exclude(bodyname1=one, bodyname2=other)
        for number in doors:
            spec.add_actuator(
                name=f"door.{number}",
                target=f"door.{number}",
                trntype=mujoco.mjtTrn.mjTRN_JOINT,
                gaintype=mujoco.mjtGain.mjGAIN_FIXED,
                biastype=mujoco.mjtBias.mjBIAS_AFFINE,
                forcelimited=True,
                forcerange=(-1.0, 1.0),
            )
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
        _add_visual(body, mesh, piece, add_material(spec, piece, images))
        mesh.inertia = _KNOWN_TO_ALL if not piece.is_flat else mesh.inertia
    for geom in body.geoms:
        if geom.group == COLLISION_GROUP:
            spec.mesh(geom.meshname).inertia = _KNOWN_TO_ALL
    spec.assets = {**spec.assets, **{name: files[name] for name in surfaces}}
    spec.compile()
    return spec.to_xml().encode()
