"""Outlines of flat areas: with fewer corners where they are concave, and cut into convex pieces.

An outline has the solid on its left: outer ones run counter-clockwise, holes clockwise.
"""

from __future__ import annotations

import manifold3d
import numpy as np

_ROUND = 0.09
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
        around = manifold3d.CrossSection(
            [
                _without_edges(
                    ring, factor * (reach if signed_area(ring) > 0 else _around_hole(ring, reach))
                )
                for ring in rings
            ]
        )
        if around.num_contour() == len(rings) and around.area() > (1 - lost) * section.area():
            return [np.asarray(ring) for ring in around.to_polygons()]
    return rings


def _around_hole(ring: np.ndarray, reach: float) -> float:
    return min(reach, _ROUND * hole_radius(ring))


def hole_radius(ring: np.ndarray) -> float:
    """Metres, of a circle of the same area."""
    return float(np.sqrt(abs(signed_area(ring)) / np.pi))


def _without_edges(ring: np.ndarray, reach: float) -> np.ndarray:
    """A closed outline without edges between concave corners, as many at a time as come close.

    The edges before and after are made longer until they meet, no farther than `reach` from the outline.
    """
    number = len(ring)
    sides = np.roll(ring, -1, 0) - ring
    is_concave = _cross(np.roll(sides, 1, 0), sides) < 0
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
    bend = _cross(sides[edge], sides[other])
    if bend >= 0:
        return None
    share = _cross(ring[other] - ring[edge], sides[other]) / bend
    return ring[edge] + share * sides[edge] if share >= 1 else None


def _distance(point: np.ndarray, ring: np.ndarray, sides: np.ndarray) -> float:
    """Metres from a point to an outline."""
    apart = point - ring
    share = np.clip((apart * sides).sum(1) / (sides**2).sum(1), 0, 1)
    return float(np.linalg.norm(apart - share[:, None] * sides, axis=1).min())


def _cross(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]


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
    is_concave = _cross(np.roll(sides, 1, 0), sides) < -_STRAIGHT * np.roll(length, 1) * length
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
        if any(_cross(points[y] - points[x], points[z] - points[y]) < 0 for x, y, z in corners):
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
