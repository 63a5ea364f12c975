"""URDF: several links and visuals, origins, scales, frozen joints, and a `label.json`."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

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
from cluttergen_jax.importing.readers.materials import GREY
from cluttergen_jax.importing.readers.mesh_file import read_mesh_file
from cluttergen_jax.importing.readers.model import Model, convex_parts, frozen, frozen_note
from cluttergen_jax.importing.readers.numbers import (
    all_numbers,
    length,
    number,
    numbers,
    wrong_attribute,
)
from cluttergen_jax.importing.readers.places import is_found_elsewhere, mesh_place
from cluttergen_jax.importing.readers.stand_ins import refuse_stand_in
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
    reader = _Reader(path, _materials(robot), max_side, {}, [])
    visuals, collisions = (
        [
            piece
            for link in robot.findall("link")
            for element in link.findall(tag)
            for piece in reader.pieces(element, poses[link.get("name", "")], scale)
        ]
        for tag in ("visual", "collision")
    )
    if not visuals and not collisions:
        raise AssetError(f"{path} has neither visual nor collision geometry")
    masses = {
        link.get("name", ""): mass
        for link in robot.findall("link")
        if (mass := _link_mass(path, link, poses[link.get("name", "")])) is not None
    }
    stated = combined(list(masses.values()))
    return Model(
        pieces=_seen(visuals, reader.notes) or collisions,
        parts=convex_parts([piece.mesh for piece in collisions]),
        stated=None if stated is None else stated.scaled(np.eye(3), scale),
        notes=tuple(dict.fromkeys([*_notes(robot, joints, masses), *joints.notes, *reader.notes])),
        density=_density(robot, path),
        colliding=tuple(piece.mesh for piece in collisions),
    )


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


def _seen(visuals: list[Piece], notes: list[str]) -> list[Piece]:
    """The visuals that can be seen; all of them, opaque, where none can."""
    seen = [piece for piece in visuals if piece.rgba[3] > 0]
    if len(seen) == len(visuals):
        return visuals
    if seen:
        notes.append(f"left out, as their alpha is 0: {len(visuals) - len(seen)} of {len(visuals)} surfaces")
        return seen
    notes.append("drawn opaque although its alpha is 0, as nothing else is there to be seen")
    return [replace(piece, rgba=(*piece.rgba[:3], 1.0)) for piece in visuals]


def _materials(robot: Element) -> dict[str, Element]:
    """What materials are called: those of the model itself, then those that a link defines."""
    defined = [each for each in (*robot.findall("material"), *robot.iter("material")) if len(each)]
    # The first of a name holds.
    return {each.get("name", ""): each for each in reversed(defined) if each.get("name")}


def _notes(robot: Element, joints: Joints, masses: dict[str, MassProperties]) -> Iterator[str]:
    movable = [joint for joint in robot.findall("joint") if joint.get("type") in _MOVABLE]
    yield from frozen_note(
        frozen(joint.get("name", ""), kind, joints.value(joint), is_turn=kind != "prismatic")
        for joint in movable
        if (kind := joint.get("type", ""))
    )
    solid = [link.get("name", "") for link in robot.findall("link") if link.find("visual") is not None]
    without = [name for name in solid if name not in masses]
    if masses and without:
        yield f"its file states no mass for {', '.join(map(repr, without))}"


def _link_mass(path: Path, link: Element, pose: np.ndarray) -> MassProperties | None:
    """A link's mass and inertia in the root link's frame; what cannot be read is NaN, to be refused later."""
    inertial = link.find("inertial")
    mass = None if inertial is None else inertial.find("mass")
    if inertial is None or mass is None:
        return None
    given = inertial.find("inertia")
    inertia = np.zeros((3, 3))
    if given is not None:
        for row, column in zip(*np.triu_indices(3), strict=True):
            moment = _weight(path, given, f"i{'xyz'[row]}{'xyz'[column]}")
            inertia[row, column] = inertia[column, row] = moment
    pose = pose @ origin(path, inertial)
    body = MassProperties(_weight(path, mass, "value"), np.zeros(3), inertia)
    return body.moved(pose[:3, :3], pose[:3, 3])


def _weight(path: Path, element: Element, name: str) -> float:
    """A mass or a moment: NaN where it is missing or one word that is no number."""
    words = element.get(name, "nan").split()
    if len(words) == 1 and not _is_number(words[0]):
        return math.nan
    return number(path, element, name, "nan", is_finite=False)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _density(robot: Element, path: Path) -> float | None:
    """kg/m^3: what Isaac Gym's <density> says of the links; None if they say nothing.

    Raises:
      AssetError: they say different things.
    """
    said = {length(path, each, "value") for each in robot.iterfind("link/inertial/density")}
    if len(said) > 1:
        raise AssetError(
            f"{path}: links of the densities {sorted(said)}", "one <density>, or a <mass> for each"
        )
    return next(iter(said), None)


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
class _Reader:
    """Turns geometry elements into pieces; remembers files, which visuals and collisions share."""

    path: Path
    materials: dict[str, Element]
    max_side: int
    files: dict[tuple[Path, Texture | None], list[Piece]]
    notes: list[str]

    def pieces(self, element: Element, link_pose: np.ndarray, scale: float) -> list[Piece]:
        pose = link_pose @ origin(self.path, element)
        rotation, translation = pose[:3, :3] * scale, pose[:3, 3] * scale
        colour, texture = self._colour(element), self._texture(element)
        pieces = self._geometry(element, texture)
        if texture is not None and all(piece.texture is None for piece in pieces):
            self.notes.append(f"an image on a <{element.tag}> without texture coordinates is left out")
        return [
            replace(
                piece.transformed(rotation, translation), rgba=colour if piece.rgba == GREY else piece.rgba
            )
            for piece in pieces
        ]

    def _geometry(self, element: Element, texture: Texture | None) -> list[Piece]:
        geometry = element.find("geometry")
        if geometry is None or not len(geometry):
            raise AssetError(f"{self.path}: a <{element.tag}> without geometry")
        form = geometry[0]
        if len(geometry) > 1:
            self.notes.append(f"of {len(geometry)} shapes in one <geometry> the first is taken, <{form.tag}>")
        if form.tag == "mesh":
            return self._mesh(form, texture)
        if form.tag == "box":
            return [Piece(primitives.box(self._box_size(form) / 2), GREY)]
        if form.tag == "sphere":
            return [Piece(primitives.ellipsoid(np.full(3, length(self.path, form, "radius"))), GREY)]
        if form.tag in ("cylinder", "capsule"):
            make = getattr(primitives, form.tag)
            radius, height = (length(self.path, form, name) for name in ("radius", "length"))
            return [Piece(make(radius, height / 2), GREY)]
        raise AssetError(f"{self.path}: geometry <{form.tag}>", "mesh, box, cylinder, sphere or capsule")

    def _box_size(self, form: Element) -> np.ndarray:
        size = numbers(self.path, form, "size", 3)
        if size.min() <= 0:
            raise wrong_attribute(self.path, form, "size", "3 numbers above 0")
        return size

    def _mesh(self, form: Element, texture: Texture | None) -> list[Piece]:
        name = form.get("filename", "")
        if not name.strip():
            raise AssetError(f"{self.path}: a <mesh> that names no file", '<mesh filename="...">')
        if (file := mesh_place(self.path, name)) is None:
            raise AssetError(
                f"{self.path} names mesh file {name!r}, which is not there", hint="restoring the file"
            )
        if is_found_elsewhere(name, file):
            self.notes.append(
                f"for {name!r}, which is not there, {file.name} is taken from {file.parent.name}/"
            )
        if (file, texture) not in self.files:
            self.files[file, texture], notes = read_mesh_file(file, self.max_side, texture)
            self.notes.extend(notes)
        factors = np.diag(self._scale(form))
        is_mirrored = np.linalg.det(factors) < 0
        out = []
        for piece in self.files[file, texture]:
            mesh = piece.mesh.transformed(factors, np.zeros(3))
            mesh = Mesh(mesh.vertices, mesh.faces[:, ::-1]) if is_mirrored else mesh
            out.append(replace(piece, mesh=mesh))
        return out

    def _scale(self, form: Element) -> np.ndarray:
        """f64[3]: one number holds for all three axes, as Drake and PyBullet have it."""
        values = all_numbers(self.path, form, "scale", "1 1 1")
        factors = np.array(values * 3 if len(values) == 1 else values)
        if len(factors) != 3 or not np.isfinite(factors).all() or not factors.all():
            raise wrong_attribute(self.path, form, "scale", "1 or 3 numbers other than 0")
        return factors

    def _material(self, element: Element, tag: str) -> Element | None:
        """The first of that tag in the element's material, or in what the file elsewhere calls so."""
        material = element.find("material")
        if material is None:
            return None
        name = material.get("name", "")
        if not len(material) and name and name not in self.materials:
            self.notes.append(f"material {name!r} is named and nowhere defined")
        found = material.find(tag)
        named = self.materials.get(name)
        return named.find(tag) if found is None and named is not None else found

    def _colour(self, element: Element) -> tuple[float, float, float, float]:
        """Opaque where alpha is missing."""
        colour = self._material(element, "color")
        if colour is None:
            return GREY
        values = all_numbers(self.path, colour, "rgba")
        if len(values) not in (3, 4) or not np.isfinite(values).all():
            raise wrong_attribute(self.path, colour, "rgba", "3 or 4 numbers from 0 to 1")
        r, g, b, a = np.clip([*values, 1.0][:4], 0, 1).tolist()
        if [r, g, b, a] != [*values, 1.0][:4]:
            self.notes.append(f"the colour {colour.get('rgba')!r} is clipped to 0 to 1")
        return (r, g, b, a)

    def _texture(self, element: Element) -> Texture | None:
        """The image of the element's material, for meshes that have none of their own."""
        named = self._material(element, "texture")
        name = "" if named is None else named.get("filename", "")
        if not name:
            return None
        if (file := mesh_place(self.path, name)) is None:
            self.notes.append(f"the image {name!r} is left out: it is not there")
            return None
        try:
            with Image.open(file) as image:
                return Texture.of(image, self.max_side)
        except (AssetError, OSError, ValueError, Image.DecompressionBombError) as error:
            reason = error.given if isinstance(error, AssetError) else str(error)
            self.notes.append(f"the image {name!r} is left out: {reason}")
            return None
