"""URDF: one file per object and one for the support; where they stand is in a JSON file per scene.

Inertia is given along the principal axes, because some readers take the diagonal only. The contact element
is Bullet's own: Bullet multiplies the frictions of two bodies, so that each gets the square root of what the
pair is to have; other readers ignore it.
"""

from __future__ import annotations

import math
from xml.etree import ElementTree as ET

import numpy as np

from cluttergen_jax.assets.obj import part_name
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import PART_RGBA, SupportAsset
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.scene.export.frames import (
    euler_of,
    factor_of,
    friction_of,
    principal_of,
    text,
    xml_bytes,
)
from cluttergen_jax.scene.export.meshes import drawn_pieces, object_image, own_image, visual_name


def object_urdf(asset: ObjectAsset, contact: ContactConfig) -> bytes:
    """A free body of one link, whose frame is the object frame."""
    root, link = _robot(asset.name, contact, friction_of(asset, contact))
    principal = principal_of(asset)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(
        inertial, "origin", xyz=text(principal.center), rpy=text(euler_of(principal.turn))
    )
    ET.SubElement(inertial, "mass", value=text([asset.mass]))
    ixx, iyy, izz = (text([moment]) for moment in principal.moments)
    ET.SubElement(inertial, "inertia", ixx=ixx, iyy=iyy, izz=izz, ixy="0", ixz="0", iyz="0")
    for index, piece in enumerate(drawn_pieces(asset)):
        _add_visual(link, index, piece.rgba, object_image(piece))
    for index in range(len(asset.parts)):
        collision = ET.SubElement(link, "collision", name=f"part-{index}")
        ET.SubElement(ET.SubElement(collision, "geometry"), "mesh", filename=part_name(index))
    return xml_bytes(root)


def support_urdf(support: SupportAsset, contact: ContactConfig) -> bytes:
    """The fixed support in the world frame: collision, and surfaces where it has them. Its mass is zero."""
    root, link = _robot(support.name, contact, contact.friction)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "mass", value="0")
    ET.SubElement(inertial, "inertia", ixx="0", iyy="0", izz="0", ixy="0", ixz="0", iyz="0")
    for index, piece in enumerate(support.pieces):
        _add_visual(link, index, piece.rgba, own_image(piece))
    for index, box in enumerate(support.boxes):
        size = text(2 * np.array(box.half_extents))
        kinds = ["collision"] if support.pieces else ["collision", "visual"]
        for kind in kinds:
            element = ET.SubElement(link, kind, name=f"box-{index}")
            ET.SubElement(element, "origin", xyz=text(box.center), rpy=text([0, 0, box.yaw]))
            ET.SubElement(ET.SubElement(element, "geometry"), "box", size=size)
            if kind == "visual":
                _add_colour(element, f"box-{index}", box.rgba)
    for index in range(len(support.parts)):
        for kind in ["collision"] if support.pieces else ["collision", "visual"]:
            element = ET.SubElement(link, kind, name=f"part-{index}")
            ET.SubElement(ET.SubElement(element, "geometry"), "mesh", filename=part_name(index))
            if kind == "visual":
                _add_colour(element, f"part-{index}", PART_RGBA)
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
    ET.SubElement(
        own, "spinning_friction", value=text([friction[1] / (2 * math.sqrt(contact.friction[0]))])
    )
    return root, link


def _add_visual(link: ET.Element, index: int, rgba: tuple[float, ...], image: str | None) -> None:
    visual = ET.SubElement(link, "visual", name=f"visual-{index}")
    ET.SubElement(ET.SubElement(visual, "geometry"), "mesh", filename=visual_name(index))
    material = _add_colour(visual, f"visual-{index}", rgba)
    if image is not None:
        # The OBJ's own material says the same to readers that look there.
        ET.SubElement(material, "texture", filename=image)


def _add_colour(visual: ET.Element, name: str, rgba: tuple[float, ...]) -> ET.Element:
    material = ET.SubElement(visual, "material", name=name)
    ET.SubElement(material, "color", rgba=text(rgba))
    return material
