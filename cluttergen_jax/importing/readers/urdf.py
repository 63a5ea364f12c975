"""URDF: several links and visuals, origins, scales, joints at their lower limit, and a `label.json`."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import trimesh
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

Element = ElementTree.Element
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
    try:
        robot = ElementTree.parse(path).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise AssetError(f"{path} cannot be read as URDF: {error}") from error
    poses = _link_poses(robot, path)
    materials = {each.get("name", ""): each for each in robot.findall("material")}
    scale = _global_scaling(path)
    reader = _Reader(path, materials, max_side, {}, [])
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
        if (mass := _link_mass(link, poses[link.get("name", "")])) is not None
    }
    stated = combined(list(masses.values()))
    return Model(
        pieces=visuals or collisions,
        parts=convex_parts([piece.mesh for piece in collisions]),
        stated=None if stated is None else stated.scaled(np.eye(3), scale),
        notes=tuple(dict.fromkeys([*_notes(robot, masses), *reader.notes])),
    )


def _notes(robot: Element, masses: dict[str, MassProperties]) -> Iterator[str]:
    movable = [joint for joint in robot.findall("joint") if joint.get("type") in _MOVABLE]
    yield from frozen_note(
        frozen(joint.get("name", ""), kind, _joint_value(joint), is_turn=kind != "prismatic")
        for joint in movable
        if (kind := joint.get("type", ""))
    )
    solid = [link.get("name", "") for link in robot.findall("link") if link.find("visual") is not None]
    without = [name for name in solid if name not in masses]
    if masses and without:
        yield f"its file states no mass for {', '.join(map(repr, without))}"


def _link_mass(link: Element, pose: np.ndarray) -> MassProperties | None:
    """A link's mass and inertia in the root link's frame; what cannot be read is NaN, to be refused later."""
    inertial = link.find("inertial")
    mass = None if inertial is None else inertial.find("mass")
    if inertial is None or mass is None:
        return None
    given = inertial.find("inertia")
    inertia = np.zeros((3, 3))
    if given is not None:
        for row, column in zip(*np.triu_indices(3), strict=True):
            inertia[row, column] = inertia[column, row] = _lenient(given, f"i{'xyz'[row]}{'xyz'[column]}")
    pose = pose @ _origin(inertial)
    body = MassProperties(_lenient(mass, "value"), np.zeros(3), inertia)
    return body.moved(pose[:3, :3], pose[:3, 3])


def _lenient(element: Element, name: str) -> float:
    try:
        return float(element.get(name, "nan"))
    except ValueError:
        return math.nan


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
        pose = link_pose @ _origin(element)
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
        if form.tag == "mesh":
            return self._mesh(form, texture)
        if form.tag == "box":
            return [Piece(primitives.box(_floats(form.get("size"), 3) / 2), GREY)]
        if form.tag == "sphere":
            return [Piece(primitives.ellipsoid(np.full(3, _number(form, "radius"))), GREY)]
        if form.tag in ("cylinder", "capsule"):
            make = getattr(primitives, form.tag)
            return [Piece(make(_number(form, "radius"), _number(form, "length") / 2), GREY)]
        raise AssetError(f"{self.path}: geometry <{form.tag}>", "mesh, box, cylinder, sphere or capsule")

    def _mesh(self, form: Element, texture: Texture | None) -> list[Piece]:
        name = form.get("filename", "")
        if (file := mesh_place(self.path, name)) is None:
            raise AssetError(
                f"{self.path} names mesh file {name!r}, which is not there", hint="restoring the file"
            )
        if (file, texture) not in self.files:
            self.files[file, texture], notes = read_mesh_file(file, self.max_side, texture)
            self.notes.extend(notes)
        factors = np.diag(_floats(form.get("scale", "1 1 1"), 3))
        is_mirrored = np.linalg.det(factors) < 0
        out = []
        for piece in self.files[file, texture]:
            mesh = piece.mesh.transformed(factors, np.zeros(3))
            mesh = Mesh(mesh.vertices, mesh.faces[:, ::-1]) if is_mirrored else mesh
            out.append(replace(piece, mesh=mesh))
        return out

    def _material(self, element: Element, tag: str) -> Element | None:
        """The first of that tag in the element's material, or in the model's material of that name."""
        material = element.find("material")
        if material is None:
            return None
        found = material.find(tag)
        named = self.materials.get(material.get("name", ""))
        return named.find(tag) if found is None and named is not None else found

    def _colour(self, element: Element) -> tuple[float, float, float, float]:
        colour = self._material(element, "color")
        if colour is None:
            return GREY
        r, g, b, a = _floats(colour.get("rgba"), 4)
        return (float(r), float(g), float(b), float(a))

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


def mesh_place(urdf: Path, name: str) -> Path | None:
    """The file that a URDF names, None if it is not there; `package://` is looked up around the URDF."""
    plain = name.removeprefix("file://").removeprefix("package://").removeprefix("model://")
    tails = [plain]
    if name.startswith(("package://", "model://")):
        tails.append(plain.partition("/")[2])
    for root in (urdf.parent, *list(urdf.resolve().parents)[1:5]):
        for tail in tails:
            if tail and (root / tail).is_file():
                return root / tail
    return None


def _link_poses(robot: Element, path: Path) -> dict[str, np.ndarray]:
    """f64[4, 4] from each link to the root link, every joint at its lower limit."""
    joints = robot.findall("joint")
    children: dict[str, list[Element]] = {}
    for joint in joints:
        children.setdefault(_link_of(joint, "parent", path), []).append(joint)
    below = {_link_of(joint, "child", path) for joint in joints}
    names = [link.get("name", "") for link in robot.findall("link")]
    poses = {name: np.eye(4) for name in names if name not in below}
    todo = list(poses)
    while todo:
        parent = todo.pop()
        for joint in children.get(parent, []):
            child = _link_of(joint, "child", path)
            if child not in poses:
                poses[child] = poses[parent] @ _origin(joint) @ _joint_motion(joint)
                todo.append(child)
    lost = [name for name in names if name not in poses]
    if lost:
        raise AssetError(f"{path}: link {lost[0]!r} hangs in a loop of joints", "a tree of links")
    return poses


def _link_of(joint: Element, tag: str, path: Path) -> str:
    link = joint.find(tag)
    if link is None or not link.get("link"):
        raise AssetError(f"{path}: joint {joint.get('name')!r} names no {tag} link")
    return link.get("link", "")


def _joint_value(joint: Element) -> float:
    """Where a joint is frozen, radians or metres: at its lower limit, if it has one."""
    limit = joint.find("limit")
    value = _number(limit, "lower", "0") if limit is not None else 0.0
    return value if joint.get("type") in ("revolute", "prismatic") and math.isfinite(value) else 0.0


def _joint_motion(joint: Element) -> np.ndarray:
    kind, value = joint.get("type"), _joint_value(joint)
    if kind not in ("revolute", "prismatic"):
        return np.eye(4)
    axis_element = joint.find("axis")
    axis = _floats(axis_element.get("xyz") if axis_element is not None else "1 0 0", 3)
    axis = axis / max(float(np.linalg.norm(axis)), 1e-12)
    if kind == "revolute":
        return trimesh.transformations.rotation_matrix(value, axis)
    return trimesh.transformations.translation_matrix(value * axis)


def _origin(element: Element) -> np.ndarray:
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    roll, pitch, yaw = _floats(origin.get("rpy", "0 0 0"), 3)
    pose = trimesh.transformations.euler_matrix(roll, pitch, yaw, "sxyz")
    pose[:3, 3] = _floats(origin.get("xyz", "0 0 0"), 3)
    return pose


def _number(element: Element, name: str, default: str = "nan") -> float:
    """One attribute as a number."""
    return float(_floats(element.get(name, default), 1)[0])


def _floats(text: str | None, count: int) -> np.ndarray:
    """`count` numbers; missing ones at the end are zero, as some published axes leave them out."""
    try:
        values = [float(each) for each in (text or "").split()]
    except ValueError as error:
        raise AssetError(f"{text!r} where {count} numbers are expected") from error
    if not values or len(values) > count:
        raise AssetError(f"{text!r} where {count} numbers are expected")
    return np.array(values + [0.0] * (count - len(values)))
