"""Convex parts that fill a solid without gaps, of components whose shape says how.

Machined, printed and modelled things have such components: convex ones, layers of prisms and solids of
revolution. What goes through a hole of a prism goes through between its parts: they are around it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import manifold3d
import numpy as np

from cluttergen_jax.assets.mass import mass_properties
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.outlines import convex_pieces, hole_radius, outlines_around, signed_area
from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.assets.settle import upright_turn
from cluttergen_jax.assets.solid import Solid, as_manifold, is_convex
from cluttergen_jax.errors import AssetError

# Cosines between a prism's axis and the normals of its ends, and of its sides: within one degree.
_FLAT = 0.9998
_STEEP = 0.0175

# Of a prism's surface, what is such at least; of its volume, by how much layers may differ from it.
_ENDS_AND_SIDES = 0.95
_LOST = 0.03

_MOST_AXES = 12
_MOST_LAYERS = 12
_NEAR = 0.025
_REACH = 0.01
"""Over the size of the whole: how far parts may be from concave walls."""
_FREE = 0.02
"""Of its radius, what a hole may lose where parts are merged."""
_SAME = 1e-4
"""Over the size of the whole: what differs by less is on a line; by ten times as much, of one height."""
_ROUND = 0.93
"""Of a solid of revolution's volume, what a turn leaves in place at least."""
# Over the size of the whole: how far its parts are from its profile, as tried, and from what is round.
_PROFILE = (0.0, 0.004, 0.01, 0.016)
_SECTOR_REACH = 0.015
_MOST_SECTORS = 32

_SMALL = 1e-5
"""Of the volume: smaller components are slivers."""
_GRID = 2.0**-24
"""Metres: sums of heights on it are exact, so that one layer ends where the next begins."""


@dataclass(frozen=True, eq=False)
class ExactParts:
    """Parts, what is left, and where no part may be after parts were merged."""

    parts: list[np.ndarray]  # f64[V, 3] each, convex.
    rest: tuple[Mesh, ...]  # Closed surfaces whose shape does not say how.
    free: np.ndarray  # f64[N, 3]: points just inside of the walls of holes.


def exact_parts(solid: Solid, most: int) -> ExactParts:
    """The parts of a solid's components, up to `most` in all, and the components of which there are none.

    No corner of a component is farther than 2.5 % of the size of the whole outside of its parts, or inside.
    """
    parts: list[np.ndarray] = []
    rest: list[Mesh] = []
    free = [np.zeros((0, 3))]
    least = _SMALL * solid.volume
    for component in (each for each in solid.components if each.volume > least):
        own = [component.vertices]
        holes = free[0]
        if not is_convex(component):
            own, holes = _prisms(component, solid.diagonal) or (
                _revolved(component, solid.diagonal),
                holes,
            )
            own = own if _are_near(own, component.vertices, _NEAR * solid.diagonal) else []
        if own and len(parts) + len(own) <= most:
            parts += own
            free.append(holes)
        else:
            rest.append(component)
    return ExactParts(parts, tuple(rest), np.concatenate(free))


def _are_near(parts: list[np.ndarray], points: np.ndarray, reach: float) -> bool:
    """Whether no point is so far outside of all parts, or inside of one."""
    nearest = np.full(len(points), np.inf)
    for hull in map(hull_of, parts):
        if hull is not None:
            height = (points @ hull.equations[:, :3].T + hull.equations[:, 3]).max(1)
            nearest = np.minimum(nearest, height)
    return bool((np.abs(nearest) <= reach).all())


def _prisms(mesh: Mesh, size: float) -> tuple[list[np.ndarray], np.ndarray] | None:
    """A closed mesh as prisms along the axis along which they are fewest, and free points of its holes."""
    found = [each for axis in _axes(mesh) if (each := _prisms_along(mesh, axis, size)) is not None]
    return min(found, key=lambda each: len(each[0]), default=None)


def _axes(mesh: Mesh) -> Iterator[np.ndarray]:
    """Directions along which a mesh may be layers of prisms: normals of much of its area."""
    normals = mesh.normals
    areas = np.linalg.norm(normals, axis=1)
    units = normals / np.maximum(areas, 1e-30)[:, None]
    _, which = np.unique(np.abs(np.round(units, 3)), axis=0, return_inverse=True)
    common = np.bincount(which.ravel(), areas)
    for group in np.argsort(-common, kind="stable")[:_MOST_AXES]:
        axis = units[(which.ravel() == group) & (areas > 0)][0]
        along = np.abs(units @ axis)
        if areas[(along > _FLAT) | (along < _STEEP)].sum() >= _ENDS_AND_SIDES * areas.sum():
            yield axis


def _prisms_along(
    mesh: Mesh, axis: np.ndarray, size: float
) -> tuple[list[np.ndarray], np.ndarray] | None:
    turn = upright_turn(axis)
    turned = mesh.transform(turn, np.zeros(3))
    solid = as_manifold(turned)
    heights = _heights(turned, size)
    if len(heights) > _MOST_LAYERS + 1:
        return None
    spans = list(pairwise(heights))
    sections = [solid.slice((low + high) / 2).simplify(_SAME * size) for low, high in spans]
    parts: list[np.ndarray] = []
    free = [np.zeros((0, 3))]
    for (low, high), section in zip(spans, sections, strict=True):
        rings = outlines_around(section, _REACH * size, _LOST)
        parts += [_between(piece, low, high) @ turn for piece in convex_pieces(rings)]
        holes = [ring for ring in rings if signed_area(ring) < 0]
        deep = [
            ring
            for ring in holes
            if high - low >= hole_radius(ring) or _goes_through(ring, sections)
        ]
        inset = 0.05 * (high - low)
        inside = np.linspace(low + inset, high - inset, 3)
        free += [_between(_inside_of(ring), *inside) @ turn for ring in deep]
    layers = [
        section.extrude(high - low).translate((0, 0, low))
        for (low, high), section in zip(spans, sections, strict=True)
    ]
    whole = manifold3d.Manifold.batch_boolean(layers, manifold3d.OpType.Add)
    # A hole across the axis is no hole of any layer.
    is_same = whole.genus() == solid.genus() and abs(whole.volume() / solid.volume() - 1) <= _LOST
    return (parts, np.concatenate(free)) if is_same else None


def _goes_through(ring: np.ndarray, sections: list[manifold3d.CrossSection]) -> bool:
    """Whether most of a hole is open in all layers."""
    hole = manifold3d.CrossSection([ring[::-1]])
    return all((hole ^ section).area() < hole.area() / 2 for section in sections)


def _heights(mesh: Mesh, size: float) -> list[float]:
    """Where layers begin and end: the heights of horizontal faces."""
    normals = mesh.normals
    is_end = np.abs(normals[:, 2]) > _FLAT * np.linalg.norm(normals, axis=1)
    levels = np.sort(np.concatenate([mesh.corners[is_end][:, :, 2].ravel(), mesh.bounds[:, 2]]))
    starts = np.flatnonzero(np.diff(levels, prepend=-np.inf) > 10 * _SAME * size)
    return [float(np.round(group.mean() / _GRID) * _GRID) for group in np.split(levels, starts[1:])]


def _between(ring: np.ndarray, *heights: float) -> np.ndarray:
    """f64[V, 3]: the points f64[N, 2] at each of some heights."""
    return np.concatenate(
        [np.column_stack([ring, np.full(len(ring), height)]) for height in heights]
    )


def _inside_of(ring: np.ndarray) -> np.ndarray:
    """f64[N, 2]: points just inside of a hole's outline."""
    hole = manifold3d.CrossSection([ring[::-1]])
    smaller = hole.offset(-_FREE * hole_radius(ring), manifold3d.JoinType.Miter).to_polygons()
    return np.concatenate(
        [points for each in smaller for points in (each, (each + np.roll(each, 1, 0)) / 2)]
    )


def _revolved(mesh: Mesh, size: float) -> list[np.ndarray]:
    """A closed mesh as sectors of a solid of revolution; none if it is no such solid."""
    try:
        mass = mass_properties(mesh, 1.0)
    except AssetError:
        return []
    moments, axes = np.linalg.eigh(mass.inertia)
    # The moment that is farthest from the one in the middle is that about the axis.
    axis = axes[:, 0 if moments[1] - moments[0] > moments[2] - moments[1] else 2]
    turn = upright_turn(axis)
    solid = as_manifold(mesh.transform(turn, -turn @ mass.center))
    if (solid ^ solid.rotate((0, 0, 57))).volume() < _ROUND * solid.volume():
        return []
    width = 2 * size
    right = manifold3d.CrossSection([[[0, -width], [width, -width], [width, width], [0, width]]])
    section = (solid.rotate((-90, 0, 0)).slice(0) ^ right).simplify(_SAME * size)
    for reach in _PROFILE:
        profile = section.simplify(reach * size)
        if profile.num_contour() == section.num_contour():
            pieces = convex_pieces([np.asarray(ring) for ring in profile.to_polygons()])
            parts = [part for piece in pieces for part in _sectors(piece, size)]
            if len(parts) <= _MOST_SECTORS:
                return [points @ turn + mass.center for points in parts]
    return []


def _sectors(piece: np.ndarray, size: float) -> list[np.ndarray]:
    """A convex polygon of radii and heights, f64[N, 2], turned about the axis."""
    inner = piece[:, 0].min()
    outer = piece[:, 0].max()
    if inner < 10 * _SAME * size:
        return [_turned(piece, np.linspace(0, 2 * np.pi, 64, endpoint=False))]
    # Plane walls that touch the round ones in their middle, and are so far from them at their ends.
    half = np.arccos(outer / (outer + _SECTOR_REACH * size))
    number = int(np.clip(np.ceil(np.pi / half), 6, 16))
    middles = 2 * np.pi / number * np.arange(number)
    wider = piece * [1 / np.cos(np.pi / number), 1]
    return [_turned(wider, middle + np.pi / number * np.array([-1, 1])) for middle in middles]


def _turned(piece: np.ndarray, angles: np.ndarray) -> np.ndarray:
    around = np.column_stack([np.cos(angles), np.sin(angles)])
    return np.concatenate(
        [np.column_stack([radius * around, np.full(len(angles), z)]) for radius, z in piece]
    )
