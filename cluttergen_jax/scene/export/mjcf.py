"""A finished scene as an MJCF file that stands by itself: meshes by relative path, poses twice.

The poses stand in each body's pos and quat and in the keyframe `scene`, with the nine digits that a float32
needs; time step, solver and contact parameters are written out, so any MuJoCo simulates what was verified.

Why MJCF is written in four places. Models compiled here come from `assets.mjcf.populated_spec`. MuJoCo's
own `MjSpec.to_xml` rounds to six digits, enough for an object alone (`assets.mjcf`) and too few for
a pile that touches; and it would write every mesh once for each copy of an object. So this file is written
element by element. What `MujocoXMLObject` of robosuite reads is a dialect: groups, sites and missing joints.
"""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from lxml import etree as ET

from cluttergen_jax.assets.mjcf import (
    COLLISION_GROUP,
    SHININESS,
    SPECULAR,
    VISUAL_GROUP,
    finish_name,
    finish_numbers,
    layers_of,
    own_contact,
)
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.shape import Piece, Texture
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.geometry import yaw_quaternion
from cluttergen_jax.placement.world import unique_names
from cluttergen_jax.scene.cameras import FixedCamera
from cluttergen_jax.scene.export.shapes import (
    CollisionShape,
    VisualShape,
    shows_solids,
    solids_of,
    surfaces_of,
)

_ASSETS = "../assets"
"""The folder `assets`, seen from that of scenes' files."""
_UNSEEN: dict[str, str] = {
    "contype": "0",
    "conaffinity": "0",
    "group": str(VISUAL_GROUP),
    "mass": "0",
}

_STRANGE = re.compile(r"[^A-Za-z0-9_-]")
# What moves on a support's joint and whose mass its file does not state weighs so much for its box, kg/m^3,
# and at least 0.1 kg. Friction in the joint that is not stated is enough for its weight.
_BOARDS = 150.0
_LIGHTEST = 0.1
_THIN = 0.005
_GRAVITY = 9.81

_ARMATURE = 0.01
_DAMPING = 1.0
# robosuite's geom groups.
_COLLIDES = "0"
_DRAWN = "1"


def scene_xml(
    objects: Sequence[ObjectAsset],
    poses: np.ndarray,
    support: SupportAsset,
    stability: StabilityConfig,
    contact: ContactConfig,
    names: Sequence[str] | None = None,
    cameras: Sequence[FixedCamera] = (),
    names_detector: bool = True,
    has_joints: bool = False,
) -> bytes:
    """MJCF text of a scene.

    Args:
      objects: N assets in the order of placement.
      poses: f32[N, 7], world, metres, wxyz.
      names: of the bodies, unique; None makes them from the assets' names.
      cameras: around the support.
      names_detector: where the scene was checked with both of MuJoCo's detectors, the file chooses libccd by
        a flag that MuJoCo before 3.2.3 does not open; False leaves it out: libccd was the default there.
        So it does roughness, metalness and maps.
      has_joints: the support's joints can move; friction holds them where they stand. Their positions are
        before those of the objects in the keyframe.
    """
    root = ET.Element("mujoco", model="cluttergen scene")
    compiler = ET.SubElement(root, "compiler", angle="radian", meshdir=_ASSETS)
    if any(
        piece.images
        for pieces in (support.pieces, *(o.pieces for o in objects))
        for piece in pieces
    ):
        compiler.set("texturedir", _ASSETS)
    _add_options(root, stability, contact, names_detector and stability.both_detectors)
    _add_visual(root)
    assets = ET.SubElement(root, "asset")
    world = ET.SubElement(root, "worldbody")
    _add_surroundings(assets, world)
    bodies = _SupportBodies(root, world, support, has_joints)
    _add_support(assets, bodies, support, is_new=names_detector)
    stored: set[str] = set()
    names = names or unique_names([asset.name for asset in objects])
    for name, asset, pose in zip(names, objects, poses, strict=True):
        if asset.name not in stored:
            stored.add(asset.name)
            _add_meshes(assets, asset, f"objects/{asset.name}/")
        _add_body(assets, world, name, asset, pose, contact, is_new=names_detector)
    for each in cameras:
        pose = {"pos": _text(each.position), "quat": _text(each.quaternion)}
        ET.SubElement(world, "camera", pose, name=each.name, fovy=_text([each.fovy]))
    keyframe = ET.SubElement(root, "keyframe")
    qpos = np.concatenate([bodies.qpos, np.asarray(poses).ravel()])
    ET.SubElement(keyframe, "key", name="scene", qpos=_text(qpos))
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8") + os.linesep.encode()


def object_xml(asset: ObjectAsset, contact: ContactConfig, images: str) -> bytes:
    """MJCF text of one free object, to be saved in the folder of its meshes; `images` leads to its images."""
    root = ET.Element("mujoco", model=asset.name)
    ET.SubElement(root, "compiler", angle="radian")
    ET.SubElement(ET.SubElement(root, "default"), "geom", _contact_attributes(contact))
    assets = ET.SubElement(root, "asset")
    world = ET.SubElement(root, "worldbody")
    _add_meshes(assets, asset, "")
    _add_body(assets, world, asset.name, asset, np.array([0, 0, 0, 1, 0, 0, 0]), contact, images)
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8") + os.linesep.encode()


def _text(values: Sequence[float] | np.ndarray) -> str:
    return " ".join([f"{value:.9g}" for value in np.asarray(values, np.float64).ravel().tolist()])


def _add_options(
    root: ET._Element, stability: StabilityConfig, contact: ContactConfig, takes_libccd: bool
) -> None:
    option = ET.SubElement(
        root,
        "option",
        timestep=repr(stability.file_timestep),
        gravity=_text([0, 0, -contact.gravity]),
        cone=contact.cone,
        impratio=_text([contact.impratio]),
        iterations=str(contact.iterations),
        noslip_iterations=str(contact.noslip_iterations),
    )
    # Older MuJoCo (3.3) makes one contact of two faces unless it is told otherwise, and scenes creep.
    flag = ET.SubElement(option, "flag", multiccd="enable")
    if takes_libccd:
        flag.set("nativeccd", "disable")
    # Newton sees 10 cm ahead where no gap is stated, and the older detector errs by as much.
    touch = _contact_attributes(contact, stability.file_margin) | {"gap": "0"}
    ET.SubElement(ET.SubElement(root, "default"), "geom", touch)


def _weightless(piece: Piece) -> dict[str, str]:
    """What the mesh of a drawn surface says of its own mass, which counts nowhere: bodies state theirs.

    Nothing if it can be: before 3.3 MuJoCo refuses the word, since then without it a surface that is flat.
    """
    return {"inertia": "shell"} if piece.is_flat else {}


def _contact_attributes(contact: ContactConfig, margin: float = 0.0) -> dict[str, str]:
    """A geom's attributes in MJCF that say how it touches."""
    return {
        **({"margin": _text([margin])} if margin else {}),
        "friction": _text(contact.friction),
        "solref": _text(contact.solref),
        "solimp": _text(contact.solimp),
        "condim": str(contact.condim),
    }


def _own_contact_attributes(asset: ObjectAsset, contact: ContactConfig) -> dict[str, str]:
    """What replaces or joins them where an object has a friction of its own."""
    if asset.friction is None:
        return {}
    friction, priority = own_contact(asset.friction, contact.friction)
    return {"friction": _text(friction), "priority": str(priority)}


def _add_visual(root: ET._Element) -> None:
    visual = ET.SubElement(root, "visual")
    ET.SubElement(
        visual,
        "headlight",
        ambient="0.32 0.32 0.33",
        diffuse="0.28 0.28 0.28",
        specular="0.05 0.05 0.05",
    )
    ET.SubElement(visual, "global", offwidth="1280", offheight="960")
    ET.SubElement(visual, "quality", shadowsize="4096")
    ET.SubElement(visual, "map", haze="0.6")
    ET.SubElement(visual, "rgba", haze="0.90 0.905 0.915 1")


def _add_surroundings(assets: ET._Element, world: ET._Element) -> None:
    sky = {"type": "skybox", "builtin": "gradient", "width": "256", "height": "1536"}
    ET.SubElement(
        assets, "texture", sky, name="sky", rgb1="0.62 0.69 0.78", rgb2="0.90 0.905 0.915"
    )
    ET.SubElement(
        world,
        "light",
        name="sun",
        pos="0.6 -0.8 3",
        dir="-0.2 0.45 -1",
        directional="true",
        diffuse="0.62 0.61 0.59",
        specular="0.15 0.15 0.15",
    )
    ET.SubElement(
        world, "geom", name="floor", type="plane", size="0 0 0.1", rgba="0.82 0.82 0.83 1"
    )


class _SupportBodies:
    """The bodies of a support: one that stands still, and one for each joint where joints can move."""

    def __init__(
        self, root: ET._Element, world: ET._Element, support: SupportAsset, has_joints: bool
    ) -> None:
        self._support = support
        self._joints = support.joints if has_joints else ()
        self._still = ET.SubElement(world, "body", name="support")
        self._moving: dict[int, ET._Element] = {}
        for number in range(len(self._joints)):
            self._body(number)
        # A drawer and what it runs in touch everywhere.
        names = [each.get("name", "") for each in (self._still, *self._moving.values())]
        if self._moving:
            contact = ET.SubElement(root, "contact")
            for one, other in itertools.combinations(names, 2):
                ET.SubElement(contact, "exclude", body1=one, body2=other)

    def of(self, kind: Literal["boxes", "parts", "pieces"], index: int) -> ET._Element:
        """The body of one of the support's boxes, parts or surfaces."""
        for number, joint in enumerate(self._joints):
            if index in getattr(joint, kind):
                return self._moving[number]
        return self._still

    @property
    def qpos(self) -> list[float]:
        """Where the joints stand, in the order in which MuJoCo has them."""
        return [float(joint.get("ref", "0")) for joint in self._still.iter("joint")]

    def _body(self, number: int) -> ET._Element:
        if number in self._moving:
            return self._moving[number]
        joint = self._joints[number]
        above = self._still if joint.parent < 0 else self._body(joint.parent)
        name = f"support.{number}.{_STRANGE.sub('_', joint.name)}"
        body = ET.SubElement(above, "body", name=name)
        points = [self._support.pieces[piece].mesh.vertices for piece in joint.pieces]
        low = np.zeros(3)
        high = np.zeros(3)
        if points:
            low = np.concatenate(points).min(0)
            high = np.concatenate(points).max(0)
        size = np.maximum(high - low, _THIN)
        mass = max(_BOARDS * size.prod(), _LIGHTEST)
        inertia = mass / 12 * (np.square(size).sum() - np.square(size))
        center = (low + high) / 2
        weight = mass * _GRAVITY
        inertial = {"diaginertia": _text(inertia)}
        if (stated := joint.body) is not None and joint.inertia is not None:
            mass = stated.mass
            center = stated.center
            weight = stated.mass * _GRAVITY
            inertial = {"fullinertia": _text(joint.inertia)}
        holds = (
            weight * float(np.linalg.norm(center - joint.anchor))
            if joint.kind == "hinge"
            else weight
        )
        if joint.friction is not None:
            # Where its axis lets it fall, it is held all the same: scenes were made on it at rest.
            lever = np.array([0.0, 0.0, 1.0])
            if joint.kind == "hinge":
                lever = np.cross(center - joint.anchor, lever)
            holds = max(joint.friction, weight * abs(float(lever @ joint.axis)))
        own = {"type": joint.kind, "pos": _text(joint.anchor), "axis": _text(joint.axis)}
        own |= {
            "ref": f"{joint.value:.9g}",
            "frictionloss": f"{holds:.4g}",
            "armature": f"{_ARMATURE if joint.armature is None else joint.armature:.6g}",
            "damping": f"{_DAMPING if joint.damping is None else joint.damping:.6g}",
        }
        if joint.range is not None:
            own |= {"limited": "true", "range": _text(joint.range)}
        ET.SubElement(body, "inertial", inertial, pos=_text(center), mass=_text([mass]))
        ET.SubElement(body, "joint", own, name=name)
        self._moving[number] = body
        return body


def _add_support(
    assets: ET._Element, bodies: _SupportBodies, support: SupportAsset, is_new: bool
) -> None:
    group = str(VISUAL_GROUP if shows_solids(support) else COLLISION_GROUP)
    for number, solid in enumerate(solids_of(support)):
        name = f"support.{solid.name}"
        if solid.box is not None:
            body = bodies.of("boxes", number)
        else:
            body = bodies.of("parts", number - len(support.boxes))
            ET.SubElement(assets, "mesh", name=name, file=f"support/{solid.file}")
        shown = {"rgba": _text(solid.rgba), "group": group}
        ET.SubElement(body, "geom", {"name": name} | _shape(solid, name) | shown)
    for index, surface in enumerate(surfaces_of(support)):
        mesh = f"support.{surface.name}"
        file = f"support/{surface.file}"
        ET.SubElement(assets, "mesh", _weightless(surface.piece), name=mesh, file=file)
        body = bodies.of("pieces", index)
        _add_visual_geom(assets, body, mesh, surface.piece, "support/", is_new)


def _shape(solid: CollisionShape, mesh: str) -> dict[str, str]:
    """Attributes of a geom that say its form, and where it is."""
    if (box := solid.box) is None:
        return {"type": "mesh", "mesh": mesh}
    place = {"pos": _text(box.center), "quat": _text(yaw_quaternion(box.yaw))}
    return {"type": "box"} | place | {"size": _text(box.half_extents)}


def _add_meshes(assets: ET._Element, asset: ObjectAsset, folder: str) -> None:
    for solid in solids_of(asset):
        name = f"{asset.name}.{solid.name}"
        ET.SubElement(assets, "mesh", name=name, file=folder + solid.file)
    for index, piece in enumerate(asset.pieces):
        name = f"{asset.name}.visual-{index}"
        file = f"{folder}visual-{index}.obj"
        ET.SubElement(assets, "mesh", _weightless(piece), name=name, file=file)


def _add_inertial(body: ET._Element, asset: ObjectAsset) -> None:
    inertia = np.asarray(asset.inertia)[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    ET.SubElement(
        body,
        "inertial",
        pos=_text(asset.center_of_mass),
        mass=_text([asset.mass]),
        fullinertia=_text(inertia),
    )


def _add_body(
    assets: ET._Element,
    world: ET._Element,
    name: str,
    asset: ObjectAsset,
    pose: np.ndarray,
    contact: ContactConfig,
    images: str = "textures/",
    is_new: bool = True,
) -> None:
    body = ET.SubElement(world, "body", name=name, pos=_text(pose[:3]), quat=_text(pose[3:]))
    ET.SubElement(body, "freejoint", name=name)
    _add_inertial(body, asset)
    own = _own_contact_attributes(asset, contact)
    for solid in solids_of(asset):
        shape = own | _shape(solid, f"{asset.name}.{solid.name}")
        ET.SubElement(body, "geom", shape, group=str(COLLISION_GROUP))
    for index, piece in enumerate(asset.pieces):
        _add_visual_geom(assets, body, f"{asset.name}.visual-{index}", piece, images, is_new)


def _add_visual_geom(
    assets: ET._Element, body: ET._Element, mesh: str, piece: Piece, images: str, is_new: bool
) -> None:
    """Adds a drawn geom, and its material where there is none yet.

    Args:
      images: what leads to the images.
      is_new: whether the reader knows roughness, metalness and layers.
    """
    geom = ET.SubElement(body, "geom", _UNSEEN, type="mesh", mesh=mesh, rgba=_text(piece.rgba))
    if piece.finish is not None:
        name = finish_name(piece)
    elif piece.texture is not None:
        name = _image_name(piece.texture)
    else:
        return
    geom.set("material", name)
    if assets.find(f"material[@name='{name}']") is not None:
        return
    layers = layers_of(piece)
    if not is_new:
        layers = {role: image for role, image in layers.items() if role == "rgb"}
    for image in layers.values():
        own = _image_name(image)
        if assets.find(f"texture[@name='{own}']") is None:
            ET.SubElement(assets, "texture", name=own, type="2d", file=images + image.file_name)
    _add_material(
        assets, name, piece, {role: _image_name(each) for role, each in layers.items()}, is_new
    )


def _image_name(image: Texture) -> str:
    return image.file_name.removesuffix(".png")


def _add_material(
    assets: ET._Element, name: str, piece: Piece, layers: Mapping[str, str], is_new: bool = True
) -> None:
    """Adds a piece's material; see `add_material` of assets.mjcf.

    Args:
      layers: names of textures by role. One of colours alone is an attribute, which all versions know;
        layers are read from MuJoCo 3.2.7 on.
      is_new: whether roughness and metalness are said.
    """
    own = {"specular": str(SPECULAR), "shininess": str(SHININESS)}
    if piece.finish is not None:
        numbers = finish_numbers(piece.finish)
        own = {key: _text([numbers[key]]) for key in numbers if is_new or key in own}
        own["rgba"] = _text(piece.rgba)
    material = ET.SubElement(assets, "material", own, name=name)
    if layers.keys() == {"rgb"}:
        material.set("texture", layers["rgb"])
        return
    for role, texture in layers.items():
        ET.SubElement(material, "layer", role=role, texture=texture)


def robosuite_xml(
    body: ObjectAsset | SupportAsset, contact: ContactConfig, region: bool = False
) -> bytes:
    """A free object, to which robosuite adds the joint; or the support, fixed, in the world frame.

    Args:
      region: add the box `reg_bbox`, by which RoboCasa knows an object's size.
    """
    is_object = isinstance(body, ObjectAsset)
    root = ET.Element("mujoco", model=body.name if is_object else "support")
    assets = ET.SubElement(root, "asset")
    shell = ET.SubElement(ET.SubElement(root, "worldbody"), "body")
    inner = ET.SubElement(shell, "body", name="object")
    touch = _contact_attributes(contact)
    bottom = 0.0
    if isinstance(body, ObjectAsset):
        _add_inertial(inner, body)
        touch |= _own_contact_attributes(body, contact)
        reach = body.half_extents
        bottom = -reach[2]
    else:
        reach = np.array([*body.region.half_extents, body.top])
    for solid in solids_of(body):
        if solid.box is None:
            ET.SubElement(assets, "mesh", name=solid.name, file=solid.file)
        shape = _shape(solid, solid.name)
        ET.SubElement(inner, "geom", shape | touch, group=_COLLIDES, rgba="0 0 0 0")
        if shows_solids(body):
            ET.SubElement(inner, "geom", shape | _drawing_of(solid.rgba))
    for surface in surfaces_of(body):
        _add_surface(assets, inner, surface)
    if region:
        box = {"type": "box", "pos": "0 0 0", "size": _text(reach)}
        ET.SubElement(inner, "geom", _drawing_of((0.0, 0.0, 0.0, 0.0)) | box, name="reg_bbox")
    # The three sites by which robosuite knows an object's size.
    sites = {
        "bottom_site": [0, 0, bottom],
        "top_site": [0, 0, reach[2]],
        "horizontal_radius_site": [reach[0], reach[1], 0],
    }
    for name, position in sites.items():
        ET.SubElement(shell, "site", name=name, pos=_text(position), size="0.005", rgba="0 0 0 0")
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8") + b"\n"


def _drawing_of(rgba: tuple[float, ...]) -> dict[str, str]:
    """Attributes of a geom of robosuite's that is drawn, touches nothing and weighs nothing."""
    return _UNSEEN | {"group": _DRAWN, "rgba": _text(rgba)}


def _add_surface(assets: ET._Element, body: ET._Element, surface: VisualShape) -> None:
    name = surface.name
    ET.SubElement(assets, "mesh", _weightless(surface.piece), name=name, file=surface.file)
    geom = ET.SubElement(body, "geom", _drawing_of(surface.piece.rgba), type="mesh", mesh=name)
    layers = {}
    if surface.image is not None:
        layers["rgb"] = name.replace("visual", "image")
        ET.SubElement(assets, "texture", name=layers["rgb"], type="2d", file=surface.image)
    if layers or surface.piece.finish is not None:
        # robosuite renames what a model has, but no textures of layers: maps are left out.
        _add_material(assets, name, surface.piece.without_maps, layers)
        geom.set("material", name)
