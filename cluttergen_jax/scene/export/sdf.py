"""SDFormat 1.9: a world for each scene, for Gazebo and Drake; and Drake's directives, with a model an object.

Drake's own elements say that a part is convex, and make parts and boxes compliant hydroelastic bodies, which
touch over areas: its point contact has one point for each two bodies, on which nothing flat stands still.
Other readers skip them.
"""

from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.obj import part_name
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.support import PART_RGBA, SupportAsset
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.geometry import yaw_quaternion
from cluttergen_jax.scene import FixedCamera, Scene
from cluttergen_jax.scene.export.frames import friction_of, harmonic_of, text, xml_bytes
from cluttergen_jax.scene.export.meshes import (
    SUPPORT_FOLDER,
    drawn_pieces,
    object_folder,
    visual_name,
)

VERSION = "1.9"
_DRAKE = "http://drake.mit.edu"
HYDROELASTIC_MODULUS = 1e9
"""Pascals: of hard plastic. As soft as rubber (1e7), tables give way at edges, and what overhangs tips."""
DISSIPATION = 50.0
"""Seconds per metre, of Hunt and Crossley: nothing springs back from more than 2 cm/s."""


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
        _add_object(world, name, asset, pose, scene.contact, f"../{object_folder(asset.name)}/")
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
        return {"add_model": {"name": name, "file": f"package://{PACKAGE}/{file}", **more}}

    directives = [model("support", f"{SUPPORT_FOLDER}/support.sdf")]
    for name, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True):
        turn = Rotation.from_quat(pose[3:], scalar_first=True).as_rotvec()
        angle = float(np.linalg.norm(turn))
        axis = (turn / angle).tolist() if angle else [0.0, 0.0, 1.0]
        place = {
            "translation": pose[:3].tolist(),
            "rotation": _AngleAxis({"angle_deg": float(np.degrees(angle)), "axis": axis}),
        }
        file = f"{object_folder(asset.name)}/{asset.name}.sdf"
        directives.append(model(name, file, default_free_body_pose={"body": place}))
    return yaml.dump({"directives": directives}, Dumper=_Dumper, sort_keys=False).encode()


PACKAGE = "cluttergen"
"""What the export's folder is called in the URIs of directives."""
PACKAGE_XML = f'<package format="2"><name>{PACKAGE}</name></package>\n'


class _AngleAxis(dict[str, object]):
    """A mapping with Drake's tag."""


class _Dumper(yaml.SafeDumper):
    """YAML with Drake's tags."""


_Dumper.add_representer(
    _AngleAxis, lambda dumper, value: dumper.represent_mapping("!AngleAxis", value)
)


def _root() -> ET.Element:
    return ET.Element("sdf", {"version": VERSION, "xmlns:drake": _DRAKE})


def _leaf(parent: ET.Element, tag: str, content: str, **attributes: str) -> ET.Element:
    element = ET.SubElement(parent, tag, attributes)
    element.text = content
    return element


def _add_pose(parent: ET.Element, position: np.ndarray, quaternion: np.ndarray) -> None:
    w, x, y, z = quaternion
    _leaf(parent, "pose", text([*position, x, y, z, w]), rotation_format="quat_xyzw")


def _add_support(
    world: ET.Element, support: SupportAsset, contact: ContactConfig, folder: str
) -> None:
    model = ET.SubElement(world, "model", name="support")
    _leaf(model, "static", "true")
    link = ET.SubElement(model, "link", name="body")
    for index, piece in enumerate(support.pieces):
        _add_visual(link, index, folder, piece)
    for index, box in enumerate(support.boxes):
        kinds = ["collision"] if support.pieces else ["collision", "visual"]
        for kind in kinds:
            element = ET.SubElement(link, kind, name=f"box-{index}-{kind}")
            _add_pose(element, np.array(box.center), np.array(yaw_quaternion(box.yaw)))
            shape = ET.SubElement(ET.SubElement(element, "geometry"), "box")
            _leaf(shape, "size", text(2 * np.array(box.half_extents)))
            if kind == "visual":
                _add_colour(element, box.rgba)
            else:
                _add_contact(element, contact, contact.friction[0])
    for index in range(len(support.parts)):
        for kind in ["collision"] if support.pieces else ["collision", "visual"]:
            element = ET.SubElement(link, kind, name=f"part-{index}-{kind}")
            mesh = _add_mesh(element, folder + part_name(index))
            if kind == "visual":
                _add_colour(element, PART_RGBA)
            else:
                ET.SubElement(mesh, "drake:declare_convex")
                _add_contact(element, contact, contact.friction[0])


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
    for index, piece in enumerate(drawn_pieces(asset)):
        _add_visual(link, index, folder, piece)
    for index in range(len(asset.parts)):
        collision = ET.SubElement(link, "collision", name=f"part-{index}")
        mesh = _add_mesh(collision, folder + part_name(index))
        ET.SubElement(mesh, "drake:declare_convex")
        _add_contact(collision, contact, friction_of(asset, contact)[0])


def _add_camera(world: ET.Element, camera: FixedCamera) -> None:
    """A sensor on a model that stands still; SDFormat's cameras look along +x, +z is up."""
    right, up, backward = camera.rotation.T
    turn = Rotation.from_matrix(np.stack([-backward, -right, up], axis=1)).as_quat(
        scalar_first=True
    )
    model = ET.SubElement(world, "model", name=f"camera-{camera.name}")
    _leaf(model, "static", "true")
    _add_pose(model, camera.position, turn)
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


def _add_visual(link: ET.Element, index: int, folder: str, piece: Piece) -> None:
    visual = ET.SubElement(link, "visual", name=f"visual-{index}")
    _add_mesh(visual, folder + visual_name(index))
    if piece.texture is None:
        _add_colour(visual, piece.rgba)
    elif piece.rgba[3] < 1:
        # The OBJ's own material names the image; one given here would stand in its place.
        _leaf(visual, "transparency", text([1 - piece.rgba[3]]))


def _add_colour(visual: ET.Element, rgba: tuple[float, ...]) -> None:
    material = ET.SubElement(visual, "material")
    _leaf(material, "ambient", text(rgba))
    _leaf(material, "diffuse", text(rgba))
    if rgba[3] < 1:
        _leaf(visual, "transparency", text([1 - rgba[3]]))


def _add_contact(collision: ET.Element, contact: ContactConfig, sliding: float) -> None:
    # Gazebo takes the smaller of two coefficients, Drake their harmonic mean.
    # Torsional friction is left out: SDFormat's depends on a patch radius that was not measured.
    friction = ET.SubElement(ET.SubElement(collision, "surface"), "friction")
    ode = ET.SubElement(friction, "ode")
    _leaf(ode, "mu", text([sliding]))
    _leaf(ode, "mu2", text([sliding]))
    proximity = ET.SubElement(collision, "drake:proximity_properties")
    ET.SubElement(proximity, "drake:compliant_hydroelastic")
    _leaf(proximity, "drake:hydroelastic_modulus", text([HYDROELASTIC_MODULUS]))
    _leaf(proximity, "drake:hunt_crossley_dissipation", text([DISSIPATION]))
    for name in ("drake:mu_dynamic", "drake:mu_static"):
        _leaf(proximity, name, text([harmonic_of(sliding, contact.friction[0])]))
