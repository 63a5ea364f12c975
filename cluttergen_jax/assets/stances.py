"""Every pose in which a body can rest on a plane, and how far it can be tilted there, from its convex hull.

On some faces of the hull the centre of mass is lower than in all directions near by: these are the poses.
Between two faces the body rolls over their common edge, and is highest when the centre of mass is above it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree
from scipy.spatial import ConvexHull

_MIN_TIP = np.radians(5)
_SAME = np.cos(np.radians(12))
# A body that rolls so far with a push has left its pose: a can that lies, a ball.
_AWAY = np.cos(np.radians(30))
_MOST = 10
_MOST_TRIED = 60


@dataclass(frozen=True, eq=False)
class Stance:
    """One pose at rest."""

    up: np.ndarray  # f64[3], unit: the direction of the body's frame that points up.
    tip: float  # Radians by which the body can be tilted, in the weakest direction, and comes back.
    likelihood: (
        float  # Share of all directions from which it rolls into this pose, if it rolls slowly.
    )
    height: float  # Metres from the plane to the highest point.


def stances(points: np.ndarray, center: np.ndarray) -> list[Stance]:
    """The poses that bear a tilt of 5 degrees, the steadiest first and ten at most.

    Args:
      points: f64[N, 3], of which the convex hull is taken.
      center: f64[3], the centre of mass.
    """
    found = list(islice(_rests(points, center), _MOST_TRIED))
    steady = [stance for stance in found if stance.tip >= _MIN_TIP]
    return sorted(steady, key=lambda stance: -stance.tip)[:_MOST]


def upright_stance(points: np.ndarray, center: np.ndarray, within: float) -> Stance | None:
    """The steadiest pose in which z points up, to `within` radians; None if none bears a tilt of 5 degrees.

    Args:
      points: f64[N, 3], of which the convex hull is taken.
      center: f64[3], the centre of mass.
    """
    upright = [each for each in _rests(points, center) if each.up[2] > np.cos(within)]
    best = max(upright, key=lambda stance: stance.tip, default=None)
    return None if best is None or best.tip < _MIN_TIP else best


def _rests(points: np.ndarray, center: np.ndarray) -> Iterator[Stance]:
    """The poses at rest, the likeliest first; of poses 12 degrees apart or less, the likeliest alone."""
    points = points[ConvexHull(points).vertices] - center
    faces = _Faces.of(points)
    rest = faces.rests()
    likelihood = np.bincount(rest, faces.solid_angles(), len(rest))
    kept: list[int] = []
    for face in sorted(set(rest.tolist()), key=lambda face: -likelihood[face]):
        near = [other for other in kept if faces.normals[other] @ faces.normals[face] > _SAME]
        if near:
            likelihood[near[0]] += likelihood[face]
        else:
            kept.append(face)
    rolls = faces.rolls()
    for face in kept:
        up = -faces.normals[face]
        height = float(np.ptp(points @ up))
        yield Stance(up, faces.tip(face, rolls), float(likelihood[face]), height)


@dataclass(frozen=True, eq=False)
class _Faces:
    """A hull's triangles about the centre of mass."""

    corners: np.ndarray  # f64[F, 3, 3].
    normals: np.ndarray  # f64[F, 3], outward.
    heights: np.ndarray  # f64[F], of the centre of mass over each.
    neighbors: np.ndarray  # i64[F, 3], over the edge opposite of each corner.

    @staticmethod
    def of(points: np.ndarray) -> _Faces:
        hull = ConvexHull(points)
        planes = hull.equations
        return _Faces(points[hull.simplices], planes[:, :3], -planes[:, 3], hull.neighbors)

    def rests(self) -> np.ndarray:
        """i64[F]: the face on which a body that is set down on each comes to rest, rolling downwards."""
        faces = np.arange(len(self.normals))
        below = self.normals * self.heights[:, None]
        outside = np.empty((len(faces), 3))
        for k in range(3):
            start = self.corners[:, k - 2]
            end = self.corners[:, k - 1]
            side = np.cross(end - start, self.normals)
            side *= np.sign((side * (start - self.corners[:, k])).sum(1))[:, None]
            outside[:, k] = (side * (below - start)).sum(1) / np.maximum(
                np.linalg.norm(side, axis=1), 1e-30
            )
        worst = outside.argmax(1)
        to = self.neighbors[faces, worst]
        is_down = (outside[faces, worst] > 1e-9) & (self.heights[to] <= self.heights + 1e-12)
        rest = np.where(is_down, to, faces)
        for _ in range(int(np.ceil(np.log2(len(faces)))) + 1):
            rest = rest[rest]
        return rest

    def solid_angles(self) -> np.ndarray:
        """f64[F]: the share of all directions from the centre that go through each face."""
        a, b, c = (self.corners[:, k] for k in range(3))
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        volume = np.abs((a * np.cross(b, c)).sum(1))
        rest = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (a * c).sum(1) * lb
        return np.arctan2(volume, rest) / (2 * np.pi)

    def rolls(self) -> csr_array:
        """f64[F, F], sparse: the cheapest ways between faces; of each step the centre's greatest height."""
        here = np.repeat(np.arange(len(self.normals)), 3)
        there = self.neighbors.ravel()
        start = np.roll(self.corners, -1, axis=1).reshape(-1, 3)
        end = np.roll(self.corners, -2, axis=1).reshape(-1, 3)
        along = (end - start) / np.maximum(np.linalg.norm(end - start, axis=1), 1e-30)[:, None]
        lever = start - (start * along).sum(1)[:, None] * along
        length = np.linalg.norm(lever, axis=1)
        lever /= np.maximum(length, 1e-30)[:, None]
        normals = self.normals[here]
        others = self.normals[there]
        turn = (normals * others).sum(1) - 1e-9
        is_over = ((lever * normals).sum(1) >= turn) & ((lever * others).sum(1) >= turn)
        highest = np.where(is_over, length, np.maximum(self.heights[here], self.heights[there]))
        tree = minimum_spanning_tree(coo_array((highest, (here, there))).tocsr())
        return csr_array(tree + tree.T)

    def tip(self, face: int, rolls: csr_array) -> float:
        """Radians: the tilt over one edge that lifts the centre as much as the cheapest way out does."""
        order, before = breadth_first_order(rolls, face, directed=False)
        steps = np.asarray(rolls[order[1:], before[order[1:]]]).ravel()
        highest = np.full(len(self.normals), self.heights[face])
        for there, step in zip(order[1:].tolist(), steps.tolist(), strict=True):
            highest[there] = max(highest[before[there]], step)
        away = self.normals @ self.normals[face] < _AWAY
        return float(np.arccos(min(self.heights[face] / highest[away].min(), 1.0)))
