"""What is no object for a table: larger or heavier than the limits, or no object of its model file.

- An actor is moved by a mocap body or by actuators, has limbs of four joints or more, as robots have, or is
  called a gripper, a finger or a hand.
- A marker collides with nothing, beside bodies of its file that do.
- Scenery is fixed to the world beside bodies that are free, or stands without joints alike in at least half
  of the files of its folder that hold several bodies. What all bodies of a file do is no sign of scenery.
- A ghost is the likeness of another body beside it: it collides with nothing, and is half transparent or
  called so.
- Of bodies that are alike in files that hold several, the first is the object.
"""

from __future__ import annotations

import hashlib
import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from cluttergen_jax.assets.body import with_mass
from cluttergen_jax.assets.config import MAX_MASS, MAX_SIZE
from cluttergen_jax.assets.mesh import join_meshes
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.shape import Shape
from cluttergen_jax.config import check_positive
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.limited import call_limited
from cluttergen_jax.importing.readers import ObjectFile
from cluttergen_jax.importing.readers.mjcf_compile import check_mjcf_extent, collides, parse_mjcf
from cluttergen_jax.importing.readers.xml_tree import Element, parse_xml, plain_tag

_JOINT = mujoco.mjtJoint
_GEOM = mujoco.mjtGeom
_PULL = mujoco.mjtTrn
_TIES = (mujoco.mjtEq.mjEQ_WELD, mujoco.mjtEq.mjEQ_CONNECT)
_WORLD = ("", "world")
_MOVABLE = ("revolute", "prismatic", "continuous", "revolute2", "universal", "screw", "ball")
_NUM_SEEN_GROUPS = 3
_UNSAID = np.array([0.5, 0.5, 0.5, 1.0])
"""MuJoCo's colour of a geom that says none; a material's goes before it."""


@dataclass(frozen=True)
class BodyFacts:
    """One body that hangs on the world of an MJCF file, with all that hangs on it."""

    name: str  # Empty if it has none.
    is_free: bool  # It moves in all six directions (free joint, or sliders and hinges), and nothing holds it.
    is_mocap: bool  # The program that runs the file moves it.
    is_driven: bool  # An actuator moves one of its joints, or a mocap body carries it.
    chain: int  # Joints one after another, at most; all by which it moves as a whole are one, none if free.
    has_joints: bool  # Whether it moves at all.
    shape: str  # Digest of what is seen of it, or else of what collides, in its own frame; "" if nothing is.
    looks: str  # Digest of the shape with its colours.
    collides: bool  # Whether any of it collides.
    is_translucent: bool  # Whether one can look through all that is seen.


def world_facts(path: Path) -> list[BodyFacts]:
    """Of each body that hangs on the world, in the file's order; [] where MuJoCo cannot parse the file."""
    try:
        check_mjcf_extent(path)
        spec = parse_mjcf(path)[0]
    except (ValueError, OSError, AssetError):
        return []
    try:
        return [_facts(spec, body) for body in spec.worldbody.bodies]
    except UnicodeDecodeError:
        return []


def has_limbs(path: Path, in_a_row: int) -> bool:
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
    count = 0
    seen = set()
    while link in above and link not in seen:
        seen.add(link)
        link, own = above[link]
        count += own
    return count


def _facts(spec: mujoco.MjSpec, root: mujoco.MjsBody) -> BodyFacts:
    bodies = list(_below(root))
    placed = [each for each in _geoms_below(root) if each.geom.type != _GEOM.mjGEOM_PLANE]
    hitting = [each for each in placed if collides(spec, each.geom)]
    seen = [
        each
        for each in placed
        if each.geom.group < _NUM_SEEN_GROUPS and _rgba(spec, each.geom)[3] > 0
    ]
    shown = seen or hitting
    names = {body.name for body in bodies} - {""}
    mocaps = tuple(body.name for body in spec.worldbody.bodies if body.mocap and body.name)
    is_free = _is_free(root)

    def colour(geom: mujoco.MjsGeom) -> tuple[str, list[float]]:
        return geom.material, np.round(_rgba(spec, geom), 3).tolist()

    return BodyFacts(
        name=root.name,
        is_free=is_free and not _has_tie(spec, names, _WORLD),
        is_mocap=bool(root.mocap),
        is_driven=_has_motor(spec, bodies) or _has_tie(spec, names, mocaps),
        chain=_chain(root, 0 if is_free else min(len(root.joints), 1)),
        has_joints=any(body.joints for body in bodies),
        shape=_digest(_form(spec, each) for each in shown),
        looks=_digest((_form(spec, each), colour(each.geom)) for each in shown),
        collides=bool(hitting),
        is_translucent=bool(seen) and all(_rgba(spec, each.geom)[3] < 1 for each in seen),
    )


def _below(body: mujoco.MjsBody) -> Iterator[mujoco.MjsBody]:
    yield body
    for child in body.bodies:
        yield from _below(child)


class _Placed(NamedTuple):
    """A geom, and the places of the bodies that it is in, from its own up to the one below the root."""

    geom: mujoco.MjsGeom
    bodies: tuple[list[float], ...]


def _geoms_below(body: mujoco.MjsBody, above: tuple[list[float], ...] = ()) -> Iterator[_Placed]:
    # Bodies that are not compiled have no numbers to be known by: places are kept on the way down.
    yield from (_Placed(geom, above) for geom in body.geoms)
    for child in body.bodies:
        yield from _geoms_below(child, (_place(child), *above))


def _is_free(body: mujoco.MjsBody) -> bool:
    kinds = Counter(joint.type for joint in body.joints)
    turns = kinds[_JOINT.mjJNT_HINGE] + 3 * kinds[_JOINT.mjJNT_BALL]
    return kinds[_JOINT.mjJNT_FREE] > 0 or (kinds[_JOINT.mjJNT_SLIDE] >= 3 and turns >= 3)


def _chain(body: mujoco.MjsBody, own: int) -> int:
    return own + max((_chain(child, len(child.joints)) for child in body.bodies), default=0)


def _has_tie(spec: mujoco.MjSpec, names: set[str], others: tuple[str, ...]) -> bool:
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
    return (
        material.rgba if material is not None and np.array_equal(geom.rgba, _UNSAID) else geom.rgba
    )


def _form(spec: mujoco.MjSpec, placed: _Placed) -> tuple[object, ...]:
    """What decides the form of a geom, and where it stands in the body that it is of."""
    geom = placed.geom
    places = [_place(geom), *placed.bodies]
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
    return hashlib.sha256(mesh.file.encode() * (not content) + content).hexdigest(), list(
        mesh.scale
    )


def _digest(parts: Iterator[object]) -> str:
    """One for the same parts in any order; empty if there are none."""
    texts = sorted(map(repr, parts))
    return hashlib.sha256("\n".join(texts).encode()).hexdigest() if texts else ""


MIN_CHAIN = 4
"""Joints one after another: doors, drawers, phones and lids have fewer, arms and legs more."""
_ROBOT = f"limbs as robots have: {MIN_CHAIN} joints in a row, or three limbs of {MIN_CHAIN - 1}"
_GRIPPER = re.compile(
    r"gripper|robotiq|wsg[-_]?\d|(^|[-_])(l|r|left|right)[-_]finger|^finger|(^|[-_])hand($|[-_]\d)"
)
_GHOST = re.compile(r"[-_ ](visual|vis|ghost)$")


@dataclass(frozen=True)
class _Body:
    """A source with what its file says of it; None where that is not known."""

    source: ObjectFile
    facts: BodyFacts | None
    siblings: tuple[BodyFacts, ...]

    @property
    def is_of_several(self) -> bool:
        return len(self.siblings) > 1

    @property
    def folder(self) -> Path:
        return self.source.path.parent


def why_no_objects(sources: Sequence[ObjectFile]) -> dict[int, tuple[str, str]]:
    """Reason and detail, in words, by the index of each source that is no object of its own."""
    bodies = _bodies(sources)
    reasons = {i: (why, "") for i, body in enumerate(bodies) if (why := _why_alone(body))}
    reasons |= {i: why for i, why in _ghosts(bodies).items() if i not in reasons}
    reasons |= {i: why for i, why in _in_many_files(bodies).items() if i not in reasons}
    rest = {i: body for i, body in enumerate(bodies) if i not in reasons}
    return reasons | _copies(rest)


def _bodies(sources: Sequence[ObjectFile]) -> list[_Body]:
    of_file: dict[Path, tuple[BodyFacts, ...]] = {}
    for path in {source.path for source in sources if source.kind == "mjcf"}:
        # What cannot be read is made an object, and says so there.
        with suppress(AssetError):
            of_file[path] = tuple(call_limited(path, world_facts, path))
    found = []
    for source in sources:
        siblings = of_file.get(source.path, ())
        found.append(_Body(source, _find_body(siblings, source.body), siblings))
    return found


def _find_body(siblings: Sequence[BodyFacts], body: str) -> BodyFacts | None:
    if body.startswith("#"):
        index = int(body[1:])
        return siblings[index] if index < len(siblings) else None
    fitting = [each for each in siblings if each.name == body or not body]
    return fitting[0] if len(fitting) == 1 else None


def _why_alone(body: _Body) -> str:
    """What a body's own file says against it; empty if nothing."""
    facts = body.facts
    if _GRIPPER.search((body.source.body.removeprefix("#") or body.source.path.stem).lower()):
        return "a robot's gripper, finger or hand, by its name"
    if facts is None:
        path = body.source.path
        is_robot = False
        if body.source.kind in ("urdf", "sdf"):
            with suppress(AssetError):
                is_robot = call_limited(path, has_limbs, path, MIN_CHAIN)
        return _ROBOT if is_robot else ""
    if actor := _why_actor(facts):
        return actor
    if body.is_of_several and not facts.shape:
        return "nothing of it is seen or collides"
    if not facts.collides and any(each.collides for each in body.siblings):
        return "a marker: it collides with nothing, beside bodies that do"
    others = [each for each in body.siblings if each.is_free and not _why_actor(each)]
    if others and not facts.is_free:
        return "fixed to the world, beside bodies that are free"
    return ""


def _why_actor(facts: BodyFacts) -> str:
    if facts.is_mocap:
        return "a mocap body: whoever runs the file moves it"
    if facts.is_driven:
        return "moved by actuators, or by a mocap body"
    return _ROBOT if facts.chain >= MIN_CHAIN else ""


def _ghosts(bodies: Sequence[_Body]) -> dict[int, tuple[str, str]]:
    reasons = {}
    for i, body in enumerate(bodies):
        facts = body.facts
        title = body.source.body or body.source.path.stem
        if facts is None or facts.collides or not facts.shape:
            continue
        if not (facts.is_translucent or _GHOST.search(title.lower())):
            continue
        twin = next((each for each in bodies if each is not body and _is_twin(each, body)), None)
        if twin is not None:
            reasons[i] = (
                "a likeness of another body, which collides with nothing",
                f"of {twin.source.path.name}",
            )
    return reasons


def _is_twin(other: _Body, ghost: _Body) -> bool:
    """Whether `other` is the body whose likeness `ghost` is: of the same form, or of the same name."""
    if other.folder != ghost.folder or (other.facts is not None and not other.facts.collides):
        return False
    named = [each.source.body.removeprefix("#") or each.source.path.stem for each in (other, ghost)]
    is_namesake = named[0].lower() == _GHOST.sub("", named[1].lower())
    return is_namesake or (
        other.facts is not None
        and ghost.facts is not None
        and other.facts.shape == ghost.facts.shape
    )


def _in_many_files(bodies: Sequence[_Body]) -> dict[int, tuple[str, str]]:
    """Bodies without joints that at least half of a folder's files of several bodies have."""
    files: defaultdict[Path, dict[Path, tuple[BodyFacts, ...]]] = defaultdict(dict)
    for body in bodies:
        if body.is_of_several:
            files[body.folder][body.source.path] = body.siblings
    reasons = {}
    for i, body in enumerate(bodies):
        if body.facts is None or not body.is_of_several or body.facts.has_joints:
            continue
        here = list(files[body.folder].values())
        count = _num_files(body.facts.shape, here)
        has_others = any(
            each.shape and _num_files(each.shape, here) < count for each in body.siblings
        )
        if count >= max(2, len(here) / 2) and has_others:
            reasons[i] = "stands alike in several files", ""
    return reasons


def _num_files(shape: str, files: Sequence[tuple[BodyFacts, ...]]) -> int:
    return sum(any(each.shape == shape for each in siblings) for siblings in files)


def _copies(bodies: dict[int, _Body]) -> dict[int, tuple[str, str]]:
    """Bodies that look like one of another file; a file's only body comes first, and always stays."""
    first: dict[str, _Body] = {}
    reasons = {}
    for i, body in sorted(bodies.items(), key=lambda item: item[1].is_of_several):
        if body.facts is None or not body.facts.looks:
            continue
        twin = first.setdefault(body.facts.looks, body)
        if body.is_of_several and twin.source.path != body.source.path:
            reasons[i] = "alike in another file", f"in {twin.source.path.name}"
    return reasons


_HAIR = 1e-4
_FURNITURE = 2.0
"""Metres."""


SEVERAL = (
    "several things that do not touch, in one file: import one by its name behind '#', or say so in "
    "objects.toml, ['FILE#NAME'] take = true"
)
"""Why a file of several things is left out."""


@dataclass(frozen=True)
class LeftOut:
    """A body that could be read and is no object for a table."""

    name: str  # Its file, from the folder on that was searched, and "#" with the body where it holds several.
    reason: str  # Why it was left out, in words; the same for all of a kind.
    detail: str = ""  # What is to be said of this one; may be empty.


@dataclass(frozen=True)
class Limits:
    """What an object on a table may be.

    The largest side of its box is what counts, whichever way it points: an object is turned, and laid on any
    of its sides, and what is as long as the table is wide cannot lie across it.

    Attributes:
      size: metres that its largest side stays below.
      mass: kilograms, at most.
    """

    size: float = MAX_SIZE
    mass: float = MAX_MASS

    def __post_init__(self) -> None:
        check_positive(self, "size", "mass")

    def why_left_out(self, name: str, sides: np.ndarray, mass: float = 0.0) -> LeftOut | None:
        """What is said of an object that is too large or too heavy; None if it is neither.

        Args:
          name: see `LeftOut`.
          sides: f64[3], of its box, metres.
          mass: kilograms; 0 if not known.
        """
        detail = " x ".join(f"{side:.2f}" for side in sides) + " m"
        detail += f", {mass:,.4g} kg" if mass > 0 else ""
        if sides.max() > max(self.size, _FURNITURE) - _HAIR:
            reason = "furniture by its size, 2 m or more (`cluttergen import --support` takes it)"
            return LeftOut(name, reason, detail)
        if sides.max() > self.size - _HAIR:
            reason = (
                f"too large for the usual table: a side of {self.size:g} m or more (`max_size`)"
            )
            return LeftOut(name, reason, detail)
        if mass > self.mass:
            return LeftOut(
                name, f"too heavy for a table: more than {self.mass:g} kg (`max_mass`)", detail
            )
        return None

    def why_shape_left_out(self, name: str, shape: Shape) -> LeftOut | None:
        """The same of a shape before a body is made of it; it is weighed only where it may be too heavy."""
        whole = join_meshes([piece.mesh for piece in shape.pieces])
        sides = np.ptp(whole.vertices[np.unique(whole.faces)], axis=0)
        stated = 0.0 if shape.stated is None else shape.stated.body.mass
        mass = stated if shape.mass is None else shape.mass
        is_light = max(mass, sides.prod() * shape.density) <= self.mass
        if sides.max() <= self.size - _HAIR and not is_light:
            mass = with_mass(shape)[2].mass
        return self.why_left_out(name, sides, mass)

    def why_body_left_out(self, name: str, asset: ObjectAsset) -> LeftOut | None:
        """The same of a body."""
        return self.why_left_out(name, 2 * np.asarray(asset.half_extents), asset.mass)
