"""Objects seen from above as convex pieces: how near they may come to each other in plan."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.placement.types import Geometry
from cluttergen_jax.types import Array

NUM_PIECES = 2
"""Convex pieces of an outline: of a pan the dish and the handle. What is convex has the same one twice."""
NUM_DIRECTIONS = 40
"""Along which outlines are held apart, evenly around, the region's axes among them: for two discs of 26 cm
the gap is known to 0.8 mm."""
_CUTS = 12
_OFFSETS = 9
"""Straight cuts in two that are tried: directions, and places across."""
_SAVED = 0.1
"""Of the area of the convex hull: so much less two pieces have to cover together."""
_SEAM = 0.006
"""Metres to either side of a cut that belong to both pieces: columns are that far apart."""
_FLAT = 0.003
"""Metres: what of an outline is so near to its farthest point is a face that touches."""
_NOWHERE = -1e3


def directions() -> np.ndarray:
    """f64[D, 2]: unit vectors, the first one along x; D is a multiple of four."""
    angle = 2 * np.pi * np.arange(NUM_DIRECTIONS) / NUM_DIRECTIONS
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


class Outlines(struct.PyTreeNode):
    """The outlines of K objects as they stand upright, object frames, metres.

    Attributes:
      corners: f32[K, P, D, 2], of P convex pieces each: the farthest point along each direction.
    """

    corners: Array

    @staticmethod
    def of(geometry: Geometry) -> Outlines:
        """Reads the columns of `geometry`, outside `jit`."""
        columns = np.asarray(geometry.column_xy, np.float64)
        is_column = np.asarray(geometry.is_column)
        half = np.asarray(geometry.half_extents, np.float64)[:, :2]
        found = [
            _pieces(_with_corners(xy[keeps], own))
            for xy, keeps, own in zip(columns, is_column, half, strict=True)
        ]
        return Outlines(jnp.asarray(np.stack(found), jnp.float32))


def _with_corners(points: np.ndarray, half: np.ndarray) -> np.ndarray:
    """f64[C, 2]: an object's columns, and those corners of its box that they nearly reach.

    Columns are a sample, in which corners may be missing.
    """
    corners = half * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    away = np.linalg.norm(points[:, None] - corners, axis=-1).min(0)
    return np.concatenate([points, corners[away < _SEAM]])


def _pieces(points: np.ndarray) -> np.ndarray:
    """f64[P, D, 2] of f64[C, 2]: the convex hull twice, or two pieces where they cover much less."""
    ways = directions()
    # An evenly spread half circle of cuts, each through some places between the outermost points.
    across = ways[: NUM_DIRECTIONS // 2][np.linspace(0, NUM_DIRECTIONS // 2 - 1, _CUTS).astype(int)]
    along = points @ across.T
    shares = np.linspace(0.1, 0.9, _OFFSETS)[:, None]
    cuts = along.min(0) + shares * np.ptp(along, axis=0)
    offset = along.T[:, None] - cuts.T[:, :, None]
    sides = np.stack([offset < _SEAM, offset > -_SEAM])
    whole = _area((points @ ways.T).max(0))
    area = np.stack([_area(_reach(points @ ways.T, side)) for side in sides]).sum(0)
    best = np.unravel_index(np.argmin(area), area.shape)
    chosen = np.ones((NUM_PIECES, len(points)), bool)
    if area[best] < (1 - _SAVED) * whole:
        chosen = sides[:, best[0], best[1]]
    return np.stack([points[side][np.argmax(points[side] @ ways.T, axis=0)] for side in chosen])


def _reach(far: np.ndarray, is_point: np.ndarray) -> np.ndarray:
    """f64[..., D]: how far the points bool[..., C] reach, of f64[C, D]; 0 where there are none."""
    found = np.full((*is_point.shape[:-1], far.shape[1]), -np.inf)
    for place in np.ndindex(is_point.shape[:-1]):
        if is_point[place].any():
            found[place] = far[is_point[place]].max(0)
    return np.where(np.isfinite(found), found, 0.0)


def _area(reach: np.ndarray) -> np.ndarray:
    """f64[...]: of the polygons within lines at f64[..., D] along the directions."""
    step = 2 * np.pi / NUM_DIRECTIONS
    sides = np.roll(reach, 1, -1) + np.roll(reach, -1, -1) - 2 * np.cos(step) * reach
    return (reach * sides).sum(-1) / (2 * np.sin(step))


def reach_of(corners: Array) -> Array:
    """f32[..., D]: how far pieces with corners f32[..., V, 2] reach along each direction, metres."""
    return jnp.max(corners @ jnp.asarray(directions().T, jnp.float32), axis=-2)


def face_of(corners: Array) -> Array:
    """f32[..., D, 2]: from where to where the outermost 3 mm reach across each direction, metres."""
    ways = jnp.asarray(directions(), jnp.float32)
    along = corners @ ways.T
    across = corners @ jnp.stack([-ways[:, 1], ways[:, 0]])
    is_face = along > jnp.max(along, axis=-2, keepdims=True) - _FLAT
    low = jnp.min(jnp.where(is_face, across, jnp.inf), axis=-2)
    high = jnp.max(jnp.where(is_face, across, -jnp.inf), axis=-2)
    return jnp.stack([low, high], axis=-1)


def opposite(of_directions: Array, axis: int) -> Array:
    """What is given for each direction, for the opposite one."""
    return jnp.roll(of_directions, NUM_DIRECTIONS // 2, axis=axis)


class Obstacles(struct.PyTreeNode):
    """Where the origin of an object may not be, seen from above, by Y turns of it. J pairs of pieces.

    Attributes:
      bound: f32[Y, J, D]: a place is free of a pair where it is beyond this along some direction, metres.
      own_face: f32[Y, P, D, 2]; face: f32[S, P, D, 2], of the object and of S that stand there (`face_of`).
    """

    bound: Array
    own_face: Array
    face: Array

    @staticmethod
    def of(own: Array, placed: Array, is_there: Array) -> Obstacles:
        """Of an object's corners f32[Y, P, V, 2] about its origin, and of others', f32[S, P, V, 2] in place.

        Args:
          is_there: bool[S], those that stand there.
        """
        near = opposite(reach_of(own), -1)
        far = jnp.where(is_there[:, None, None], reach_of(placed), _NOWHERE)
        bound = far[None, :, :, None] + near[:, None, None]
        return Obstacles(
            bound=bound.reshape(len(own), -1, NUM_DIRECTIONS),
            own_face=face_of(own),
            face=face_of(placed),
        )

    def gap(self, turn: Array, xy: Array) -> tuple[Array, Array]:
        """f32[N, J], metres, less than 0 where they overlap; and i32[N, J], the direction along which it is.

        Args:
          turn: i32[N]; xy: f32[N, 2].
        """
        beyond = (xy @ jnp.asarray(directions().T, jnp.float32))[:, None] - self.bound[turn]
        return jnp.max(beyond, axis=-1), jnp.argmax(beyond, axis=-1)

    def least_gap(self, turn: Array, xy: Array) -> Array:
        """f32[N], metres: to the nearest."""
        return jnp.min(self.gap(turn, xy)[0], axis=1)

    def way_free(self, turn: Array, xy: Array, way: Array, clearance: float) -> Array:
        """f32[N], metres: how far an object can go along a unit vector f32[2] up to a clearance."""
        ways = jnp.asarray(directions(), jnp.float32)
        beyond = (xy @ ways.T)[:, None] - self.bound[turn] - clearance
        speed = ways @ way
        # It is in the way from where it is within all bounds to where it is beyond one of them again.
        time = beyond / jnp.where(jnp.abs(speed) > 1e-6, -speed, 1e-6)
        enters = jnp.max(jnp.where(speed < -1e-6, time, -jnp.inf), axis=-1)
        leaves = jnp.min(jnp.where(speed > 1e-6, time, jnp.inf), axis=-1)
        is_beside = jnp.any((jnp.abs(speed) <= 1e-6) & (beyond >= 0), axis=-1)
        meets = (enters < leaves) & (leaves > 0) & ~is_beside
        return jnp.min(jnp.where(meets, jnp.maximum(enters, 0.0), jnp.inf), axis=1)

    def contact_at(self, turn: Array, xy: Array, near: float) -> Array:
        """f32[N], metres: the length of the object's outline that is next to others, at most `near` away."""
        gap, way = self.gap(turn, xy)
        pieces = self.face.shape[1]
        pair = jnp.arange(gap.shape[1])
        of_other = self.face[pair // pieces**2, pair // pieces % pieces]
        own = self.own_face[
            turn[:, None], pair % pieces, (way + NUM_DIRECTIONS // 2) % NUM_DIRECTIONS
        ]
        other = of_other[pair, way]
        ways = jnp.asarray(directions(), jnp.float32)
        across = jnp.stack([-ways[:, 1], ways[:, 0]], axis=1)[way]
        shift = jnp.sum(across * xy[:, None], axis=-1)
        # Seen from the other side, across is the other way round.
        low = jnp.maximum(shift - own[..., 1], other[..., 0])
        high = jnp.minimum(shift - own[..., 0], other[..., 1])
        return jnp.sum(jnp.where(gap < near, jnp.maximum(high - low, 0.0), 0.0), axis=1)
