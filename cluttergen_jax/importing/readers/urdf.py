"""URDF: several links and visuals, origins, scales, frozen joints, and a `label.json`."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from cluttergen_jax.assets.config import MAX_TEXTURE
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.links import Link, rigid
from cluttergen_jax.importing.readers.materials import GREY
from cluttergen_jax.importing.readers.model import Model, frozen, frozen_note
from cluttergen_jax.importing.readers.places import mesh_place
from cluttergen_jax.importing.readers.stand_ins import refuse_stand_in
from cluttergen_jax.importing.readers.surfaces import Look, Surfaces
from cluttergen_jax.importing.readers.urdf_joints import Joints, origin
from cluttergen_jax.importing.readers.xacro import refuse_xacro
from cluttergen_jax.importing.readers.xml_tree import BROKEN, Element, without_namespace

_MOVABLE = ("revolute", "prismatic", "continuous", "floating", "planar")


def read_urdf(path: Path, max_side: int = MAX_TEXTURE) -> Model:
    """The model as one rigid thing; its parts are its collision meshes if all of them are convex.

    Pieces are the visuals, or the collision elements where there are none. `globalScaling` in a
    `label.json` beside the file scales everything; its `ori_rpy` repeats origins that the URDF already
    has and is not applied. Masses are kilograms whatever the scale.

    Args:
      max_side: pixels; larger images are shrunk.

    Raises:
      AssetError: the file, or one that it names, is missing or cannot be understood; the message names it.
    """
    robot = _parsed(path)
    joints = Joints(robot, path)
    poses = joints.link_poses()
    scale = _global_scaling(path)
    surfaces = Surfaces(path, max_side, notes=joints.notes)
    links = [
        Link(link, partial(_placed, path, poses[link.get("name", "")])) for link in robot.findall("link")
    ]
    return rigid(links, surfaces, _Looks(_materials(robot), surfaces).of, _notes(robot, joints), scale)


def _placed(path: Path, pose: np.ndarray, element: Element) -> np.ndarray:
    return pose @ origin(path, element)


def _parsed(path: Path) -> Element:
    """The root of a URDF; an unprocessed xacro is none."""
    try:
        robot = ElementTree.parse(path).getroot()
    except BROKEN as error:
        refuse_xacro(path)
        refuse_stand_in(path)
        raise AssetError(f"{path} cannot be read as URDF: {error}") from error
    refuse_xacro(path, robot)
    without_namespace(robot)
    if robot.tag != "robot":
        raise AssetError(f"{path} is no URDF: its root is <{robot.tag}>", "a file whose root is <robot>")
    return robot


def _materials(robot: Element) -> dict[str, Element]:
    """What materials are called: those of the model itself, then those that a link defines."""
    defined = [each for each in (*robot.findall("material"), *robot.iter("material")) if len(each)]
    # The first of a name holds.
    return {each.get("name", ""): each for each in reversed(defined) if each.get("name")}


def _notes(robot: Element, joints: Joints) -> tuple[str, ...]:
    movable = [joint for joint in robot.findall("joint") if joint.get("type") in _MOVABLE]
    return frozen_note(
        frozen(joint.get("name", ""), kind, joints.value(joint), is_turn=kind != "prismatic")
        for joint in movable
        if (kind := joint.get("type", ""))
    )


def _global_scaling(path: Path) -> float:
    label = path.parent / "label.json"
    if not label.is_file():
        return 1.0
    try:
        scale = float(json.loads(label.read_text(encoding="utf-8")).get("globalScaling", 1.0))
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise AssetError(f"{label} cannot be read: {error}") from error
    if not (math.isfinite(scale) and scale > 0):
        raise AssetError(f"{label} has globalScaling {scale}", "a number above zero")
    return scale


@dataclass(frozen=True)
class _Looks:
    """The colours and images that a URDF names."""

    materials: dict[str, Element]
    surfaces: Surfaces

    def of(self, element: Element) -> Look:
        """What the material of a <visual> says, here or elsewhere in the file."""
        colour, texture = self._material(element, "color"), self._material(element, "texture")
        name = "" if texture is None else texture.get("filename", "")
        return Look(
            GREY if colour is None else self.surfaces.colour(colour, "rgba"),
            self.surfaces.image(name, mesh_place(self.surfaces.path, name)) if name else None,
        )

    def _material(self, element: Element, tag: str) -> Element | None:
        """The first of that tag in the element's material, or in what the file elsewhere calls so."""
        material = element.find("material")
        if material is None:
            return None
        name = material.get("name", "")
        if not len(material) and name and name not in self.materials:
            self.surfaces.notes.append(f"material {name!r} is named and nowhere defined")
        found = material.find(tag)
        named = self.materials.get(name)
        return named.find(tag) if found is None and named is not None else found
