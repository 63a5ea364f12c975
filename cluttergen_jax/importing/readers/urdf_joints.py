"""The joints of a URDF: where each is frozen, and where that puts the links."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import trimesh

from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.numbers import all_numbers, number, numbers, wrong_attribute
from cluttergen_jax.importing.readers.xml_tree import Element

_LIMITED = ("revolute", "prismatic")
_TURNS = ("revolute", "continuous")
_KINDS = ("fixed", "floating", "planar", *_LIMITED, *_TURNS)


class Joints:
    """All joints of a URDF, each frozen at its lower limit, at zero, or where the joint is that it mimics.

    Args:
      path: the file, for messages.

    Attributes:
      notes: what was decided about them, in words.
    """

    def __init__(self, robot: Element, path: Path) -> None:
        self._path = path
        self._links = [link.get("name", "") for link in robot.findall("link")]
        self._joints = robot.findall("joint")
        self._by_name = {joint.get("name", ""): joint for joint in self._joints}
        self.notes = [
            f"joint {joint.get('name')!r} is of type {kind!r}, which URDF does not have: it is fixed"
            for joint in self._joints
            if (kind := joint.get("type")) not in _KINDS
        ]

    def value(self, joint: Element) -> float:
        """Radians or metres.

        Raises:
          AssetError: it mimics a joint that is not there, or itself.
        """
        factor, offset, seen = 1.0, 0.0, {joint.get("name", "")}
        while (mimic := joint.find("mimic")) is not None:
            name = mimic.get("joint", "")
            if name not in self._by_name:
                raise wrong_attribute(self._path, mimic, "joint", ", ".join(map(repr, self._by_name)))
            if name in seen:
                raise AssetError(f"{self._path}: joint {name!r} mimics itself", "a joint that mimics none")
            seen.add(name)
            offset += factor * number(self._path, mimic, "offset", "0")
            factor *= number(self._path, mimic, "multiplier", "1")
            joint = self._by_name[name]
        return factor * self._lower_limit(joint) + offset

    def _lower_limit(self, joint: Element) -> float:
        limit = joint.find("limit")
        if limit is None or joint.get("type") not in _LIMITED:
            return 0.0
        value = number(self._path, limit, "lower", "0", is_finite=False)
        return value if math.isfinite(value) else 0.0

    def link_poses(self) -> dict[str, np.ndarray]:
        """f64[4, 4] from each link to the root link.

        Raises:
          AssetError: the links are no tree.
        """
        children: dict[str, list[Element]] = {}
        for joint in self._joints:
            children.setdefault(self._link_of(joint, "parent"), []).append(joint)
        below = {self._link_of(joint, "child") for joint in self._joints}
        roots = [name for name in self._links if name not in below]
        if len(roots) > 1:
            told = ", ".join(map(repr, roots))
            self.notes.append(f"its links {told} hang on no joint: all are put at the model's origin")
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
            raise AssetError(f"{self._path}: link {lost[0]!r} hangs in a loop of joints", "a tree of links")
        return poses

    def _link_of(self, joint: Element, tag: str) -> str:
        link = joint.find(tag)
        if link is None or not link.get("link"):
            raise AssetError(f"{self._path}: joint {joint.get('name')!r} names no {tag} link")
        return link.get("link", "")

    def _motion(self, joint: Element) -> np.ndarray:
        kind = joint.get("type")
        if kind not in (*_LIMITED, *_TURNS):
            return np.eye(4)
        value, axis = self.value(joint), self._axis(joint)
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
        if len(values) != 3 or not np.isfinite(values).all() or not (any(values) or self.value(joint) == 0):
            raise wrong_attribute(self._path, element, "xyz", "3 numbers, not all of them 0")
        return np.array(values)


def origin(path: Path, element: Element) -> np.ndarray:
    """f64[4, 4]: the <origin> of an element; none is the identity."""
    place = element.find("origin")
    if place is None:
        return np.eye(4)
    roll, pitch, yaw = numbers(path, place, "rpy", 3, "0 0 0")
    pose = trimesh.transformations.euler_matrix(roll, pitch, yaw, "sxyz")
    pose[:3, 3] = numbers(path, place, "xyz", 3, "0 0 0")
    return pose
