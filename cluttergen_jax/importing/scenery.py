"""Which bodies of model files are no objects: what stands around, what moves by itself, and ghosts of others.

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

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cluttergen_jax.importing.readers import ObjectFile
from cluttergen_jax.importing.readers.bodies import BodyFacts, is_limbed, world_facts

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
    told = {i: (why, "") for i, body in enumerate(bodies) if (why := _why_alone(body))}
    told |= {i: why for i, why in _ghosts(bodies).items() if i not in told}
    told |= {i: why for i, why in _in_many_files(bodies).items() if i not in told}
    rest = {i: body for i, body in enumerate(bodies) if i not in told}
    return told | _copies(rest)


def _bodies(sources: Sequence[ObjectFile]) -> list[_Body]:
    of_file: dict[Path, tuple[BodyFacts, ...]] = {}
    for path in {source.path for source in sources if source.kind == "mjcf"}:
        of_file[path] = tuple(world_facts(path))
    found = []
    for source in sources:
        siblings = of_file.get(source.path, ())
        found.append(_Body(source, _chosen(siblings, source.body), siblings))
    return found


def _chosen(siblings: Sequence[BodyFacts], body: str) -> BodyFacts | None:
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
        is_robot = body.source.kind in ("urdf", "sdf") and is_limbed(body.source.path, MIN_CHAIN)
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
    told = {}
    for i, body in enumerate(bodies):
        facts = body.facts
        title = body.source.body or body.source.path.stem
        if facts is None or facts.collides or not facts.shape:
            continue
        if not (facts.is_translucent or _GHOST.search(title.lower())):
            continue
        twin = next((each for each in bodies if each is not body and _is_twin(each, body)), None)
        if twin is not None:
            told[i] = "a likeness of another body, which collides with nothing", f"of {twin.source.path.name}"
    return told


def _is_twin(other: _Body, ghost: _Body) -> bool:
    """Whether `other` is the body whose likeness `ghost` is: of the same form, or of the same name."""
    if other.folder != ghost.folder or (other.facts is not None and not other.facts.collides):
        return False
    named = [each.source.body.removeprefix("#") or each.source.path.stem for each in (other, ghost)]
    is_namesake = named[0].lower() == _GHOST.sub("", named[1].lower())
    return is_namesake or (
        other.facts is not None and ghost.facts is not None and other.facts.shape == ghost.facts.shape
    )


def _in_many_files(bodies: Sequence[_Body]) -> dict[int, tuple[str, str]]:
    """Bodies without joints that at least half of a folder's files of several bodies have."""
    files: defaultdict[Path, dict[Path, tuple[BodyFacts, ...]]] = defaultdict(dict)
    for body in bodies:
        if body.is_of_several:
            files[body.folder][body.source.path] = body.siblings
    told = {}
    for i, body in enumerate(bodies):
        if body.facts is None or not body.is_of_several or body.facts.has_joints:
            continue
        here = list(files[body.folder].values())
        count = _num_files(body.facts.shape, here)
        has_others = any(each.shape and _num_files(each.shape, here) < count for each in body.siblings)
        if count >= max(2, len(here) / 2) and has_others:
            told[i] = "stands alike in several files", ""
    return told


def _num_files(shape: str, files: Sequence[tuple[BodyFacts, ...]]) -> int:
    return sum(any(each.shape == shape for each in siblings) for siblings in files)


def _copies(bodies: dict[int, _Body]) -> dict[int, tuple[str, str]]:
    """Bodies that look like one of another file; a file's only body comes first, and always stays."""
    first: dict[str, _Body] = {}
    told = {}
    for i, body in sorted(bodies.items(), key=lambda item: item[1].is_of_several):
        if body.facts is None or not body.facts.looks:
            continue
        twin = first.setdefault(body.facts.looks, body)
        if body.is_of_several and twin.source.path != body.source.path:
            told[i] = "alike in another file", f"in {twin.source.path.name}"
    return told
