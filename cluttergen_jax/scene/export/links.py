"""URDF and SDFormat 1.9: models of one link, with what is seen of it and what it collides with.

URDF: one file per object and one for the support; where they stand is in a JSON file per scene. Inertia is
given along the principal axes, because some readers take the diagonal only. The contact element is Bullet's
own: Bullet multiplies the frictions of two bodies, so that each gets the square root of what the pair is to
have; other readers ignore it.

SDFormat: a world for each scene, for Gazebo and Drake; and Drake's directives, with a model an object.
Drake's own elements say that a part is convex, and make parts and boxes compliant hydroelastic bodies, which
touch over areas: its point contact has one point for each two bodies, on which nothing flat stands still.
Other readers skip them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from xml.etree import ElementTree as ET

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.geometry import yaw_quaternion
from cluttergen_jax.scene import FixedCamera, Scene
from cluttergen_jax.scene.export.shapes import (
    SUPPORT_FOLDER,
    CollisionShape,
    VisualShape,
    factor_of,
    friction_of,
    harmonic_of,
    object_folder,
    principal_of,
    shows_solids,
    solids_of,
    surfaces_of,
    text,
    xml_bytes,
)

_DRAKE = "http://drake.mit.edu"
HYDROELASTIC_MODULUS = 1e9
"""Pascals: of hard plastic. As soft as rubber (1e7), tables give way at edges, and what overhangs tips."""
_DISSIPATION = 50.0
"""Seconds per metre, of Hunt and Crossley: nothing springs back from more than 2 cm/s."""
_PACKAGE = "cluttergen"
"""What the export's folder is called in the URIs of directives."""
PACKAGE_XML = f'<package format="2"><name>{_PACKAGE}</name></package>\n'


def _solids(body: ObjectAsset | SupportAsset) -> Iterator[tuple[CollisionShape, str]]:
    """Each solid with what it is an element of: "collision", and "visual" where solids are drawn."""
    for solid in solids_of(body):
        yield solid, "collision"
        if shows_solids(body):
            yield solid, "visual"


def object_urdf(asset: ObjectAsset, contact: ContactConfig) -> bytes:
    """A free body of one link, whose frame is the object frame."""
    root, link = _robot(asset.name, contact, friction_of(asset, contact))
    principal = principal_of(asset)
    turn = Rotation.from_quat(principal.turn, scalar_first=True).as_euler("xyz")
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=text(principal.center), rpy=text(turn))
    _add_inertia(inertial, asset.mass, principal.moments)
    _add_shapes(link, asset)
    return xml_bytes(root)


def support_urdf(support: SupportAsset, contact: ContactConfig) -> bytes:
    """The fixed support in the world frame: collision, and surfaces where it has them. Its mass is zero."""
    root, link = _robot(support.name, contact, contact.friction)
    _add_inertia(ET.SubElement(link, "inertial"), 0.0, np.zeros(3))
    _add_shapes(link, support)
    return xml_bytes(root)


def _robot(
    name: str, contact: ContactConfig, friction: tuple[float, float, float]
) -> tuple[ET.Element, ET.Element]:
    root = ET.Element("robot", name=name)
    link = ET.SubElement(root, "link", name=name)
    own = ET.SubElement(link, "contact")
    share = factor_of(friction[0], contact.friction[0])
    ET.SubElement(own, "lateral_friction", value=text([share]))
    # Bullet's pair value is friction A times spinning friction B, and the other way round, added up.
    spinning = friction[1] / (2 * math.sqrt(contact.friction[0]))
    ET.SubElement(own, "spinning_friction", value=text([spinning]))
    return root, link


def _add_inertia(inertial: ET.Element, mass: float, moments: np.ndarray) -> None:
    ET.SubElement(inertial, "mass", value=text([mass]))
    ixx, iyy, izz = (text([moment]) for moment in moments)
    ET.SubElement(inertial, "inertia", ixx=ixx, iyy=iyy, izz=izz, ixy="0", ixz="0", iyz="0")


def _add_shapes(link: ET.Element, body: ObjectAsset | SupportAsset) -> None:
    for surface in surfaces_of(body):
        visual = ET.SubElement(link, "visual", name=surface.name)
        ET.SubElement(ET.SubElement(visual, "geometry"), "mesh", filename=surface.file)
        material = _add_material(visual, surface.name, surface.piece.rgba)
        if surface.image is not None:
            # The OBJ's own material says the same to readers that look there.
            ET.SubElement(material, "texture", filename=surface.image)
    for solid, kind in _solids(body):
        element = ET.SubElement(link, kind, name=solid.name)
        if (box := solid.box) is not None:
            ET.SubElement(element, "origin", xyz=text(box.center), rpy=text([0, 0, box.yaw]))
            size = text(2 * np.array(box.half_extents))
            ET.SubElement(ET.SubElement(element, "geometry"), "box", size=size)
        else:
            ET.SubElement(ET.SubElement(element, "geometry"), "mesh", filename=solid.file)
        if kind == "visual":
            _add_material(element, solid.name, solid.rgba)


def _add_material(visual: ET.Element, name: str, rgba: tuple[float, ...]) -> ET.Element:
    material = ET.SubElement(visual, "material", name=name)
    ET.SubElement(material, "color", rgba=text(rgba))
    return material


def sdf_text(scene: Scene) -> bytes:
    """The scene as an SDFormat world, to be saved in `scenes/`."""
    root = _root()
    world = ET.SubElement(root, "world", name="scene")
    physics = ET.SubElement(world, "physics", name="default", type="ignored", default="true")
    _leaf(physics, "max_step_size", f"{scene.stability.timestep:.9g}")
    _leaf(physics, "real_time_factor", "1")
    _leaf(world, "gravity", text([0, 0, -scene.contact.gravity]))
    light = ET.SubElement(world, "light", name="sun", type="directional")
    _leaf(light, "cast_shadows", "true")
    _leaf(light, "diffuse", "0.8 0.8 0.8 1")
    _leaf(light, "direction", "-0.3 0.4 -0.9")
    _add_support(world, scene.support, scene.contact, f"../{SUPPORT_FOLDER}/")
    for name, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True):
        _add_object(world, name, asset, pose, scene.contact, f"../{object_folder(asset)}/")
    for camera in scene.cameras:
        _add_camera(world, camera)
    return xml_bytes(root)


def object_sdf(asset: ObjectAsset, contact: ContactConfig) -> bytes:
    """One object as a model, to be saved in the folder of its meshes."""
    root = _root()
    _add_object(root, asset.name, asset, None, contact, "")
    return xml_bytes(root)


def support_sdf(support: SupportAsset, contact: ContactConfig) -> bytes:
    """The support as a model, likewise."""
    root = _root()
    _add_support(root, support, contact, "")
    return xml_bytes(root)


def model_directives(scene: Scene) -> bytes:
    """The scene as Drake's directives, each object a model with the pose of its free body by default.

    Turns are an angle about an axis, because Drake's directives know no quaternions.
    """

    def model(name: str, file: str, **more: object) -> dict[str, object]:
        return {"add_model": {"name": name, "file": f"package://{_PACKAGE}/{file}", **more}}

    directives = [model("support", f"{SUPPORT_FOLDER}/support.sdf")]
    for name, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True):
        turn = Rotation.from_quat(pose[3:], scalar_first=True).as_rotvec()
        angle = float(np.linalg.norm(turn))
        axis = (turn / angle).tolist() if angle else [0.0, 0.0, 1.0]
        place = {
            "translation": pose[:3].tolist(),
            "rotation": _AngleAxis({"angle_deg": float(np.degrees(angle)), "axis": axis}),
        }
        file = f"{object_folder(asset)}/{asset.name}.sdf"
        directives.append(model(name, file, default_free_body_pose={"body": place}))
    return yaml.dump({"directives": directives}, Dumper=_Dumper, sort_keys=False).encode()


class _AngleAxis(dict[str, object]):
    """A mapping with Drake's tag."""


class _Dumper(yaml.SafeDumper):
    """YAML with Drake's tags."""


_Dumper.add_representer(
    _AngleAxis, lambda dumper, value: dumper.represent_mapping("!AngleAxis", value)
)


def _root() -> ET.Element:
    return ET.Element("sdf", {"version": "1.9", "xmlns:drake": _DRAKE})


def _leaf(parent: ET.Element, tag: str, content: str, **attributes: str) -> None:
    ET.SubElement(parent, tag, attributes).text = content


def _add_pose(parent: ET.Element, position: np.ndarray, quaternion: np.ndarray) -> None:
    w, x, y, z = quaternion
    _leaf(parent, "pose", text([*position, x, y, z, w]), rotation_format="quat_xyzw")


def _add_support(
    world: ET.Element, support: SupportAsset, contact: ContactConfig, folder: str
) -> None:
    model = ET.SubElement(world, "model", name="support")
    _leaf(model, "static", "true")
    link = ET.SubElement(model, "link", name="body")
    for surface in surfaces_of(support):
        _add_visual(link, surface, folder)
    for solid, kind in _solids(support):
        element = ET.SubElement(link, kind, name=f"{solid.name}-{kind}")
        _add_solid(element, solid, kind, folder, contact, contact.friction[0])


def _add_object(
    parent: ET.Element,
    name: str,
    asset: ObjectAsset,
    pose: np.ndarray | None,
    contact: ContactConfig,
    folder: str,
) -> None:
    """Adds a model; `folder` leads to the object's files."""
    model = ET.SubElement(parent, "model", name=name)
    if pose is not None:
        _add_pose(model, pose[:3], pose[3:])
    link = ET.SubElement(model, "link", name="body")
    inertial = ET.SubElement(link, "inertial")
    _leaf(inertial, "pose", text([*asset.center_of_mass, 0, 0, 0]))
    _leaf(inertial, "mass", text([asset.mass]))
    inertia = ET.SubElement(inertial, "inertia")
    for row, column in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        _leaf(inertia, f"i{'xyz'[row]}{'xyz'[column]}", text([asset.inertia[row][column]]))
    for surface in surfaces_of(asset):
        _add_visual(link, surface, folder)
    for solid, kind in _solids(asset):
        element = ET.SubElement(link, kind, name=solid.name)
        _add_solid(element, solid, kind, folder, contact, friction_of(asset, contact)[0])


def _add_camera(world: ET.Element, camera: FixedCamera) -> None:
    """A sensor on a model that stands still; SDFormat's cameras look along +x, +z is up."""
    right, up, backward = camera.rotation.T
    axes = np.stack([-backward, -right, up], axis=1)
    model = ET.SubElement(world, "model", name=f"camera-{camera.name}")
    _leaf(model, "static", "true")
    _add_pose(model, camera.position, Rotation.from_matrix(axes).as_quat(scalar_first=True))
    link = ET.SubElement(model, "link", name="body")
    sensor = ET.SubElement(link, "sensor", name=camera.name, type="camera")
    _leaf(sensor, "always_on", "true")
    _leaf(sensor, "update_rate", "30")
    lens = ET.SubElement(sensor, "camera")
    _leaf(lens, "horizontal_fov", text([np.radians(camera.fovx)]))
    image = ET.SubElement(lens, "image")
    _leaf(image, "width", str(camera.width))
    _leaf(image, "height", str(camera.height))
    clip = ET.SubElement(lens, "clip")
    _leaf(clip, "near", "0.01")
    _leaf(clip, "far", "20")


def _add_mesh(parent: ET.Element, file: str) -> ET.Element:
    mesh = ET.SubElement(ET.SubElement(parent, "geometry"), "mesh")
    _leaf(mesh, "uri", file)
    return mesh


def _add_visual(link: ET.Element, surface: VisualShape, folder: str) -> None:
    visual = ET.SubElement(link, "visual", name=surface.name)
    _add_mesh(visual, folder + surface.file)
    if surface.image is None:
        _add_colour(visual, surface.piece.rgba)
        _add_finish(visual, surface, folder)
    else:
        # The OBJ's own material names the image; one given here would stand in its place.
        _add_transparency(visual, surface.piece.rgba)


def _add_finish(visual: ET.Element, surface: VisualShape, folder: str) -> None:
    """What SDF says of physically based rendering; it has no map of roughness and metalness in one."""
    material = visual.find("material")
    finish = surface.piece.finish
    if material is None or finish is None:
        return
    metal = ET.SubElement(ET.SubElement(material, "pbr"), "metal")
    _leaf(metal, "roughness", text([finish.without_maps.roughness]))
    _leaf(metal, "metalness", text([finish.without_maps.metallic]))
    if surface.normal is not None:
        _leaf(metal, "normal_map", folder + surface.normal)


def _add_colour(visual: ET.Element, rgba: tuple[float, ...]) -> None:
    material = ET.SubElement(visual, "material")
    _leaf(material, "ambient", text(rgba))
    _leaf(material, "diffuse", text(rgba))
    _add_transparency(visual, rgba)


def _add_transparency(visual: ET.Element, rgba: tuple[float, ...]) -> None:
    if rgba[3] < 1:
        _leaf(visual, "transparency", text([1 - rgba[3]]))


def _add_solid(
    element: ET.Element,
    solid: CollisionShape,
    kind: str,
    folder: str,
    contact: ContactConfig,
    sliding: float,
) -> None:
    """What an element of this kind says of a solid: its shape, and its colour or how it touches."""
    if (box := solid.box) is not None:
        _add_pose(element, np.array(box.center), np.array(yaw_quaternion(box.yaw)))
        shape = ET.SubElement(ET.SubElement(element, "geometry"), "box")
        _leaf(shape, "size", text(2 * np.array(box.half_extents)))
    else:
        mesh = _add_mesh(element, folder + solid.file)
        if kind == "collision":
            ET.SubElement(mesh, "drake:declare_convex")
    if kind == "visual":
        _add_colour(element, solid.rgba)
        return
    # Gazebo takes the smaller of two coefficients, Drake their harmonic mean.
    # Torsional friction is left out: SDFormat's depends on a patch radius that was not measured.
    friction = ET.SubElement(ET.SubElement(element, "surface"), "friction")
    ode = ET.SubElement(friction, "ode")
    _leaf(ode, "mu", text([sliding]))
    _leaf(ode, "mu2", text([sliding]))
    proximity = ET.SubElement(element, "drake:proximity_properties")
    ET.SubElement(proximity, "drake:compliant_hydroelastic")
    _leaf(proximity, "drake:hydroelastic_modulus", text([HYDROELASTIC_MODULUS]))
    _leaf(proximity, "drake:hunt_crossley_dissipation", text([_DISSIPATION]))
    if sliding == contact.friction[0]:
        # Drake takes the coefficients above, which it would warn of beside its own.
        return
    for name in ("drake:mu_dynamic", "drake:mu_static"):
        _leaf(proximity, name, text([harmonic_of(sliding, contact.friction[0])]))
