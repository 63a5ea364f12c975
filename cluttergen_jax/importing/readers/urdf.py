"""URDF: several links and visuals, origins, scales, frozen joints, and a `label.json`."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import trimesh

from cluttergen_jax.assets.config import MAX_TEXTURE
from cluttergen_jax.assets.mass import MassProperties
from cluttergen_jax.assets.shape import Joint
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.damage import refuse_stand_in
from cluttergen_jax.importing.readers.links import (
    Link,
    SurfaceLook,
    Surfaces,
    check_unique,
    link_mass,
    rigid,
)
from cluttergen_jax.importing.readers.materials import GREY
from cluttergen_jax.importing.readers.model import (
    Model,
    alone_note,
    check_joints,
    frozen_note,
    opened_joint,
    sound_mass,
    unknown_body,
)
from cluttergen_jax.importing.readers.opening import mesh_place
from cluttergen_jax.importing.readers.source import ObjectFile
from cluttergen_jax.importing.readers.xml_tree import (
    BROKEN,
    Element,
    all_numbers,
    number,
    numbers,
    parse_numbers,
    read_xml,
    without_namespace,
    wrong_attribute,
)
from cluttergen_jax.schema import read_json

XACRO = ".xacro"
_ELEMENT = re.compile(rb"<(xacro:\w+)")
_EXPRESSION = re.compile(r"\$\{[^{}$]*+\}|\$\([^()$]*+\)")
_NAMESPACE = re.compile(r"\{.*xacro\}")


def refuse_xacro(path: Path, robot: Element | None = None) -> None:
    """Refuses an unprocessed xacro; without its root, by the text of a file that cannot be parsed.

    Raises:
      AssetError: it says how to process it.
    """
    sign = _sign_in_text(path) if robot is None else _sign_in_tree(robot)
    if sign:
        raise AssetError(
            f"{path} is an unprocessed xacro: it has {sign}", "URDF", how_to_process(path)
        )


def how_to_process(path: Path) -> str:
    """The command that makes URDF of a xacro."""
    stem = path.name.removesuffix(XACRO).removesuffix(".urdf")
    return f"xacro {path.name} > {stem if path.suffix == XACRO else stem + '_plain'}.urdf"


def _sign_in_text(path: Path) -> str:
    try:
        found = _ELEMENT.search(path.read_bytes())
    except OSError:
        return ""
    return f"<{found[1].decode(errors='replace')}>" if found else ""


def _sign_in_tree(robot: Element) -> str:
    """The first thing that a processed file has no more; empty where there is none."""
    for element in robot.iter():
        if isinstance(element.tag, str) and (found := _NAMESPACE.match(element.tag)):
            return f"<xacro:{element.tag[found.end() :]}>"
        for name, value in element.items():
            if _EXPRESSION.search(value):
                return f'{name}="{value}"'
    return ""


_LIMITED = ("revolute", "prismatic")
_TURNS = ("revolute", "continuous")
_KINDS = ("fixed", "floating", "planar", *_LIMITED, *_TURNS)


class Joints:
    """All joints of a URDF, each frozen at its lower limit, at zero, or where the joint is that it mimics.

    Args:
      path: the file, for messages.
      opened: where joints are to be instead, metres or degrees, by name.

    Attributes:
      notes: what was decided about them, in words.
    """

    def __init__(
        self, robot: Element, path: Path, opened: Mapping[str, float] | None = None
    ) -> None:
        self._path = path
        self._opened = opened or {}
        self._links = [link.get("name", "") for link in robot.findall("link")]
        self._joints = robot.findall("joint")
        self._by_name = {joint.get("name", ""): joint for joint in self._joints}
        check_unique(path, robot.findall("link"))
        check_unique(path, self._joints)
        self.notes = [
            f"joint {joint.get('name')!r} is of type {kind!r}, which URDF does not have: it is fixed"
            for joint in self._joints
            if (kind := joint.get("type")) not in _KINDS
        ]
        self.notes += _notes_of_turns(robot)

    def value(self, joint: Element) -> float:
        """Radians or metres.

        Raises:
          AssetError: it mimics a joint that is not there, or itself.
        """
        factor = 1.0
        offset = 0.0
        seen = {joint.get("name", "")}
        while (mimic := joint.find("mimic")) is not None:
            name = mimic.get("joint", "")
            if name not in self._by_name:
                raise wrong_attribute(
                    self._path, mimic, "joint", ", ".join(map(repr, self._by_name))
                )
            if name in seen:
                raise AssetError(
                    f"{self._path}: joint {name!r} mimics itself", "a joint that mimics none"
                )
            seen.add(name)
            offset += factor * number(self._path, mimic, "offset", "0")
            factor *= number(self._path, mimic, "multiplier", "1")
            joint = self._by_name[name]
        return factor * self._lower_limit(joint) + offset

    def _lower_limit(self, joint: Element) -> float:
        name = joint.get("name", "")
        (lower, upper) = self._limits(joint)
        if name in self._opened:
            is_turn = joint.get("type") in _TURNS
            place, notes = opened_joint(name, self._opened[name], lower, upper, is_turn)
            self.notes += [note for note in notes if note not in self.notes]
            return place
        return lower if math.isfinite(lower) else 0.0

    def _limits(self, joint: Element) -> tuple[float, float]:
        limit = joint.find("limit")
        if limit is None or joint.get("type") not in _LIMITED:
            return -math.inf, math.inf
        lower, upper = (
            number(self._path, limit, end, "0", is_finite=False) for end in ("lower", "upper")
        )
        return lower, upper

    def link_poses(self) -> dict[str, np.ndarray]:
        """f64[4, 4] from each link to the root link.

        Raises:
          AssetError: the links are no tree.
        """
        children: dict[str, list[Element]] = {}
        above: dict[str, Element] = {}
        for joint in self._joints:
            children.setdefault(self._link_of(joint, "parent"), []).append(joint)
            child = self._link_of(joint, "child")
            if child in above:
                both = f"{above[child].get('name')!r} and {joint.get('name')!r}"
                given = f"{self._path}: link {child!r} is the child of joints {both}"
                raise AssetError(given, "a tree of links: each is the child of one joint")
            above[child] = joint
        roots = [name for name in self._links if name not in above]
        if len(roots) > 1:
            names = ", ".join(map(repr, roots))
            self.notes.append(
                f"its links {names} hang on no joint: all are put at the model's origin"
            )
        poses = {name: np.eye(4) for name in roots}
        todo = list(poses)
        while todo:
            parent = todo.pop()
            for joint in children.get(parent, []):
                child = self._link_of(joint, "child")
                if child not in poses:
                    poses[child] = poses[parent] @ origin(self._path, joint) @ self._motion(joint)
                    todo.append(child)
        if lost := [name for name in self._links if name not in poses]:
            raise AssetError(
                f"{self._path}: link {lost[0]!r} hangs in a loop of joints", "a tree of links"
            )
        return poses

    def movable(
        self,
        poses: Mapping[str, np.ndarray],
        links: Sequence[str],
        scale: float,
        moved: Mapping[str, MassProperties | None],
    ) -> tuple[Joint, ...]:
        """The hinges and slides that mimic no other.

        Args:
          poses: of `link_poses`; links: by piece, the name of its link; scale: factor on all lengths.
          moved: links whose joints are meant, with their masses in the model's frame.
        """
        above = {self._link_of(joint, "child"): joint for joint in self._joints}
        kinds = (*_LIMITED, *_TURNS)
        own = [
            each
            for each in self._joints
            if each.get("type") in kinds and each.find("mimic") is None
        ]
        own = [
            each for each in own if self._axis(each).any() and self._link_of(each, "child") in moved
        ]

        def mover(link: str) -> int:
            """The joint that moves a link, by number; -1 for none."""
            while link in above:
                if above[link] in own:
                    return own.index(above[link])
                link = self._link_of(above[link], "parent")
            return -1

        movers = [mover(link) for link in links]
        found = []
        for place, joint in enumerate(own):
            T_model_joint = poses[self._link_of(joint, "child")]
            axis = self._axis(joint)
            axis = T_model_joint[:3, :3] @ (axis / np.linalg.norm(axis))
            is_turn = joint.get("type") in _TURNS
            limits = self._limits(joint)
            made = Joint(
                name=joint.get("name", ""),
                kind="hinge" if is_turn else "slide",
                anchor=tuple(T_model_joint[:3, 3].tolist()),
                axis=tuple(axis.tolist()),
                value=self.value(joint),
                range=limits if np.isfinite(limits).all() else None,
                parent=mover(self._link_of(joint, "parent")),
                pieces=tuple(piece for piece, by in enumerate(movers) if by == place),
                damping=self._dynamics(joint, "damping"),
                friction=self._dynamics(joint, "friction"),
            )
            masses = [
                mass for name, mass in moved.items() if mass is not None and mover(name) == place
            ]
            made = made.with_mass(sound_mass(masses))
            found.append(made.transform(np.eye(3), scale, np.zeros(3)))
        return tuple(found)

    def _dynamics(self, joint: Element, name: str) -> float | None:
        """What its <dynamics> says, if that is above zero: many programs write zeros for want of others."""
        dynamics = joint.find("dynamics")
        value = 0.0 if dynamics is None else number(self._path, dynamics, name, "0")
        return value if value > 0 else None

    def links_below(self, link: str) -> list[str]:
        """A link and all that hang on it.

        Raises:
          ConfigError: there is no such link.
        """
        if link not in self._links:
            raise unknown_body(link, self._path, self._links, "link")
        found = [link]
        for name in found:
            own = [each for each in self._joints if self._link_of(each, "parent") == name]
            found += [child for each in own if (child := self._link_of(each, "child")) not in found]
        return found

    def frozen_notes(self, body: str) -> tuple[str, ...]:
        """What is said of joints that stay as they are, of all links or of one that is taken alone."""
        movable = [joint for joint in self._joints if joint.get("type") in _MOVABLE]
        own: list[Element] = []
        if body:
            links = self.links_below(body)
            movable = [joint for joint in movable if self._link_of(joint, "child") in links]
            own = [joint for joint in movable if self._link_of(joint, "child") == body]
        frozen = frozen_note(
            (joint.get("name", ""), kind, self.value(joint), kind != "prismatic")
            for joint in movable
            if joint not in own and (kind := joint.get("type", ""))
        )
        parent = self._link_of(own[0], "parent") if own else ""
        return (*frozen, *alone_note([joint.get("name", "") for joint in own], parent))

    def _link_of(self, joint: Element, tag: str) -> str:
        link = joint.find(tag)
        if link is None or not link.get("link"):
            raise AssetError(f"{self._path}: joint {joint.get('name')!r} names no {tag} link")
        name = link.get("link", "")
        if name not in self._links:
            given = f"{self._path}: joint {joint.get('name')!r} has the {tag} {name!r}, which is no link"
            raise AssetError(given, ", ".join(map(repr, self._links)))
        return name

    def _motion(self, joint: Element) -> np.ndarray:
        kind = joint.get("type")
        if kind not in (*_LIMITED, *_TURNS):
            return np.eye(4)
        value = self.value(joint)
        axis = self._axis(joint)
        if value == 0:
            return np.eye(4)
        if kind in _TURNS:
            return trimesh.transformations.rotation_matrix(value, axis)
        return trimesh.transformations.translation_matrix(value * axis / np.linalg.norm(axis))

    def _axis(self, joint: Element) -> np.ndarray:
        """f64[3], of any length. Numbers missing at its end are zero: some published files need that."""
        element = joint.find("axis")
        if element is None:
            return np.array([1.0, 0.0, 0.0])
        values = all_numbers(self._path, element, "xyz")
        if 0 < len(values) < 3:
            self.notes.append(
                f"axis {element.get('xyz')!r} of joint {joint.get('name')!r}: the rest is taken for 0"
            )
            values += [0.0] * (3 - len(values))
        if (
            len(values) != 3
            or not np.isfinite(values).all()
            or not (any(values) or self.value(joint) == 0)
        ):
            raise wrong_attribute(self._path, element, "xyz", "3 numbers, not all of them 0")
        return np.array(values)


_MOST_RADIANS = 2 * math.pi + 0.01


def _notes_of_turns(robot: Element) -> Iterator[str]:
    """Of angles that look like degrees."""
    for text in dict.fromkeys(each.get("rpy", "") for each in robot.iter("origin")):
        if any(abs(angle) > _MOST_RADIANS for angle in parse_numbers(text) or ()):
            yield f'rpy="{text}" is read as radians, as URDF has it: more than a whole turn'


def origin(path: Path, element: Element) -> np.ndarray:
    """f64[4, 4]: the <origin> of an element; none is the identity."""
    place = element.find("origin")
    if place is None:
        return np.eye(4)
    roll, pitch, yaw = numbers(path, place, "rpy", 3, "0 0 0")
    pose = trimesh.transformations.euler_matrix(roll, pitch, yaw, "sxyz")
    pose[:3, 3] = numbers(path, place, "xyz", 3, "0 0 0")
    return pose


_MOVABLE = ("revolute", "prismatic", "continuous", "floating", "planar")


def read_urdf(
    source: ObjectFile,
    max_side: int = MAX_TEXTURE,
    opened: Mapping[str, float] | None = None,
) -> Model:
    """The model as one rigid thing; its parts are its collision meshes if all of them are convex.

    Pieces are the visuals, or the collision elements where there are none. `globalScaling` in a
    `label.json` beside the file scales everything; its `ori_rpy` repeats origins that the URDF already
    has and is not applied. Masses are kilograms whatever the scale.

    Args:
      source: its body is a link that is taken alone, with what hangs on it; all if empty.
      max_side: pixels; larger images are shrunk.
      opened: where joints are to be, see `Joints`.

    Raises:
      AssetError: the file, or one that it names, is missing or cannot be understood; the message names it.
      ConfigError: there is no such joint or link, or the joint does not go so far.
    """
    path = source.path
    body = source.body
    robot = _parse(path)
    movable = (joint for joint in robot.findall("joint") if joint.find("mimic") is None)
    names = [
        joint.get("name", "") for joint in movable if joint.get("type") in (*_LIMITED, *_TURNS)
    ]
    check_joints(opened or (), names, path)
    joints = Joints(robot, path, opened)
    poses = joints.link_poses()
    scale = _global_scaling(path)
    surfaces = Surfaces(path, max_side, notes=joints.notes)
    links = [
        Link(link, poses[link.get("name", "")], partial(origin, path))
        for link in robot.findall("link")
    ]
    if body:
        own = joints.links_below(body)
        links = [link for link in links if link.name in own]
    model = rigid(
        links, surfaces, _Looks(_materials(robot), surfaces).of, joints.frozen_notes(body), scale
    )
    names = [link.name for link in links]
    moved = {link.name: link_mass(path, link) for link in links if link.name != body}
    return replace(
        model,
        joints=joints.movable(poses, [names[number] for number in model.link_of], scale, moved),
    )


def _parse(path: Path) -> Element:
    """The root of a URDF; an unprocessed xacro is none."""
    try:
        robot = read_xml(path)
    except BROKEN as error:
        refuse_xacro(path)
        refuse_stand_in(path)
        hint = "saving it in UTF-8" if "encoding" in str(error) else ""
        raise AssetError(f"{path} cannot be read as URDF: {error}", hint=hint) from error
    refuse_xacro(path, robot)
    without_namespace(robot)
    if robot.tag != "robot":
        raise AssetError(
            f"{path} is no URDF: its root is <{robot.tag}>", "a file whose root is <robot>"
        )
    return robot


def _materials(robot: Element) -> dict[str, Element]:
    """What materials are called: those of the model itself, then those that a link defines."""
    defined = [each for each in (*robot.findall("material"), *robot.iter("material")) if len(each)]
    # The first of a name holds.
    return {each.get("name", ""): each for each in reversed(defined) if each.get("name")}


def _global_scaling(path: Path) -> float:
    label = path.parent / "label.json"
    if not label.is_file():
        return 1.0
    try:
        scale = float(read_json(label).get("globalScaling", 1.0))
    except (OSError, ValueError, TypeError, AttributeError, OverflowError) as error:
        raise AssetError(f"{label} cannot be read: {error}") from error
    if not (math.isfinite(scale) and scale > 0):
        raise AssetError(f"{label} has globalScaling {scale}", "a number above zero")
    return scale


@dataclass(frozen=True)
class _Looks:
    """The colours and images that a URDF names."""

    materials: dict[str, Element]
    surfaces: Surfaces

    def of(self, element: Element) -> SurfaceLook:
        """What the material of a <visual> says, here or elsewhere in the file."""
        colour = self._material(element, "color")
        texture = self._material(element, "texture")
        name = "" if texture is None else texture.get("filename", "")
        return SurfaceLook(
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
