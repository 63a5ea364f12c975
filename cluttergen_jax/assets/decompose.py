"""Convex decomposition: exact parts where a shape says how, else CoACD, or one hull where that is enough.

Machined, printed and modelled things have components of which exact parts follow, without gaps: convex ones,
layers of prisms and solids of revolution. What goes through a hole of a prism goes through between its parts:
they are around it. Outlines of flat areas have the solid on their left: outer ones run counter-clockwise,
holes clockwise. Of CoACD's parts those that are far from the surface are halved; of these, and of too many
exact ones, neighbours are merged (`merging`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import coacd
import manifold3d
import numpy as np

from cluttergen_jax.assets.config import DecompositionConfig
from cluttergen_jax.assets.deviation import deviation, is_within_parts
from cluttergen_jax.assets.mass import mass_properties
from cluttergen_jax.assets.merging import (
    ALWAYS,
    FEW,
    Nearness,
    halve_parts,
    merge_parts,
)
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.parts import heights_over, hull_of
from cluttergen_jax.assets.settle import upright_turn
from cluttergen_jax.assets.solid import Solid, as_manifold, is_convex, simplify_solid
from cluttergen_jax.errors import AssetError
from cluttergen_jax.geometry import at_height, cross_2d
from cluttergen_jax.phases import say_phase

_HOLE_SHARE = 0.09
_FACTORS = (1.0, 0.5, 0.2)
_FAR = 10.0
"""Metres: farther than any object reaches."""
_STRAIGHT = 1e-6
_NOTHING = 1e-6
_MOST_CUT = 64
"""Pieces: of areas with more, cuts cost too much."""


def signed_area(ring: np.ndarray) -> float:
    """Square metres, below zero where it runs clockwise, as around a hole."""
    x, y = (ring - ring.mean(0)).T
    return float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2)


def outlines_around(
    section: manifold3d.CrossSection, reach: float, lost: float
) -> list[np.ndarray]:
    """The outlines of an area, f64[N, 2] each, concave ones with fewer corners and a little farther out.

    Args:
      reach: metres that they may be farther out, of holes 9 % of their radius at most.
      lost: share of the area that may be lost. What is thin is not cut through.
    """
    rings = [np.asarray(ring) for ring in section.to_polygons()]
    for factor in _FACTORS:
        plain = []
        for ring in rings:
            most = reach if signed_area(ring) > 0 else min(reach, _HOLE_SHARE * hole_radius(ring))
            plain.append(_without_edges(ring, factor * most))
        around = manifold3d.CrossSection(plain)
        if around.num_contour() == len(rings) and around.area() > (1 - lost) * section.area():
            return [np.asarray(ring) for ring in around.to_polygons()]
    return rings


def hole_radius(ring: np.ndarray) -> float:
    """Metres, of a circle of the same area."""
    return float(np.sqrt(abs(signed_area(ring)) / np.pi))


def _without_edges(ring: np.ndarray, reach: float) -> np.ndarray:
    """A closed outline without edges between concave corners, as many at a time as come close.

    The edges before and after are made longer until they meet, no farther than `reach` from the outline.
    """
    number = len(ring)
    sides = np.roll(ring, -1, 0) - ring
    is_concave = cross_2d(np.roll(sides, 1, 0), sides) < 0
    # Where it can, it begins with an edge that stays.
    first = int(np.argmin(is_concave))
    corners = []
    edge = first
    while edge < first + number:
        after = edge + 1
        corner = ring[(edge + 1) % number]
        while (
            after < first + number
            and is_concave[after % number]
            and is_concave[(after + 1) % number]
        ):
            meet = _meeting(ring, sides, edge % number, (after + 1) % number)
            if meet is None or _distance(meet, ring, sides) > reach:
                break
            after = after + 1
            corner = meet
        corners.append(corner)
        edge = after
    return np.array(corners)


def _meeting(ring: np.ndarray, sides: np.ndarray, edge: int, other: int) -> np.ndarray | None:
    """Where an edge, made longer at its end, meets another, made longer at its beginning."""
    bend = cross_2d(sides[edge], sides[other])
    if bend >= 0:
        return None
    share = cross_2d(ring[other] - ring[edge], sides[other]) / bend
    return ring[edge] + share * sides[edge] if share >= 1 else None


def _distance(point: np.ndarray, ring: np.ndarray, sides: np.ndarray) -> float:
    """Metres from a point to an outline."""
    apart = point - ring
    share = np.clip((apart * sides).sum(1) / (sides**2).sum(1), 0, 1)
    return float(np.linalg.norm(apart - share[:, None] * sides, axis=1).min())


def convex_pieces(rings: list[np.ndarray]) -> list[np.ndarray]:
    """Convex polygons, f64[N, 2] each, that fill the area inside of outlines, by the better of two ways."""
    joined = _joined_triangles(rings)
    return _cut_along_edges(rings, min(len(joined), _MOST_CUT)) or joined


def _cut_along_edges(rings: list[np.ndarray], most: int) -> list[np.ndarray]:
    """Pieces by cuts all across along edges between concave corners; none where they are more than `most`."""
    whole = manifold3d.CrossSection(rings)
    todo = [whole]
    done: list[np.ndarray] = []
    while todo and len(todo) + len(done) <= most:
        region = todo.pop()
        outlines = [np.asarray(ring) for ring in region.to_polygons()]
        edge = max(map(_concave_edge, outlines), key=lambda each: each[0])
        if not edge[0]:
            done += outlines
            continue
        beyond = _half_plane(edge[1], edge[2])
        sides = [piece for side in (region ^ beyond, region - beyond) for piece in side.decompose()]
        sides = [piece for piece in sides if piece.area() > _NOTHING * whole.area()]
        if len(sides) < 2:
            return []
        todo += sides
    return [] if todo else done


def _concave_edge(ring: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """An edge with concave corners, from and to; the number tells which to prefer, and is 0 without such."""
    sides = np.roll(ring, -1, 0) - ring
    length = np.linalg.norm(sides, axis=1)
    is_concave = cross_2d(np.roll(sides, 1, 0), sides) < -_STRAIGHT * np.roll(length, 1) * length
    merit = (is_concave + np.roll(is_concave, -1).astype(float)) * (1 + length / length.sum())
    best = int(merit.argmax())
    return float(merit[best]), ring[best], ring[(best + 1) % len(ring)]


def _half_plane(start: np.ndarray, end: np.ndarray) -> manifold3d.CrossSection:
    """What is left of a line, as far as it matters."""
    along = _FAR * (end - start) / np.linalg.norm(end - start)
    left = np.array([-along[1], along[0]])
    return manifold3d.CrossSection(
        [[start - along, start + along, start + along + left, start - along + left]]
    )


def _joined_triangles(rings: list[np.ndarray]) -> list[np.ndarray]:
    """Triangles, joined over their longest common edges first wherever no corner becomes concave."""
    points = np.concatenate([np.zeros((0, 2)), *rings])
    loops = {
        index: list(corners) for index, corners in enumerate(manifold3d.triangulate(rings).tolist())
    }
    owner = {edge: index for index, loop in loops.items() for edge in _edges(loop)}
    inner = [(a, b) for a, b in owner if a < b and (b, a) in owner]
    for a, b in sorted(
        inner, key=lambda edge: -float(np.linalg.norm(points[edge[0]] - points[edge[1]]))
    ):
        left = owner[a, b]
        right = owner[b, a]
        # From b around the one to a, and on around the other to b.
        one = _from(loops[left], b)
        other = _from(loops[right], a)
        corners = ((one[-2], a, other[1]), (other[-2], b, one[1]))
        if any(cross_2d(points[y] - points[x], points[z] - points[y]) < 0 for x, y, z in corners):
            continue
        loops[left] = one[:-1] + other[:-1]
        del loops[right]
        owner |= dict.fromkeys(_edges(loops[left]), left)
    return [points[loop] for loop in loops.values()]


def _edges(loop: list[int]) -> list[tuple[int, int]]:
    return list(zip(loop, [*loop[1:], loop[0]], strict=True))


def _from(loop: list[int], first: int) -> list[int]:
    """The loop beginning with `first`."""
    start = loop.index(first)
    return loop[start:] + loop[:start]


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
                _sectors_of_revolution(component, solid.diagonal),
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
            height = heights_over(points, hull).max(1)
            nearest = np.minimum(nearest, height)
    return bool((np.abs(nearest) <= reach).all())


def _prisms(mesh: Mesh, size: float) -> tuple[list[np.ndarray], np.ndarray] | None:
    """A closed mesh as prisms along the axis along which they are fewest, and free points of its holes."""
    found = [each for axis in _axes(mesh) if (each := _prisms_along(mesh, axis, size)) is not None]
    return min(found, key=lambda each: len(each[0]), default=None)


def _axes(mesh: Mesh) -> Iterator[np.ndarray]:
    """Directions along which a mesh may be layers of prisms: normals of much of its area."""
    areas = mesh.areas
    units = mesh.directions
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
    turned = mesh.transform(turn)
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
    is_end = np.abs(mesh.normals[:, 2]) > _FLAT * mesh.areas
    levels = np.sort(np.concatenate([mesh.corners[is_end][:, :, 2].ravel(), mesh.bounds[:, 2]]))
    starts = np.flatnonzero(np.diff(levels, prepend=-np.inf) > 10 * _SAME * size)
    return [float(np.round(group.mean() / _GRID) * _GRID) for group in np.split(levels, starts[1:])]


def _between(ring: np.ndarray, *heights: float) -> np.ndarray:
    """f64[V, 3]: the points f64[N, 2] at each of some heights."""
    return np.concatenate([at_height(ring, height) for height in heights])


def _inside_of(ring: np.ndarray) -> np.ndarray:
    """f64[N, 2]: points just inside of a hole's outline."""
    hole = manifold3d.CrossSection([ring[::-1]])
    smaller = hole.offset(-_FREE * hole_radius(ring), manifold3d.JoinType.Miter).to_polygons()
    return np.concatenate(
        [points for each in smaller for points in (each, (each + np.roll(each, 1, 0)) / 2)]
    )


def _sectors_of_revolution(mesh: Mesh, size: float) -> list[np.ndarray]:
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
        return [_sweep(piece, np.linspace(0, 2 * np.pi, 64, endpoint=False))]
    # Plane walls that touch the round ones in their middle, and are so far from them at their ends.
    half = np.arccos(outer / (outer + _SECTOR_REACH * size))
    number = int(np.clip(np.ceil(np.pi / half), 6, 16))
    middles = 2 * np.pi / number * np.arange(number)
    wider = piece * [1 / np.cos(np.pi / number), 1]
    return [_sweep(wider, middle + np.pi / number * np.array([-1, 1])) for middle in middles]


def _sweep(piece: np.ndarray, angles: np.ndarray) -> np.ndarray:
    around = np.column_stack([np.cos(angles), np.sin(angles)])
    return np.concatenate([at_height(radius * around, z) for radius, z in piece])


_MOST_RAW = 96
_LIMITS = (0.055, 0.05, 0.045, 0.03, ALWAYS, 0.012)
"""How far from the surface, over the diagonal, merged parts may be, in the order in which it is tried. The
distance is an estimate: what is made of it is measured again."""
_FINE_LIMITS = (0.03, ALWAYS, 0.012)
"""The same of fine parts."""
_EXACT_LIMITS = (0.03, ALWAYS)
"""The same of parts that are near as they are."""
_REACHES = (0.025, 0.012)
"""Parts farther from the surface, over the diagonal, are halved: before they are merged, and once more where
nothing sound comes of that."""
_MOST_HALVED = 128
_OPEN_THRESHOLD = 1.7
"""Times the threshold: what is no can or bottle is cut into fewer parts, which costs less, and halved."""


def decompose(solid: Solid, config: DecompositionConfig) -> list[np.ndarray]:
    """The first of `decompositions`."""
    return next(decompositions(solid, config))[0]


def decompositions(
    solid: Solid, config: DecompositionConfig, jitter: float = 0.0
) -> Iterator[list[list[np.ndarray]]]:
    """Families of sets of convex parts, f64[V, 3] each, in the solid's frame; made as they are asked for.

    Sets of one family come of one cut: first the fewest parts, then ever more and nearer ones. They have as
    many vertices as CoACD and merging give them.

    Args:
      jitter: share of the diagonal by which each vertex that CoACD sees is moved at most, always in the same
        way. There are closed meshes over which it crashes or never ends, and the slightest change helps.

    Raises:
      AssetError: neither CoACD nor Qhull can make anything of the mesh.
    """
    config = config.search
    hull = hull_of(solid.mesh.vertices)
    if hull is None:
        raise AssetError(
            "a mesh so flat that it has no convex hull", "a mesh of an object with some thickness"
        )
    one = [solid.mesh.vertices[hull.vertices]]
    is_full = solid.volume >= config.one_hull_volume * hull.volume
    if config.max_parts == 1 or (
        is_full and (solid.is_convex or deviation(one, solid) <= config.one_hull_deviation)
    ):
        yield [one]
        return
    nearness = Nearness(solid)
    enough = nearness.enough
    most = config.max_parts
    exact = exact_parts(solid, _MOST_RAW) if config.exact else None
    if exact is not None and exact.parts:
        of_rest = [
            part
            for each in exact.rest
            for part in _Cut(each, solid, config, jitter).near_parts(nearness, _REACHES[0])
        ]
        raw = [*exact.parts, *of_rest]
        free = exact.free[~is_within_parts(exact.free, raw)]
        merged = merge_parts(raw, nearness, _EXACT_LIMITS, enough, most, free)
        sets = _distinct([*merged, *([raw] if len(raw) <= most else [])])
        small = [each for each in sets if len(each) <= enough]
        # More than enough only for the sake of holes, into which a peg may have to go.
        is_pierced = not small and len(free) > 0 and not nearness.is_hollow
        if is_pierced or small:
            yield sets if is_pierced else small
    if enough > FEW:
        config = replace(config, threshold=min(_OPEN_THRESHOLD * config.threshold, 1.0))
    limits = _FINE_LIMITS if config.quality == "fine" else _LIMITS
    cut = _Cut(solid.mesh, solid, config, jitter)
    parts = cut.near_parts(nearness, _REACHES[0])
    sets = _distinct(merge_parts(parts, nearness, limits, enough, most)) or [one]
    few = [each for each in sets if len(each) <= enough]
    if few:
        yield few
    # Which cuts leave few parts of a can is a matter of luck.
    for other in _others(config) if enough == FEW and len(sets[0]) <= 2 * FEW else ():
        found = _Cut(solid.mesh, solid, other, jitter).near_parts(nearness, _REACHES[0])
        (merged_few,) = merge_parts(found, nearness, limits[:1], enough, most)
        if 0 < len(merged_few) <= enough:
            yield [merged_few]
    if len(few) < len(sets):
        yield sets[len(few) :]
    if len(parts) < _MOST_HALVED:
        parts = cut.near_parts(nearness, _REACHES[1])
        yield _distinct(merge_parts(parts, nearness, limits, enough, most))


def _distinct(sets: Sequence[list[np.ndarray]]) -> list[list[np.ndarray]]:
    """Sets, the fewest parts first, without empty ones and those that are the same again."""
    found: list[list[np.ndarray]] = []
    for parts in sets:
        if parts and len(parts) > (len(found[-1]) if found else 0):
            found.append(parts)
    return found


def _others(config: DecompositionConfig) -> list[DecompositionConfig]:
    tries = ((1, 1.0), (0, 4 / 3), (1, 4 / 3))[: config.tries]
    return [
        replace(config, seed=config.seed + seed, threshold=min(factor * config.threshold, 1.0))
        for seed, factor in tries
    ]


class _Cut:
    """A closed surface of a solid, which may be all of it, cut by CoACD."""

    def __init__(
        self, mesh: Mesh, solid: Solid, config: DecompositionConfig, jitter: float
    ) -> None:
        share = mesh.diagonal / solid.diagonal
        self._mesh = simplify_solid(mesh, config.simplify * solid.diagonal)
        of = "" if solid.is_exact else ", since its surface was open"
        say_phase(f"cutting {len(self._mesh.faces):,} triangles into convex parts{of}")
        vertices = self._mesh.vertices
        if jitter:
            reach = jitter * solid.diagonal
            rng = np.random.default_rng(config.seed)
            vertices = vertices + rng.uniform(-reach, reach, vertices.shape)
        coacd.set_log_level("error")
        found = coacd.run_coacd(
            coacd.Mesh(vertices, self._mesh.faces),
            # CoACD measures concavity over the size of what it is given.
            threshold=min(config.threshold / min(share, 1.0), 1.0),
            # It tries all pairs: of hundreds of parts that takes longer than the cutting.
            merge=False,
            preprocess_mode="off",
            resolution=config.resolution,
            mcts_nodes=config.nodes,
            mcts_iterations=config.iterations,
            mcts_max_depth=config.depth,
            seed=config.seed,
        )
        self._parts = [np.asarray(points, np.float64) for points, _ in found]

    def near_parts(self, nearness: Nearness, reach: float) -> list[np.ndarray]:
        """Its parts, f64[V, 3] each, without slivers that Qhull refuses; see `halve_parts`."""
        return halve_parts(self._parts, self._mesh, nearness, reach, _MOST_HALVED)
