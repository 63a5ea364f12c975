"""robosuite: objects and the support as its `MujocoXMLObject` reads them."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np

from cluttergen_jax.assets.obj import part_name
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.support import PART_RGBA, SupportAsset
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.geometry import yaw_quaternion
from cluttergen_jax.scene.export.frames import text
from cluttergen_jax.scene.export.meshes import drawn_pieces, object_image, own_image, visual_name
from cluttergen_jax.scene.xml import contact_attributes, own_contact_attributes, weightless

# robosuite's geom groups.
_COLLIDES = "0"
_DRAWN = "1"


def robosuite_xml(asset: ObjectAsset, contact: ContactConfig, region: bool = False) -> bytes:
    """A free object; robosuite adds the joint.

    Args:
      region: add the box `reg_bbox`, by which RoboCasa knows an object's size.
    """
    root, assets, body, shell = _model(asset.name)
    moments = np.asarray(asset.inertia)[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    ET.SubElement(
        body,
        "inertial",
        pos=text(asset.center_of_mass),
        mass=text([asset.mass]),
        fullinertia=text(moments),
    )
    touch = contact_attributes(contact) | own_contact_attributes(asset, contact)
    for index in range(len(asset.parts)):
        ET.SubElement(assets, "mesh", name=f"part-{index}", file=part_name(index))
        place = {"type": "mesh", "mesh": f"part-{index}"}
        ET.SubElement(body, "geom", touch | place, group=_COLLIDES, rgba="0 0 0 0")
    for index, piece in enumerate(drawn_pieces(asset)):
        _add_visual(assets, body, index, piece, object_image(piece))
    if region:
        box = {"type": "box", "pos": "0 0 0", "size": text(asset.half_extents)}
        ET.SubElement(body, "geom", _unseen((0.0, 0.0, 0.0, 0.0)) | box, name="reg_bbox")
    _add_sites(shell, -asset.half_extents[2], asset.half_extents)
    return _bytes(root)


def support_xml(support: SupportAsset, contact: ContactConfig) -> bytes:
    """The fixed support in the world frame, for a `MujocoXMLObject` without joints."""
    root, assets, body, shell = _model("support")
    for box in support.boxes:
        place = {
            "type": "box",
            "pos": text(box.center),
            "quat": text(yaw_quaternion(box.yaw)),
            "size": text(box.half_extents),
        }
        ET.SubElement(
            body, "geom", place | contact_attributes(contact), group=_COLLIDES, rgba="0 0 0 0"
        )
        if not support.pieces:
            ET.SubElement(body, "geom", place | _unseen(box.rgba))
    for index in range(len(support.parts)):
        name = part_name(index).removesuffix(".obj")
        ET.SubElement(assets, "mesh", name=name, file=part_name(index))
        place = {"type": "mesh", "mesh": name}
        ET.SubElement(
            body, "geom", place | contact_attributes(contact), group=_COLLIDES, rgba="0 0 0 0"
        )
        if not support.pieces:
            ET.SubElement(body, "geom", place | _unseen(PART_RGBA))
    for index, piece in enumerate(support.pieces):
        _add_visual(assets, body, index, piece, own_image(piece))
    _add_sites(shell, 0.0, np.array([*support.region.half_extents, support.top]))
    return _bytes(root)


def _model(name: str) -> tuple[ET.Element, ET.Element, ET.Element, ET.Element]:
    root = ET.Element("mujoco", model=name)
    assets = ET.SubElement(root, "asset")
    shell = ET.SubElement(ET.SubElement(root, "worldbody"), "body")
    return root, assets, ET.SubElement(shell, "body", name="object"), shell


def _unseen(rgba: tuple[float, ...]) -> dict[str, str]:
    """Attributes of a geom that is drawn, touches nothing and weighs nothing."""
    return {"contype": "0", "conaffinity": "0", "group": _DRAWN, "mass": "0", "rgba": text(rgba)}


def _add_visual(
    assets: ET.Element, body: ET.Element, index: int, piece: Piece, image: str | None
) -> None:
    name = f"visual-{index}"
    rgba = piece.rgba
    ET.SubElement(assets, "mesh", weightless(piece), name=name, file=visual_name(index))
    geom = ET.SubElement(body, "geom", _unseen(rgba), type="mesh", mesh=name)
    if image is not None:
        texture = f"image-{index}"
        ET.SubElement(assets, "texture", name=texture, type="2d", file=image)
        ET.SubElement(
            assets, "material", name=name, texture=texture, specular="0.25", shininess="0.35"
        )
        geom.set("material", name)


def _add_sites(shell: ET.Element, bottom: float, reach: np.ndarray) -> None:
    """The three sites by which robosuite knows an object's size."""
    places = {
        "bottom_site": [0, 0, bottom],
        "top_site": [0, 0, reach[2]],
        "horizontal_radius_site": [reach[0], reach[1], 0],
    }
    for name, place in places.items():
        ET.SubElement(shell, "site", name=name, pos=text(place), size="0.005", rgba="0 0 0 0")


def _bytes(root: ET.Element) -> bytes:
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8") + b"\n"
