"""Furniture: its surfaces, which bodies of a file it is, and which way up it stands.

Surfaces are found where things can be put down, whatever the mesh is like. Vertical lines through the cells
of a grid cross the mesh layer by layer. A crossing can carry if it is within 10 degrees of level, has 5 cm
of air above it (`SURFACE_AIR`), and a cube of 2 to 3 cm can get there from outside, so that the inside of
boards and of closed cabinets has none. Crossings of neighbouring cells that continue each other are one
surface. It counts if the largest rectangle on it is 5 cm wide and 50 cm^2 large (`SURFACE_WIDTH`,
`SURFACE_AREA`).

Which way up: a coarse grid of cells is looked at along all six axes. A level is a board, or another face,
over which there is free air, and a rectangle of 15 cm by 15 cm. Every direction gets a score: the area of
the largest rectangles of all its levels, a quarter more for each further level, and doubled where it stands
on legs: little of it touches the floor, spread widely, there is free space between, and one level covers
most of it.

A stated pose is kept where it has a level, unless it lies on its top with its legs in the air, or another
way up has three times its score and either stands on legs, where this one does not and has two levels at
most, or has two levels more. Where a format states no axis, z is taken by default, and y where that has
half as much score again, and is on legs or has two levels more. Furniture is turned only to what is clearly
best: its score is higher by a quarter than those along other axes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from cluttergen_jax.assets.config import NARROW_SURFACE, SURFACE_AIR, SURFACE_AREA, SURFACE_WIDTH
from cluttergen_jax.assets.mesh import Mesh, component_labels, join_meshes
from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.assets.shape import Shape
from cluttergen_jax.assets.solid import Voxels
from cluttergen_jax.assets.support import Rectangle, Ring, Surface, outline_of_cells
from cluttergen_jax.assets.support_map import Span, cells_below, cover, largest_rectangle
from cluttergen_jax.errors import AssetError, first_names
from cluttergen_jax.geometry import box_corners, cell_centers, rotate_in_plane, yaw_matrix
from cluttergen_jax.importing.limited import call_limited
from cluttergen_jax.importing.readers import ObjectFile, ReadOptions, find_sources, read_shape
from cluttergen_jax.importing.readers.read import MAX_FURNITURE, MAX_UNSTATED, MIN_FURNITURE
from cluttergen_jax.importing.readers.source import AXES, make_source, own_up, states_unit, turn_of
from cluttergen_jax.importing.scenery import MIN_CHAIN, BodyFacts, world_facts

_STEEPEST = math.radians(10.05)
_LEVEL = math.radians(0.5)
_NARROW_GAP = 0.02
_FLAT = 0.003
_PITCH = 0.01
_MOST_CELLS = 300
_VOXELS = 140
_PASSAGE = 0.012
_FEWEST = 4


@dataclass(frozen=True, eq=False)
class FoundSurface:
    """A surface and the cells that it is made of.

    Attributes:
      surface: its name is empty and its free height not known yet.
      mask: bool[X, Y], its cells, in its frame turned by the yaw of its region.
      lower: f64[2], where cell (0, 0) begins; cell: f64[2], its sides, metres.
      thickness: metres of what is below it, 4 cm at most.
    """

    surface: Surface
    mask: np.ndarray
    lower: np.ndarray
    cell: np.ndarray
    thickness: float

    @cached_property
    def plates(self) -> list[np.ndarray]:
        """f64[4, 2] each, in its frame: rectangles that cover it."""
        return [self.corners(span) for span in cover(self.mask)]

    def corners(self, span: Span) -> np.ndarray:
        """f64[4, 2]: the corners of a rectangle of cells, in its frame."""
        return _corners(span, self.lower, self.cell, self.surface.region.yaw)

    def is_on(self, xy: np.ndarray) -> np.ndarray:
        """bool[...]: whether points f64[..., 2] of its frame are on it, a cell from its edge."""
        inner = ndimage.binary_erosion(self.mask, np.ones((3, 3)))
        local = (rotate_in_plane(xy, -self.surface.region.yaw) - self.lower) / self.cell
        index = np.clip(local.astype(int), 0, np.array(self.mask.shape) - 1)
        return (
            inner[index[..., 0], index[..., 1]]
            & (local >= 0).all(-1)
            & (local < self.mask.shape).all(-1)
        )


def _corners(span: Span, lower: np.ndarray, cell: np.ndarray, yaw: float) -> np.ndarray:
    low = lower + cell * (span[0], span[2])
    high = lower + cell * (span[1], span[3])
    return rotate_in_plane(box_corners(low, high), yaw)


def find_surfaces(mesh: Mesh, yaw: float) -> tuple[list[FoundSurface], list[str]]:
    """All surfaces of a piece of furniture that stands on the floor, the highest first.

    Args:
      mesh: metres, z up.
      yaw: radians, the direction of its sides.

    Returns:
      They, and in words what is too small for anything to stand on or is not flat.
    """
    aligned = mesh.transform(yaw_matrix(-yaw), np.zeros(3))
    voxels = Voxels.of(aligned, _VOXELS)
    layers = _Layers.of(aligned, voxels)
    samples = voxels.samples @ yaw_matrix(yaw).T
    found: list[FoundSurface] = []
    notes: list[str] = []
    for spots in layers.patches():
        spots = spots @ yaw_matrix(yaw).T
        where = f"no surface at {spots[:, 2].mean():.2f} m"
        fit = _plane(spots)
        near = np.abs(spots[:, :2] @ fit[:2] + fit[2] - spots[:, 2]) <= _FLAT / 2
        if near.mean() > 0.5:
            # Broken edges are no part of the plane.
            fit = _plane(spots[near])
        slope = math.atan(math.hypot(*fit[:2]))
        if slope < _LEVEL:
            fit = np.array([0.0, 0.0, np.median(spots[:, 2])])
        away = np.abs(spots[:, :2] @ fit[:2] + fit[2] - spots[:, 2])
        if slope > _STEEPEST or np.mean(away > _FLAT) > 0.1:
            notes.append(f"{where}: not flat")
            continue
        several = _measure(mesh, samples, spots[away <= _FLAT], fit, yaw, layers.pitch)
        found += several
        if not several:
            notes.append(
                f"{where}: narrower than {100 * SURFACE_WIDTH:g} cm, or smaller than "
                f"{1e4 * SURFACE_AREA:g} cm^2"
            )
    return sorted(found, key=lambda each: -each.surface.position[2]), notes


def num_cells(size: np.ndarray, pitch: float) -> np.ndarray:
    """i[2]: how many cells of at most `pitch` fill a rectangle."""
    return np.maximum(np.ceil(size / pitch - 1e-9), 1).astype(int)


def without_cracks(mask: np.ndarray) -> np.ndarray:
    """bool[X, Y]: the True cells, with gaps of one cell or two between them closed."""
    closed = ndimage.binary_closing(np.pad(mask, 1), np.ones((3, 3)))
    return np.asarray(closed[1:-1, 1:-1])


def _plane(spots: np.ndarray) -> np.ndarray:
    """f64[3]: the plane z = fit . (x, y, 1) nearest to points."""
    return np.linalg.lstsq(
        np.column_stack([spots[:, :2], np.ones(len(spots))]), spots[:, 2], rcond=None
    )[0]


@dataclass(frozen=True, eq=False)
class _Layers:
    """Where vertical lines through cells of X x Y cross a mesh that is aligned with them, L times at most.

    Attributes:
      z: f64[L, X, Y], ascending, nan where there are fewer.
      carries: bool[L, X, Y].
    """

    lower: np.ndarray
    pitch: float
    z: np.ndarray
    carries: np.ndarray

    @staticmethod
    def of(mesh: Mesh, voxels: Voxels) -> _Layers:
        lower, upper = mesh.bounds[:, :2]
        pitch = max(_PITCH, float((upper - lower).max()) / _MOST_CELLS)
        shape = num_cells(upper - lower, pitch)
        is_level = np.abs(mesh.normals[:, 2]) > math.cos(_STEEPEST) * mesh.areas - 1e-9
        cells = [np.zeros(0, int)]
        heights = [np.zeros(0)]
        level = [np.zeros(0, bool)]
        number = np.arange(shape.prod()).reshape(shape)
        for face, window, over, is_hit in cells_below(mesh, lower, lower + pitch * shape, shape):
            cells.append(number[window][is_hit])
            heights.append(over[is_hit])
            level.append(np.full(len(cells[-1]), is_level[face]))
        cell, height, flat = (np.concatenate(each) for each in (cells, heights, level))
        order = np.lexsort((height, cell))
        cell = cell[order]
        height = height[order]
        flat = flat[order]
        rank = np.arange(len(cell)) - np.searchsorted(cell, cell)
        z = np.full((rank.max(initial=0) + 1, shape.prod()), np.nan)
        carries = np.zeros(z.shape, bool)
        z[rank, cell] = height
        carries[rank, cell] = flat
        above = np.concatenate([z[1:], np.full((1, z.shape[1]), np.nan)])
        carries &= ~(above - z < SURFACE_AIR)
        layers = _Layers(lower, pitch, z.reshape(-1, *shape), carries.reshape(-1, *shape))
        layers.carries[...] &= _is_reached(voxels, layers)
        return layers

    def spots(self) -> np.ndarray:
        """f64[L, X, Y, 3]: the crossings."""
        xy = cell_centers(self.lower, self.pitch, self.z.shape[1:])
        return np.stack(np.broadcast_arrays(xy[..., 0], xy[..., 1], self.z), axis=-1)

    def patches(self) -> list[np.ndarray]:
        """f64[N, 3] each: crossings that carry and continue each other from cell to cell."""
        number = np.full(self.z.shape, -1)
        number[self.carries] = np.arange(self.carries.sum())
        pairs = [np.zeros((0, 2), int)]
        used = np.flatnonzero(self.carries.any((1, 2)))
        for axis, far in product((0, 1), range(1, int(_NARROW_GAP / self.pitch) + 2)):
            reach = far * math.tan(_STEEPEST) * self.pitch + 0.001
            z, own = (np.moveaxis(each, axis + 1, 1) for each in (self.z, number))
            for one, other in product(used, used):
                here = own[one, :-far]
                there = own[other, far:]
                is_one = (
                    (here >= 0) & (there >= 0) & (np.abs(z[one, :-far] - z[other, far:]) <= reach)
                )
                pairs.append(np.stack([here[is_one], there[is_one]], axis=1))
        edges = np.concatenate(pairs)
        label = component_labels(edges, int(self.carries.sum()))
        spots = self.spots()[self.carries]
        groups = [spots[label == each] for each in np.flatnonzero(np.bincount(label) >= _FEWEST)]
        return sorted(groups, key=lambda group: -group[:, 2].mean())


def _is_reached(voxels: Voxels, layers: _Layers) -> np.ndarray:
    """bool[L, X, Y]: whether the air just above a crossing is reached from outside by more than gaps."""
    radius = max(_PASSAGE, 1.5 * voxels.pitch)
    more = math.ceil(radius / voxels.pitch)
    # A cube in place of a ball: its dilations go axis by axis.
    near = ndimage.maximum_filter(np.pad(voxels.surface, 2 * more + 1).view(np.uint8), 2 * more + 1)
    regions, _ = ndimage.label(near == 0)
    outside = (regions == regions[0, 0, 0]).view(np.uint8)
    inner = slice(2 * more + 1, -2 * more - 1)
    reached = (
        ndimage.maximum_filter(outside, 2 * more + 3).view(bool)[inner, inner, inner]
        & voxels.outside
    )
    spots = layers.spots() + np.array([0.0, 0.0, radius + voxels.pitch])
    is_there = np.isfinite(layers.z)
    result = np.zeros(layers.z.shape, bool)
    result[is_there] = reached[voxels.index(spots[is_there])]
    return result


def _measure(
    mesh: Mesh, samples: np.ndarray, spots: np.ndarray, fit: np.ndarray, yaw: float, pitch: float
) -> list[FoundSurface]:
    """The surfaces on the plane z = fit . (x, y, 1) around `spots` that are large enough."""
    surface = Surface("", (0.0, 0.0, float(fit[2])), Rectangle(), (), quaternion=_turn(fit))
    inverse = yaw_matrix(-yaw) @ surface.T_world_surface[:3, :3].T

    def local(points: np.ndarray) -> np.ndarray:
        return (points - surface.position) @ inverse.T

    flat = Mesh(local(mesh.vertices), mesh.faces)
    seeds = local(spots)[:, :2]
    above = samples[:, 2] - samples[:, :2] @ fit[:2] - fit[2]
    risen = local(samples[(above > 0.0) & (above < 2 * SURFACE_AIR)])
    is_low = np.abs(flat.corners[:, :, 2]).max(1) <= _FLAT
    corners = flat.corners[is_low].reshape(-1, 3)[:, :2]
    near = cKDTree(seeds).query(corners)[0] <= 2 * pitch if len(corners) else np.zeros(0, bool)
    # Cell borders fall on the surface's own sides, where it has any.
    ends = np.concatenate([seeds, corners[near]])
    lower = ends.min(0)
    upper = ends.max(0)
    if (upper - lower).min() < SURFACE_WIDTH:
        return []
    shape = np.maximum(np.ceil((upper - lower) / _PITCH - 1e-6), 1).astype(int)
    shape = np.minimum(shape, _MOST_CELLS)
    cell = (upper - lower) / shape
    mask = np.zeros(shape, bool)
    below = np.full(shape, -np.inf)
    upright = Mesh(flat.vertices, flat.faces[flat.corners[:, :, 2].max(1) <= _FLAT])
    for _, window, over, is_hit in cells_below(upright, lower, upper, shape):
        mask[window] |= is_hit & (np.abs(over) <= _FLAT)
        is_under = is_hit & (over < -_FLAT)
        below[window] = np.where(is_under, np.maximum(below[window], over), below[window])
    centers = cell_centers(lower, cell, shape)
    mask &= cKDTree(seeds).query(centers)[0] <= 1.01 * pitch
    mask = without_cracks(mask)
    walls = risen[(risen[:, 2] > _FLAT + 0.001) & (risen[:, 2] < SURFACE_AIR)][:, :2]
    # A wall's inner face lies on a cell's border: it belongs to the cell farther out.
    index = np.floor((walls + 0.001 * np.sign(walls - centers.mean((0, 1))) - lower) / cell)
    index = index[((index >= 0) & (index < shape)).all(1)].astype(int)
    mask[tuple(index.T)] = False
    under = -below[mask & np.isfinite(below)]
    thickness = float(np.clip(np.median(under) if len(under) else 0.0, 0.002, 0.04))
    label, count = ndimage.label(mask)

    def turned(ring: Ring) -> Ring:
        return tuple((float(x), float(y)) for x, y in rotate_in_plane(ring, yaw))

    found = []
    for own in (label == number for number in range(1, count + 1)):
        span = largest_rectangle(own)
        half = cell * (span[1] - span[0], span[3] - span[2]) / 2
        if 2 * half.min() < SURFACE_WIDTH - 1e-9 or 4 * half.prod() < SURFACE_AREA - 1e-9:
            continue
        center = _corners(span, lower, cell, yaw).mean(0)
        region = Rectangle(
            (float(center[0]), float(center[1])), (float(half[0]), float(half[1])), yaw
        )
        outline, *holes = outline_of_cells(own, lower, cell, 1.1 * float(cell.max()))
        rings = turned(outline), tuple(map(turned, holes))
        one = replace(surface, region=region, outline=rings[0], holes=rings[1])
        found.append(FoundSurface(one, own, lower, cell, thickness))
    return found


def _turn(fit: np.ndarray) -> tuple[float, float, float, float]:
    """The smallest turn, wxyz, that takes z to the normal of a plane z = fit . (x, y, 1)."""
    normal = np.array([-fit[0], -fit[1], 1.0]) / math.sqrt(fit[0] ** 2 + fit[1] ** 2 + 1)
    w = math.sqrt((1 + float(normal[2])) / 2)
    return w, float(-normal[1] / (2 * w)), float(normal[0] / (2 * w)), 0.0


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
