"""What a model file says of its bodies, before it is compiled: who moves them, and what they look like."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from cluttergen_jax.importing.readers.xml_tree import Element, parse_xml, plain_tag

_JOINT, _GEOM, _PULL = mujoco.mjtJoint, mujoco.mjtGeom, mujoco.mjtTrn
_TIES = (mujoco.mjtEq.mjEQ_WELD, mujoco.mjtEq.mjEQ_CONNECT)
_WORLD = ("", "world")
_MOVABLE = ("revolute", "prismatic", "continuous", "revolute2", "universal", "screw", "ball")
_NUM_SEEN_GROUPS = 3
_UNSAID = np.array([0.5, 0.5, 0.5, 1.0])
"""MuJoCo's colour of a geom that says none; a material's goes before it."""


@dataclass(frozen=True)
class BodyFacts:
    """One body that hangs on the world of an MJCF file, with all that hangs on it.

    Attributes:
      name: its name; empty if it has none.
      is_free: it moves in all six directions, by a free joint or by sliders and hinges, and nothing holds it.
      is_mocap: whoever runs the file says where it is.
      is_driven: an actuator moves one of its joints, or a mocap body carries it.
      chain: joints one after another, at most; all by which it moves as a whole are one, or none if free.
      has_joints: whether it moves at all.
      shape: digest of what is seen of it, or else of what collides, in its own frame; empty if nothing is.
      looks: digest of the shape with its colours.
      collides: whether any of it collides.
      is_translucent: whether one can look through all that is seen.
    """

    name: str
    is_free: bool
    is_mocap: bool
    is_driven: bool
    chain: int
    has_joints: bool
    shape: str
    looks: str
    collides: bool
    is_translucent: bool


def world_facts(path: Path) -> list[BodyFacts]:
    """Of each body that hangs on the world, in the file's order; [] where MuJoCo cannot parse the file."""
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, OSError):
        return []
    try:
        return [_facts(spec, body) for body in spec.worldbody.bodies]
    except UnicodeDecodeError:
        return []


def is_limbed(path: Path, in_a_row: int) -> bool:
    """Whether a URDF or SDF file has limbs as robots do, and states masses, as lamps of many joints do not.

    That is `in_a_row` movable joints one after another, or three limbs with one fewer.
    """
    root = parse_xml(path)
    elements = [] if root is None else list(root.iter())
    above: dict[str, tuple[str, int]] = {}
    for joint in elements:
        if plain_tag(joint) == "joint":
            is_own = joint.get("type") in _MOVABLE and joint.find("mimic") is None
            above[_link(joint, "child")] = _link(joint, "parent"), int(is_own)
    ends = above.keys() - {parent for parent, _ in above.values()}
    limbs = [_joints_above(link, above) for link in ends]
    is_weighed = sum(plain_tag(each) == "inertial" for each in elements) >= in_a_row
    is_long = max(limbs, default=0) >= in_a_row
    return is_weighed and (is_long or sum(limb >= in_a_row - 1 for limb in limbs) >= 3)


def _link(joint: Element, tag: str) -> str:
    """The link that a joint names: URDF's in an attribute, SDF's as text."""
    found = joint.find(tag)
    return "" if found is None else (found.get("link") or found.text or "").strip()


def _joints_above(link: str, above: dict[str, tuple[str, int]]) -> int:
    count, seen = 0, set()
    while link in above and link not in seen:
        seen.add(link)
        link, own = above[link]
        count += own
    return count


def _facts(spec: mujoco.MjSpec, root: mujoco.MjsBody) -> BodyFacts:
    bodies = list(_below(root))
    geoms = [geom for body in bodies for geom in body.geoms if geom.type != _GEOM.mjGEOM_PLANE]
    paired = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)} - {""}
    hitting = [geom for geom in geoms if geom.contype or geom.conaffinity or geom.name in paired]
    seen = [geom for geom in geoms if geom.group < _NUM_SEEN_GROUPS and _rgba(spec, geom)[3] > 0]
    shown = seen or hitting
    names = {body.name for body in bodies} - {""}
    is_free = _is_free(root)
    return BodyFacts(
        name=root.name,
        is_free=is_free and not _is_tied(spec, names, _WORLD),
        is_mocap=bool(root.mocap),
        is_driven=_has_motor(spec, bodies) or _is_tied(spec, names, _mocaps(spec)),
        chain=_chain(root, 0 if is_free else min(len(root.joints), 1)),
        has_joints=any(body.joints for body in bodies),
        shape=_digest(_form(spec, root, geom) for geom in shown),
        looks=_digest((_form(spec, root, geom), _colour(spec, geom)) for geom in shown),
        collides=bool(hitting),
        is_translucent=bool(seen) and all(_rgba(spec, geom)[3] < 1 for geom in seen),
    )


def _below(body: mujoco.MjsBody) -> Iterator[mujoco.MjsBody]:
    yield body
    for child in body.bodies:
        yield from _below(child)


def _is_free(body: mujoco.MjsBody) -> bool:
    kinds = Counter(joint.type for joint in body.joints)
    turns = kinds[_JOINT.mjJNT_HINGE] + 3 * kinds[_JOINT.mjJNT_BALL]
    return kinds[_JOINT.mjJNT_FREE] > 0 or (kinds[_JOINT.mjJNT_SLIDE] >= 3 and turns >= 3)


def _chain(body: mujoco.MjsBody, own: int) -> int:
    return own + max((_chain(child, len(child.joints)) for child in body.bodies), default=0)


def _mocaps(spec: mujoco.MjSpec) -> tuple[str, ...]:
    return tuple(body.name for body in spec.worldbody.bodies if body.mocap and body.name)


def _is_tied(spec: mujoco.MjSpec, names: set[str], others: tuple[str, ...]) -> bool:
    """Whether an equality holds one of the bodies `names` to one of the others."""
    ties = [{tie.name1, tie.name2} for tie in spec.equalities if tie.type in _TIES and tie.active]
    return any(tie & names and (tie - names) & set(others) for tie in ties)


def _has_motor(spec: mujoco.MjSpec, bodies: list[mujoco.MjsBody]) -> bool:
    joints = {joint.name for body in bodies for joint in body.joints} - {""}
    sites = {site.name for body in bodies for site in body.sites} - {""}
    parts = {
        _PULL.mjTRN_JOINT: joints,
        _PULL.mjTRN_JOINTINPARENT: joints,
        _PULL.mjTRN_SITE: sites,
        _PULL.mjTRN_BODY: {body.name for body in bodies} - {""},
    }
    return any(motor.target in parts.get(motor.trntype, ()) for motor in spec.actuators)


def _rgba(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> np.ndarray:
    material = spec.material(geom.material) if geom.material else None
    return material.rgba if material is not None and np.array_equal(geom.rgba, _UNSAID) else geom.rgba


def _colour(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> tuple[str, list[float]]:
    return geom.material, np.round(_rgba(spec, geom), 3).tolist()


def _form(spec: mujoco.MjSpec, root: mujoco.MjsBody, geom: mujoco.MjsGeom) -> tuple[object, ...]:
    """What decides the form of a geom, and where it stands in the body `root`."""
    places = [_place(geom)]
    body = geom.parent
    while body.id != root.id:
        places.append(_place(body))
        body = body.parent
    mesh = spec.mesh(geom.meshname) if geom.meshname else None
    size = np.round(np.nan_to_num([*geom.size, *geom.fromto]), 6).tolist()
    return int(geom.type), size, places, None if mesh is None else _mesh(spec, mesh)


def _place(thing: mujoco.MjsBody | mujoco.MjsGeom) -> list[float]:
    turn = thing.alt
    numbers = [*thing.pos, *thing.quat, *turn.axisangle, *turn.xyaxes, *turn.zaxis, *turn.euler]
    return np.round(np.nan_to_num(numbers), 6).tolist()


def _mesh(spec: mujoco.MjSpec, mesh: mujoco.MjsMesh) -> tuple[str, list[float]]:
    """A mesh by the bytes of its file, or by its own numbers where the model holds them."""
    folder = Path(spec.modelfiledir)
    places = (folder / spec.meshdir / mesh.file, folder / mesh.file)
    file = next((each for each in places if mesh.file and each.is_file()), None)
    content = np.asarray(mesh.uservert).tobytes() if file is None else file.read_bytes()
    return hashlib.sha256(mesh.file.encode() * (not content) + content).hexdigest(), list(mesh.scale)


def _digest(parts: Iterator[object]) -> str:
    """One for the same parts in any order; empty if there are none."""
    told = sorted(map(repr, parts))
    return hashlib.sha256("\n".join(told).encode()).hexdigest() if told else ""
