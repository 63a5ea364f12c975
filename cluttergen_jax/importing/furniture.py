"""Which bodies of a file are a piece of furniture, and which way up it stands: as stated, or by its shape.

A coarse grid of cells is looked at along all six axes. A level is a board, or another face, over which there
is free air, and a rectangle of 15 cm by 15 cm. Every direction gets a score: the area of the largest
rectangles of all its levels, a quarter more for each further level, and doubled where it stands on legs:
little of it touches the floor, spread widely, there is free space between, and one level covers most of it.

A stated pose is kept where it has a level, unless it lies on its top with its legs in the air, or another way
up has three times its score and either stands on legs, where this one does not and has two levels at most, or
has two levels more. Where a format states no axis, z is taken by default, and y where that has half as much
score again, and is on legs or has two levels more. Furniture is turned only to what is clearly best: its
score is higher by a quarter than those along other axes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import ndimage

from cluttergen_jax.assets.config import NARROW_SURFACE
from cluttergen_jax.assets.mesh import Mesh, join_meshes
from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.assets.shape import Shape
from cluttergen_jax.assets.solid import Voxels
from cluttergen_jax.assets.support_map import largest_rectangle
from cluttergen_jax.errors import AssetError, first_names
from cluttergen_jax.importing.limited import call_limited
from cluttergen_jax.importing.readers import ObjectFile, ReadOptions, find_sources, read_shape
from cluttergen_jax.importing.readers.read import MAX_FURNITURE, MAX_UNSTATED, MIN_FURNITURE
from cluttergen_jax.importing.readers.source import AXES, make_source, own_up, states_unit, turn_of
from cluttergen_jax.importing.scenery import MIN_CHAIN, BodyFacts, world_facts
from cluttergen_jax.importing.surfaces import find_surfaces

_GLTF = (".glb", ".gltf")
_MOST_NAMED = 8


def find_furniture(path: str | Path) -> tuple[ObjectFile, list[str]]:
    """The one piece of furniture that a path means.

    Args:
      path: a file, a folder that holds one, or FILE#BODY: a body of an MJCF file, a link of a URDF, a model
        or link of an SDF file, a node of a glTF file, each with all that hangs on it.

    Returns:
      It, and in words which bodies are taken as one, and which are left out.

    Raises:
      AssetError: nothing is there, or it holds several files of furniture, or a body of a file without any.
    """
    file, body = _split(path)
    sources = find_sources(file)
    places = list(dict.fromkeys(source.path for source in sources))
    if len(places) > 1:
        names = first_names([str(each.relative_to(file)) for each in places], _MOST_NAMED, "")
        raise AssetError(
            f"{file} holds {len(places)} pieces of furniture ({names})", "one", str(places[0])
        )
    first = sources[0]
    if body:
        if first.kind == "mesh" and first.path.suffix.lower() not in _GLTF:
            raise AssetError(
                f"{str(path)!r}: {first.path.suffix[1:].upper()} has no bodies",
                "a body of an MJCF, URDF, SDF or glTF file",
                str(file),
            )
        return replace(make_source(first.path, first.kind, body), body=body), []
    if len(sources) == 1:
        return first, []
    facts = call_limited(first.path, world_facts, first.path) if first.kind == "mjcf" else []
    taken, notes = _furniture_of([source.body for source in sources], facts)
    named = first_names(taken, _MOST_NAMED)
    said = (
        f"taken as one piece of furniture: {named} ({first.path.name}#{taken[0]} takes that alone)"
    )
    return replace(make_source(first.path, first.kind), bodies=tuple(taken)), [said, *notes]


def _split(path: str | Path) -> tuple[Path, str]:
    """A file and the body behind "#"; a file whose own name has that sign goes before."""
    if Path(path).exists():
        return Path(path), ""
    text = str(path)
    places = [k for k, letter in enumerate(text) if letter == "#" and Path(text[:k]).exists()]
    return (Path(text[: places[0]]), text[places[0] + 1 :]) if places else (Path(path), "")


def _furniture_of(bodies: Sequence[str], facts: Sequence[BodyFacts]) -> tuple[list[str], list[str]]:
    """Those that stand fixed in a world, all if none does; and in words what is left out."""
    if len(facts) != len(bodies):
        return list(bodies), []
    taken: list[str] = []
    left_out: dict[str, list[str]] = {}
    for body, each in zip(bodies, facts, strict=True):
        reason = _why_no_furniture(each)
        (left_out.setdefault(reason, []) if reason else taken).append(body)
    if not taken:
        return list(bodies), []
    return taken, [
        f"left out, {reason}: {first_names(names, _MOST_NAMED)}"
        for reason, names in left_out.items()
    ]


def _why_no_furniture(facts: BodyFacts) -> str:
    if facts.is_mocap:
        return "as a program moves them (mocap)"
    if facts.chain >= MIN_CHAIN:
        return "as they have chains of joints, as robots have"
    return "as they move freely" if facts.is_free else ""


_CELLS = 96
_AIR = 0.15
"""Metres of air over a level that counts here."""
# Of what stands on legs: at most so much of its shadow touches the floor, the hull of that is at least so
# much of the shadow's, the level covers so much of it, and what is above the space between legs is so much of
# the height from the floor.
_TOUCHES = 0.3
_SPREAD = 0.3
_COVERS = 0.5
_CLEAR = 0.2

_PER_LEVEL = 0.25
_MOST_LEVELS = 5
_USUAL = ("y", "z")
"""The axes that programs have up which write files that do not say."""
_STATED_LEAD = 3.0
_UNSTATED_LEAD = 1.5
_CLEAR_LEAD = 1.25
# Of a table on its top: the height of its plate, over the whole height, and the side of a leg, over the
# plate's.
_LOW = 0.25
_LEG = 0.3


@dataclass(frozen=True)
class FurnitureLevels:
    """How furniture looks with one direction up.

    Attributes:
      sides: metres, of the largest rectangle on a level, the shorter first; 0 without a level.
      score: square metres, see the module; num_levels: how many there are.
      is_on_legs, is_on_its_top: whether it stands on legs, or has them in the air.
    """

    sides: tuple[float, float]
    score: float
    num_levels: int
    is_on_legs: bool
    is_on_its_top: bool


def read_upright(
    source: ObjectFile, options: ReadOptions, joints: Mapping[str, float]
) -> tuple[Shape, list[str]]:
    """Reads a piece of furniture and stands it up where its pose is not asked for.

    Returns:
      It, and in words what was turned, or why it was not.

    Raises:
      AssetError, ConfigError: see `read_shape`.
    """
    largest = MAX_FURNITURE if states_unit(source) else MAX_UNSTATED
    shape = read_shape(source, options, joints, largest, MIN_FURNITURE)
    if not shape.is_pose_free:
        return shape, []
    stated = own_up(source.path, source.kind)
    mesh = join_meshes([piece.mesh for piece in shape.pieces])
    looks = looks_of(mesh, stated.axis)
    if looks[stated.axis].num_levels == 0:
        looks[stated.axis] = _look_closer(mesh, looks[stated.axis])
    axis, notes = choose_up(looks, stated.axis, "default" not in stated.reason)
    if axis != stated.axis:
        shape = read_shape(source, replace(options, up=axis), joints, largest, MIN_FURNITURE)
    reason = stated.reason.removeprefix("by ")
    return shape, [f"{note} ({stated.axis} is up by {reason})" for note in notes]


def _look_closer(mesh: Mesh, look: FurnitureLevels) -> FurnitureLevels:
    """Of furniture whose surfaces slope, and so are no levels of a grid."""
    sides = [2 * np.sort(each.surface.region.half_extents) for each in find_surfaces(mesh, 0.0)[0]]
    wide = [each for each in sides if each[0] >= NARROW_SURFACE]
    if not wide:
        return look
    low, high = max(wide, key=np.prod).tolist()
    return replace(
        look, sides=(low, high), score=float(sum(map(np.prod, wide))), num_levels=len(wide)
    )


def choose_up(
    looks: Mapping[str, FurnitureLevels], stated: str, is_stated: bool
) -> tuple[str, list[str]]:
    """The axis that is up, and in words what is to be said of that.

    Args:
      looks: by axis of the file.
      stated: the axis that the file or its format has up; is_stated: whether it says so.
    """
    own = looks[stated]
    others = [axis for axis in looks if axis != stated]
    if not is_stated and max(looks[axis].num_levels for axis in _USUAL):
        others = [axis for axis in _USUAL if axis != stated]
    ranked = sorted(others, key=lambda axis: -_rank(looks[axis], axis))
    best = ranked[0]
    if own.is_on_its_top:
        best = stated[1:] if stated.startswith("-") else f"-{stated}"
    other = looks[best]
    gain = math.inf if own.score == 0 else other.score / own.score
    is_opposite = best.strip("-") == stated.strip("-")
    if own.is_on_its_top:
        is_better = True
    elif own.num_levels == 0:
        is_better = other.num_levels > 0
    elif is_stated:
        is_on_new_legs = other.is_on_legs and not own.is_on_legs and own.num_levels <= 2
        has_signs = is_on_new_legs or other.num_levels >= own.num_levels + 2
        is_better = has_signs and gain >= _STATED_LEAD and not is_opposite
    else:
        has_signs = other.is_on_legs or other.num_levels >= own.num_levels + 2
        is_better = has_signs and gain >= _UNSTATED_LEAD
    rivals = [looks[axis].score for axis in ranked if axis.strip("-") != best.strip("-")]
    is_clear = own.is_on_its_top or other.score >= _CLEAR_LEAD * max(rivals, default=0.0)
    if is_better and is_clear:
        why = "on its legs, " if other.is_on_legs else ""
        return best, [
            f"stood up by its shape, its {best} axis up: {why}{_largest(other)}; as its file has it, "
            f"{_largest(own)}; --up file keeps that"
        ]
    is_unsure = not is_stated and not own.is_on_legs and other.num_levels > 0
    if own.num_levels == 0 or is_unsure:
        return stated, [
            f"not turned, as its shape does not say clearly which way up it stands: {_largest(own)}; with "
            f"--up={best} {_largest(other)}"
        ]
    return stated, []


def _largest(look: FurnitureLevels) -> str:
    if look.num_levels == 0:
        return "no surface of 15 cm by 15 cm"
    return f"its largest surface is about {look.sides[0]:.2f} x {look.sides[1]:.2f} m"


def _rank(look: FurnitureLevels, axis: str) -> float:
    """The score, nothing for what lies on its top, less for axes that no program has up; z before y."""
    habit = 0.7 if axis.startswith("-") else 1.0 + 0.01 * (axis == "z") + 0.005 * (axis == "y")
    return 0.0 if look.is_on_its_top else look.score * habit


def looks_of(mesh: Mesh, up: str) -> dict[str, FurnitureLevels]:
    """How furniture looks with each axis of its file up.

    Args:
      mesh: metres, z up; up: the axis of the file that is up in it.
    """
    voxels = Voxels.of(mesh, _CELLS)
    turn = turn_of(up)
    found = {}
    for axis in AXES:
        # Where the file's axis points in the mesh: a row of a rotation by right angles.
        direction = turn @ np.round(turn_of(axis)[2])
        along = int(np.abs(direction).argmax())
        solid, outside = (np.moveaxis(each, along, 2) for each in (voxels.solid, voxels.outside))
        if direction[along] < 0:
            solid = solid[:, :, ::-1]
            outside = outside[:, :, ::-1]
        found[axis] = _look(solid, outside, voxels.pitch)
    return found


def _look(solid: np.ndarray, outside: np.ndarray, pitch: float) -> FurnitureLevels:
    """How it looks from a grid bool[X, Y, Z] whose last axis is up."""
    levels = _levels(solid, outside, pitch)
    used = np.flatnonzero(solid.any((0, 1)))
    height = used[-1] - used[0] + 1
    shadow = np.asarray(solid.any(2))
    lowest = solid.argmax(2) - used[0]
    touches = shadow & (lowest <= 1)
    between = lowest[shadow & ~touches]
    top = max(levels, key=lambda each: each[1] * each[2], default=None)
    covered = 0.0 if top is None else top[3] / shadow.sum()
    is_high = top is not None and top[0] - used[0] >= height / 2
    is_on_legs = (
        is_high
        and covered >= _COVERS
        and touches.sum() <= _TOUCHES * shadow.sum()
        and _spread(touches, shadow) >= _SPREAD
        and len(between) > 0
        and bool(np.median(between) >= _CLEAR * height)
    )
    sides = (0.0, 0.0) if top is None else (min(top[1:3]) * pitch, max(top[1:3]) * pitch)
    area = sum(x * y for _, x, y, _ in levels) * pitch**2
    more = 1 + _PER_LEVEL * (min(len(levels), _MOST_LEVELS) - 1)
    return FurnitureLevels(
        sides,
        area * more * (2.0 if is_on_legs else 1.0),
        len(levels),
        bool(is_on_legs),
        _is_on_its_top(solid, touches, shadow, used),
    )


def _levels(
    solid: np.ndarray, outside: np.ndarray, pitch: float
) -> list[tuple[int, int, int, int]]:
    """Of each level: the index of its cells, the largest rectangle's sides in cells, and how many cells."""
    air = round(_AIR / pitch)
    smallest = NARROW_SURFACE / pitch
    padded = np.pad(outside, ((0, 0), (0, 0), (0, air)), constant_values=True)
    free = np.ones_like(outside)
    for step in range(1, air + 1):
        free &= padded[:, :, step : step + outside.shape[2]]
    carries = solid & free
    counts = carries.sum((0, 1))
    found: list[tuple[int, int, int, int]] = []
    # A board between two rows of cells is in either.
    for k in np.argsort(-counts, kind="stable").tolist():
        if counts[k] < smallest**2 or any(abs(k - each[0]) <= 2 for each in found):
            continue
        mask = carries[:, :, max(k - 1, 0) : k + 2].any(2)
        x0, x1, y0, y1 = largest_rectangle(ndimage.binary_closing(np.pad(mask, 1))[1:-1, 1:-1])
        if min(x1 - x0, y1 - y0) >= smallest - 0.5:
            found.append((k, x1 - x0, y1 - y0, int(mask.sum())))
    return found


def _spread(cells: np.ndarray, shadow: np.ndarray) -> float:
    """The area of the hull of cells over that of the shadow's."""
    hulls = [hull_of(np.argwhere(each)) for each in (cells, shadow)]
    return 0.0 if hulls[0] is None or hulls[1] is None else float(hulls[0].volume / hulls[1].volume)


def _is_on_its_top(
    solid: np.ndarray, touches: np.ndarray, shadow: np.ndarray, used: np.ndarray
) -> bool:
    """Whether a plate lies on the floor and separate legs rise from it, to one height and spread widely."""
    first = int(used[0])
    last = int(used[-1])
    height = last - first + 1
    if touches.sum() < (1 - _TOUCHES) * shadow.sum():
        return False
    ends = np.asarray(solid[:, :, last - 1 : last + 1].any(2))
    if ends.sum() > _TOUCHES * shadow.sum() or _spread(ends, shadow) < _SPREAD:
        return False
    cuts = [solid[:, :, first + round(share * height)] for share in (_LOW, 0.5, 0.75)]
    plate = np.ptp(np.argwhere(shadow), axis=0) + 1
    for cut in cuts:
        label, count = ndimage.label(cut, np.ones((3, 3)))
        sides = [np.ptp(np.argwhere(label == each), axis=0) + 1 for each in range(1, count + 1)]
        if count < 3 or any((side > _LEG * plate).any() for side in sides):
            return False
    return True
