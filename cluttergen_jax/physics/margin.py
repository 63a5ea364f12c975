"""How far inside its support a body's centre of mass lies, in plan.

The support of a body is the convex polygon of the points at which something below presses it upwards. While
the centre of mass lies over it, gravity tips nothing; the nearer it is to an edge, the smaller a push, a tilt
or another simulator's error has to be to do so.

`support_margin` takes one set of points in a few microseconds; `mjx.support_margins` is its like
for a batch in JAX. `held_margin` counts contacts at a body's sides as well (`StabilityConfig.side_support`).
"""

from __future__ import annotations

import math
from itertools import pairwise

import mujoco
import numpy as np

from cluttergen_jax.geometry import convex_hull
from cluttergen_jax.physics.layout import Layout

MIN_LIFT = math.sin(math.radians(10))
"""Vertical part of a contact's unit normal from which it carries: what merely touches a side does not."""

MAX_BESIDE = 0.5
"""Vertical part of a contact's unit normal up to which it is one from the side: 30 degrees from level."""
TOUCH_REACH = 0.0005
"""Metres of gap across which two objects still touch: what stands side by side parts by micrometres."""
UNDER_REACH = 0.002
"""Metres of gap up to which an object is right under another, as a fork under the rim of a plate."""

HOLD_FRICTION = 0.35
"""Of what a body stands on, while its side is held: 0.7 times the usual 0.5, as `robust` asks for."""

_FAN = 2 * np.pi * np.arange(180) / 180
_DIRECTIONS = np.stack([np.cos(_FAN), np.sin(_FAN)], axis=1)
"""In which a body with contacts at its sides might tip, besides across the sides of its polygon."""

_SAME_REACH = 1e-4
"""Metres by which points that are the farthest in a direction may differ."""
MIN_SHIFT = 1e-5
"""Metres that an attempt must have moved a neighbour for its support to be looked at again."""

Point = tuple[float, float]


def support_margin(points: np.ndarray) -> float:
    """The signed distance from the origin to the edge of the convex hull of points.

    Args:
      points: f[M, 2], metres, in plan, relative to the centre of mass.

    Returns:
      Metres: positive within, negative outside, zero on a segment; -inf for no points.
    """
    corners = convex_hull(points)
    if len(corners) < 2:
        return -math.hypot(*corners[0]) if corners else -math.inf
    sides = list(pairwise([*corners, corners[0]]))
    inside = min(_left_of(side) for side in sides)
    return inside if inside > 0 else -min(_distance(side) for side in sides)


def held_margin(points: np.ndarray, sides: np.ndarray, normals: np.ndarray) -> float:
    """The margin of a body that is held from its sides as well: it leans on a wall, or lies in a hollow.

    The support margin is the least value, over all directions d in plan, of the largest d . p, p the points
    that carry: how far the centre of mass is from the point over which the body would tip in direction d.
    Tipping by a small angle there moves the point of another contact, at r from the first, by
    v = (z x d) x r. A contact of normal n that stands against that, v . n < 0, presses with a force f at
    most: the body's weight times `HOLD_FRICTION` over |n_xy|, as what it stands on has to take the push. Its
    moment f |v . n| over the weight is added to d . p. That is a part of the region in which a body in
    contact can be in equilibrium (Bretl and Lall, IEEE T-RO 24(4), 2008).

    Args:
      points: f[M, 3], metres, of contacts that carry, relative to the centre of mass.
      sides: f[C, 3], likewise, of contacts that hold it from a side; normals: f[C, 3], unit, in which they
        press on the body.

    Returns:
      Metres: at least `support_margin` of the points, and that where nothing is held; -inf for no points.
    """
    least = support_margin(points[:, :2])
    if not len(points) or not len(sides):
        return least
    corners = convex_hull(points[:, :2])
    edges = np.diff([*corners, corners[0]], axis=0)
    across = np.stack([edges[:, 1], -edges[:, 0]], axis=1)
    length = np.linalg.norm(across, axis=1)
    across = across[length > 0] / length[length > 0, None]
    # Of two points the polygon is a line, over which it may tip to both sides.
    inwards = -points[:, :2][np.linalg.norm(points[:, :2], axis=1) > 0]
    inwards /= np.linalg.norm(inwards, axis=1, keepdims=True)
    direction = np.concatenate([_DIRECTIONS, across, inwards])
    reach = direction @ points[:, :2].T
    farthest = reach.max(1)
    lever = sides[None] - points[:, None]
    along = np.einsum("dk,mck->dmc", direction, lever[..., :2])
    slope = np.linalg.norm(normals[:, :2], axis=1)
    pressing = (direction @ normals[:, :2].T)[:, None]
    against = along * normals[:, 2] - lever[..., 2] * pressing
    held = np.maximum(HOLD_FRICTION * against / slope, 0.0).max(2)
    # Over an edge it tips about both of its points: the one at which less holds it counts.
    held = np.where(reach >= farthest[:, None] - _SAME_REACH, held, np.inf).min(1)
    return max(float((farthest + held).min()), least)


def _left_of(side: tuple[Point, Point]) -> float:
    """How far the origin is to the left of the line through a side."""
    (x0, y0), (x1, y1) = side
    return (x0 * (y1 - y0) - y0 * (x1 - x0)) / math.hypot(x1 - x0, y1 - y0)


def _distance(side: tuple[Point, Point]) -> float:
    """From the origin to a side."""
    (x0, y0), (x1, y1) = side
    dx = x1 - x0
    dy = y1 - y0
    along = min(max(-(x0 * dx + y0 * dy) / (dx * dx + dy * dy), 0.0), 1.0)
    return math.hypot(x0 + along * dx, y0 + along * dy)


def bearers_of(layout: Layout, data: mujoco.MjData, index: int) -> np.ndarray:
    """The objects that press object `index` upwards, in a scene whose contacts are computed: bool[K]."""
    contact = data.contact
    pair = layout.geom_object[contact.geom]
    lift = contact.frame[:, 2]
    carried, carrier = np.where(lift > 0, pair.T[::-1], pair.T)
    bears = np.zeros(layout.num_objects + 1, bool)
    presses = (np.abs(lift) >= MIN_LIFT) & (contact.dist < 0)
    bears[carrier[presses & (carried == index)]] = True
    return bears[:-1]


def margins_of(
    layout: Layout, data: mujoco.MjData, objects: np.ndarray, side_support: bool = False
) -> np.ndarray:
    """Support margins of some objects of a scene at rest whose contacts are computed.

    Args:
      objects: i[n], indices of the layout's objects.
      side_support: contacts at their sides count as well (`held_margin`).

    Returns:
      f64[n], metres; -inf for what nothing carries.
    """
    contact = data.contact
    pair = layout.geom_object[contact.geom]
    lift = contact.frame[:, 2]
    # A contact's normal points from the first geom to the second, which it presses that way.
    carried = np.where(lift > 0, pair[:, 1], pair[:, 0])
    carried[(np.abs(lift) < MIN_LIFT) | (contact.dist > 0)] = -1
    if side_support:
        return _held_margins(layout, data, objects, carried)
    position = contact.pos[:, :2]
    centers = data.xipos[layout.body_index[objects], :2]
    margins = []
    for index, center in zip(objects, centers, strict=True):
        margins.append(support_margin(position[carried == index] - center))
    return np.array(margins)


def _held_margins(
    layout: Layout, data: mujoco.MjData, objects: np.ndarray, carried: np.ndarray
) -> np.ndarray:
    """f64[n]: `held_margin` of objects; carried: i[C], whom each contact carries, -1 for nobody."""
    contact = data.contact
    pair = layout.geom_object[contact.geom]
    normal = contact.frame[:, :3]
    is_side = (np.linalg.norm(normal[:, :2], axis=1) >= MIN_LIFT) & (contact.dist <= 0)
    margins = []
    for index, center in zip(objects, data.xipos[layout.body_index[objects]], strict=True):
        offset = contact.pos - center
        # Towards this body; what presses it down from above does not hold its side.
        towards = np.where((pair[:, 1] == index)[:, None], normal, -normal)
        holds = is_side & (pair == index).any(1) & (towards[:, 2] >= -MIN_LIFT)
        margins.append(held_margin(offset[carried == index], offset[holds], towards[holds]))
    return np.array(margins)


def beside_of(layout: Layout, data: mujoco.MjData, reach: float) -> np.ndarray:
    """The pairs of objects that touch from the side, in a scene whose contacts are computed: bool[K, K].

    Args:
      reach: metres, the widest gap across which two still touch.
    """
    contact = data.contact
    pair = layout.geom_object[contact.geom]
    is_beside = (np.abs(contact.frame[:, 2]) < MAX_BESIDE) & (contact.dist <= reach)
    touch = np.zeros((layout.num_objects + 1,) * 2, bool)
    touch[pair[is_beside, 0], pair[is_beside, 1]] = True
    return (touch | touch.T)[:-1, :-1]


class OverlapProbe:
    """Collides one scene at a time, without dynamics, everything awake.

    Args:
      layout: of the compiled world.
      side_support: margins count what holds a body from its sides.
      reach: metres of gap over which contacts are seen, for `beside` and `lies_on`.
    """

    def __init__(self, layout: Layout, side_support: bool = False, reach: float = 0.0) -> None:
        self._layout = layout
        self._side_support = side_support
        self._model = layout.model
        self._reach = reach
        if reach:
            self._model = layout.model.__copy__()
            self._model.geom_margin[:] = reach
            self._model.geom_gap[:] = reach
        self._data = mujoco.MjData(self._model)
        self._parked = layout.parked

    def depths(self, poses: np.ndarray, is_placed: np.ndarray) -> np.ndarray | None:
        """Overlap of every pair of bodies.

        Args:
          poses: f[K, 7]; is_placed: bool[K].

        Returns:
          f64[K + 1, K + 1], metres, symmetric, index K for the support, zero where apart; None if there was
          no room for all contacts.
        """
        model = self._model
        data = self._data
        num_objects = self._layout.num_objects
        mujoco.mj_resetData(model, data)
        data.qpos[:] = np.where(is_placed[:, None], poses, self._parked).ravel()
        try:
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_collision(model, data)
        except mujoco.FatalError:
            return None
        if data.warning[mujoco.mjtWarning.mjWARN_CONTACTFULL].number:
            return None
        depths = np.zeros((num_objects + 1, num_objects + 1))
        pair = self._layout.geom_object[data.contact.geom]
        depth = np.maximum(-data.contact.dist, 0.0)
        np.maximum.at(depths, (pair[:, 0], pair[:, 1]), depth)
        return np.maximum(depths, depths.T)

    def margins(self, objects: np.ndarray) -> np.ndarray:
        """Support margins of these objects, i[n], in the scene whose depths were asked for last: f64[n]."""
        return margins_of(self._layout, self._data, objects, self._side_support)

    def bearers(self, index: int) -> np.ndarray:
        """The objects that press object `index` upwards in that scene: bool[K]."""
        return bearers_of(self._layout, self._data, index)

    def lies_on(self) -> np.ndarray:
        """Which objects, by row, lie on which, and not beside it, over gaps within reach: bool[K, K]."""
        contact = self._data.contact
        pair = self._layout.geom_object[contact.geom]
        lift = contact.frame[:, 2]
        upper, lower = np.where(lift > 0, pair.T[::-1], pair.T)
        presses = (np.abs(lift) >= MAX_BESIDE) & (contact.dist < self._reach)
        lies = np.zeros((self._layout.num_objects + 1,) * 2, bool)
        lies[upper[presses], lower[presses]] = True
        return lies[:-1, :-1]

    def beside(self) -> np.ndarray:
        """The pairs of objects that touch from the side in that scene, over gaps within reach: bool[K, K]."""
        return beside_of(self._layout, self._data, self._reach)


def count_beside(
    layout: Layout, object_index: np.ndarray, is_placed: np.ndarray, poses: np.ndarray
) -> np.ndarray:
    """i64[N]: the pairs of objects that touch from the side in N scenes of S slots.

    Args:
      object_index: i[N, S]; is_placed: bool[N, S]; poses: f[N, S, 7], world, metres, wxyz.
    """
    probe = OverlapProbe(layout, reach=TOUCH_REACH)
    counts = []
    for index, placed, of_slots in zip(object_index, is_placed, poses, strict=True):
        is_there = np.zeros(layout.num_objects, bool)
        is_there[index[placed]] = True
        everything = layout.parked
        everything[index[placed]] = of_slots[placed]
        has_room = probe.depths(everything, is_there) is not None
        counts.append(int(np.triu(probe.beside()).sum()) if has_room else 0)
    return np.array(counts, int)
