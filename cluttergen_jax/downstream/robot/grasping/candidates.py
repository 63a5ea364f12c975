"""Candidates for grasps of an object: antipodal pairs, and the ways in which the hand gets around them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from cluttergen_jax.assets import Mesh, ObjectAsset, add_object
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.downstream.robot.description import RobotDescription
from cluttergen_jax.downstream.robot.gripper import Gripper, gripper_of
from cluttergen_jax.downstream.robot.model import hand_spec
from cluttergen_jax.downstream.transforms import inverse, pose_of, rigid, shift_along

FRICTION = 0.4
"""Sliding coefficient that grasps are sought with; the simulator's is 0.5 for most objects."""
_GAP = 2e-4
_ON_SURFACE = 1e-6


class PointPairs(NamedTuple):
    """P pairs of points, object frame, metres.

    Attributes:
      first: f64[P, 3], where one finger touches; axis: f64[P, 3], unit, from there to where the other does.
      width: f64[P], between the two.
    """

    first: np.ndarray
    axis: np.ndarray
    width: np.ndarray

    @property
    def middle(self) -> np.ndarray:
        """f64[P, 3]: halfway between the two."""
        return self.first + self.axis * self.width[:, None] / 2


class _Crossing(NamedTuple):
    """Where L lines enter and leave P convex parts; inf and -inf where they miss.

    Attributes:
      enter, leave: f64[L, P], metres along the line.
      face: i64[L, P], of the part's faces the one through which it leaves.
    """

    enter: np.ndarray
    leave: np.ndarray
    face: np.ndarray


class Union:
    """The union of convex parts, for lines to be cast through; parts: convex collision parts of one body."""

    def __init__(self, parts: Sequence[Mesh]) -> None:
        hulls = [ConvexHull(part.vertices) for part in parts]
        # Qhull cuts a flat face into triangles, each with the same plane.
        self._planes = [np.unique(hull.equations.round(9), axis=0) for hull in hulls]
        self._hulls = hulls

    def surface_points(
        self, number: int, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Points on the faces of all parts, uniform by area, and outward normals, f64[number, 3] each.

        Points that lie inside another part are among them.
        """
        corners = np.concatenate([hull.points[hull.simplices] for hull in self._hulls])
        normals = np.concatenate([hull.equations[:, :3] for hull in self._hulls])
        a, b, c = corners.transpose(1, 0, 2)
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        face = rng.choice(len(area), number, p=area / area.sum())
        u, v = rng.random((2, number, 1))
        fold = u + v > 1
        u = np.where(fold, 1 - u, u)
        v = np.where(fold, 1 - v, v)
        return a[face] + u * (b - a)[face] + v * (c - a)[face], normals[face]

    def cast(self, start: np.ndarray, direction: np.ndarray) -> _Crossing:
        """Where lines f64[L, 3] through `start` cross each part."""
        found = [self._cast_one(planes, start, direction) for planes in self._planes]
        return _Crossing(*(np.stack(each, axis=1) for each in zip(*found, strict=True)))

    @staticmethod
    def _cast_one(
        planes: np.ndarray, start: np.ndarray, direction: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        slope = direction @ planes[:, :3].T
        height = start @ planes[:, :3].T + planes[:, 3]
        is_along = np.abs(slope) < 1e-9
        time = -height / np.where(is_along, 1.0, slope)
        enter = np.where(slope < 0, time, -np.inf)
        leave = np.where(slope > 0, time, np.inf)
        enter[is_along] = leave[is_along] = -np.inf
        enter = np.where(is_along & (height > 0), np.inf, enter)
        leave = np.where(is_along, np.inf, leave)
        first = enter.max(1)
        last = leave.min(1)
        face = leave.argmin(1)
        is_hit = first < last
        return np.where(is_hit, first, np.inf), np.where(is_hit, last, -np.inf), face

    def normals(self, crossing: _Crossing, part: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """f64[R, 3]: outward normals where lines `rows`, i[R], leave the parts `part`, i[R]."""
        return np.array(
            [self._planes[p][crossing.face[row, p], :3] for row, p in zip(rows, part, strict=True)]
        ).reshape(-1, 3)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """f64[P]: metres to the nearest part, below 0 inside; near edges and corners less than that."""
        depth = [(points @ p[:, :3].T + p[:, 3]).max(1) for p in self._planes]
        nearest: np.ndarray = np.min(depth, axis=0)
        return nearest

    def reach(self, start: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """f64[L]: metres that lines run within the union from points inside it, 0 for points outside."""
        crossing = self.cast(start, direction)
        reach = np.zeros(len(start))
        for column in np.argsort(crossing.enter, axis=1).T:
            rows = np.arange(len(start))
            grows = crossing.enter[rows, column] <= reach + _GAP
            reach = np.where(grows, np.maximum(reach, crossing.leave[rows, column]), reach)
        return reach


def sample_pairs(
    union: Union, number: int, rng: np.random.Generator, max_width: float
) -> PointPairs:
    """The antipodal pairs among `number` lines that are cast from the surface inwards.

    Half of them run against the surface's normal, since flat pads turn an object until they lie flat on it;
    the others run level wherever the friction cone allows it, since a level hand comes nearest to a table.
    At the far end the surface may be tilted as far as the cone allows. Fingers may press upon one wall of a
    body, or upon two with a hollow between them.

    Args:
      max_width: metres between the two points.
    """
    points, normals = union.surface_points(number, rng)
    cone = np.arctan(FRICTION)
    axis = -normals
    level = axis * [1, 1, 0]
    length = np.linalg.norm(level, axis=1)
    may_be_level = (length >= np.cos(cone)) & (np.arange(number) % 2 == 1)
    axis[may_be_level] = level[may_be_level] / length[may_be_level, None]
    crossing = union.cast(points, axis)
    rows, width, part = (np.concatenate(each) for each in zip(*_segments(crossing), strict=True))
    fits = width <= max_width
    rows = rows[fits]
    width = width[fits]
    facing = (union.normals(crossing, part[fits], rows) * axis[rows]).sum(1)
    is_good = facing >= np.cos(cone)
    rows = rows[is_good]
    return PointPairs(points[rows], axis[rows], width[is_good])


def _segments(crossing: _Crossing) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Ends of the segments of lines whose first point is where one of them begins.

    Each is a triple: lines, metres to the end, and the part that ends there. A line's first segment and those
    behind it count, since a finger may press upon the far side of a hollow body.
    """
    num_lines = len(crossing.enter)
    every = np.arange(num_lines)
    reach = np.full(num_lines, -np.inf)
    last = np.zeros(num_lines, np.int64)
    is_ours = np.zeros(num_lines, bool)
    ends = []
    for column in np.argsort(crossing.enter, axis=1).T:
        enter = crossing.enter[every, column]
        leave = crossing.leave[every, column]
        is_new = enter > reach + _GAP
        done = every[is_ours & is_new & np.isfinite(reach)]
        ends.append((done, reach[done].copy(), last[done].copy()))
        # Behind the last part everything is inf: nothing more ends there.
        is_ours = (is_ours | (is_new & (np.abs(enter) < _ON_SURFACE))) & np.isfinite(enter)
        grows = np.isfinite(enter) & (leave > reach)
        reach = np.where(grows, leave, reach)
        last = np.where(grows, column, last)
    done = every[is_ours]
    ends.append((done, reach[done], last[done]))
    return ends


MIN_COVER = 0.012
"""Metres of a pad, along and across the approach, that must lie on an object that has so much."""
MARGIN = 0.004
"""Metres that an object is narrower than the hand opens."""
OBJECT = "object"
_LEAST_WIDTH = 0.001
_SHALLOW = (0.0, 0.005)
"""Metres by which a grasp's points may lie nearer to the finger's tips than the middle of the pads."""
_INSIDE = 5e-4
STEEPEST_UP = 0.1
_DOWN = np.array([0.0, 0.0, -1.0])
CLEARANCE = 0.0015
"""Metres between the hand and the object; the arm is where it should be to a millimetre."""
_PLANE = "plane"
_GROUND_GAP = 0.001
_GROUND_HALF = (0.5, 0.5, 0.05)
BACK = (0.0, 0.03, 0.06, 0.1)
"""Metres before the grasp at which the hand must be clear of the object too."""


class GraspCandidates(NamedTuple):
    """C ways to hold an object.

    Attributes:
      pose: f64[C, 4, 4], T_object_tool. width: f64[C], metres between the fingers.
      is_low: bool[C], the hand can come there while the object rests on a plane; the others need room below.
    """

    pose: np.ndarray
    width: np.ndarray
    is_low: np.ndarray

    def take(self, index: np.ndarray | slice) -> GraspCandidates:
        """Those at `index`."""
        return GraspCandidates(*(each[index] for each in self))


def candidates_of(
    asset: ObjectAsset,
    number: int,
    num_lines: int,
    rng: np.random.Generator,
    robot: RobotDescription,
) -> GraspCandidates:
    """At most `number` candidates of which the hand is clear where it comes, spread over the object.

    Those that can be had while the object rests on a plane as it does in scenes come first.

    Args:
      num_lines: lines that are cast to find pairs; half as many ways of approach are looked at.
      robot: whose hand it is.
    """
    union = Union(asset.parts)
    gripper = gripper_of(robot)
    pairs = sample_pairs(union, num_lines, rng, 2 * gripper.max_opening - MARGIN)
    found = draw_approaches(union, pairs, max(num_lines // 2, 1), rng, gripper, robot.gripper.pad)
    found = found.take(spread(found.pose, min(len(found.width), 4 * number), rng))
    hand = HandCheck(asset, robot)
    clear = [hand.clear_of(*each) for each in zip(found.pose, found.width, strict=True)]
    of_object, of_plane = np.array(clear, bool).reshape(-1, 2).T
    found = found._replace(is_low=of_object & of_plane)
    order = np.concatenate([np.flatnonzero(found.is_low), np.flatnonzero(of_object & ~of_plane)])
    return found.take(order[:number])


def draw_approaches(
    union: Union,
    pairs: PointPairs,
    number: int,
    rng: np.random.Generator,
    gripper: Gripper,
    pad: float,
    down: np.ndarray = _DOWN,
    spread: float | None = None,
) -> GraspCandidates:
    """So many poses of the tool about random pairs, deep enough; half of them come from straight above.

    Nothing is asked of the hand: of some it cannot come there.

    Args:
      pad: metres, half of a pad's length along the approach.
      down: f64[3], unit, where the world's -z is in the object's frame.
      spread: radians, standard deviation of the turns of the other half; None turns them evenly by up to a
        right angle.
    """
    wide = np.flatnonzero(pairs.width >= _LEAST_WIDTH)
    if not wide.size:
        return GraspCandidates(np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0, bool))
    row = rng.choice(wide, number)
    axis = pairs.axis[row]
    width = pairs.width[row]
    middle = pairs.middle[row]
    below = _downwards(axis, down)
    side = np.cross(axis, below)
    quarter = np.pi / 2
    turned = (
        rng.uniform(-quarter, quarter, number) if spread is None else rng.normal(0, spread, number)
    )
    angle = np.where(np.arange(number) % 2, np.clip(turned, -quarter, quarter), 0.0)
    approach = np.cos(angle)[:, None] * below + np.sin(angle)[:, None] * side
    shallow = rng.choice(_SHALLOW, number)
    is_deep = pads_cover(union, pairs.first[row], axis, approach, pad, shallow)
    keep = is_deep & (approach @ down >= -STEEPEST_UP)
    turn = np.stack([np.cross(axis, approach), axis, approach], axis=-1)
    # The pads are where the tool's origin is, but for what they move along the approach as they close.
    back = shallow + gripper.depth_of(width)
    # They close on the object's middle, and not on the tool's axis where one of them stands still.
    aside = gripper.shift_of(width)
    pose = rigid(turn, middle - back[:, None] * approach - aside[:, None] * axis)[keep]
    return GraspCandidates(pose, width[keep], np.zeros(len(pose), bool))


def pads_cover(
    union: Union,
    first: np.ndarray,
    axis: np.ndarray,
    approach: np.ndarray,
    pad: float,
    shallow: np.ndarray | float = 0.0,
) -> np.ndarray:
    """bool[P]: pads lie on enough of an object, along and across the approach (`MIN_COVER`).

    Args:
      first: f64[P, 3], where one finger touches. axis, approach: f64[P, 3], from there to the other, and of
        the hand. pad: metres, half of a pad's length. shallow: f64[P], metres by which `first` is nearer to
        the tips than the pads' middle.
    """
    inside = first + _INSIDE * axis
    ahead = union.reach(inside, approach)
    behind = union.reach(inside, -approach)
    depth = np.minimum(ahead, pad - shallow) + np.minimum(behind, pad + shallow)
    across = np.cross(axis, approach)
    left = union.reach(inside, across)
    right = union.reach(inside, -across)
    cover = np.minimum(left, pad) + np.minimum(right, pad)
    is_deep: np.ndarray = (depth >= np.minimum(MIN_COVER, 0.75 * (ahead + behind))) & (
        cover >= np.minimum(MIN_COVER, 0.75 * (left + right))
    )
    return is_deep


def _downwards(axis: np.ndarray, down: np.ndarray) -> np.ndarray:
    """f64[P, 3]: of the directions across each axis the one that points down the most."""
    below = down - axis * (axis @ down)[:, None]
    length = np.linalg.norm(below, axis=1, keepdims=True)
    # Across an upright axis any direction is as good as another.
    any_side = np.eye(3)[np.argmin(np.abs(down))]
    any_side = any_side - down * (down @ any_side)
    return np.where(
        length > 1e-3, below / np.maximum(length, 1e-3), any_side / np.linalg.norm(any_side)
    )


class HandCheck:
    """Says of which poses the open hand is clear of an object and of the plane that the object rests on.

    Args:
      asset: the object. robot: whose hand it is.
    """

    def __init__(self, asset: ObjectAsset, robot: RobotDescription) -> None:
        spec = hand_spec(ContactConfig(), robot)
        self._gripper = gripper_of(robot)
        for geom in spec.geoms:
            geom.margin = CLEARANCE
        body = add_object(spec, asset, OBJECT)
        below = -asset.half_extents[2] - _GROUND_GAP - _GROUND_HALF[2]
        body.add_geom(
            name=_PLANE, type=mujoco.mjtGeom.mjGEOM_BOX, size=_GROUND_HALF, pos=(0.0, 0.0, below)
        )
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._start = int(self._model.joint(OBJECT).qposadr[0])
        self._plane = self._model.geom(_PLANE).id
        self._is_hand = self._model.geom_bodyid != self._model.body(OBJECT).id

    def clear_of(self, pose: np.ndarray, width: float) -> tuple[bool, bool]:
        """Whether the hand touches neither the object nor the plane at T_object_tool f64[4, 4].

        Nor before, where it comes straight.
        """
        opening = self._gripper.opening_of(width)
        of_plane = True
        self._data.qpos[: self._start] = self._gripper.joints_of(opening)
        for back in BACK:
            of_object, is_clear = self._look(pose, back)
            if not of_object:
                return False, False
            of_plane = of_plane and is_clear
        # Fingers that move on arcs come nearer to the plane as they close.
        ahead = float(self._gripper.depth_of(width) - self._gripper.depth_of(2 * opening))
        if of_plane and ahead:
            of_plane = self._look(pose, -ahead)[1]
        return True, of_plane

    def is_clear_at(self, pose: np.ndarray, width: float) -> bool:
        """Whether the hand is clear of the object at T_object_tool f64[4, 4], whatever its way there."""
        self._data.qpos[: self._start] = self._gripper.joints_of(self._gripper.opening_of(width))
        return self._look(pose, 0.0)[0]

    def _look(self, pose: np.ndarray, back: float) -> tuple[bool, bool]:
        """Whether the hand, so far before a grasp, is clear of the object, and of the plane."""
        data = self._data
        T_hand_object = shift_along(self._gripper.T_hand_tool, (0.0, 0.0, back)) @ inverse(pose)
        data.qpos[self._start :] = pose_of(T_hand_object)
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_collision(self._model, data)
        # Parts of a hand may touch each other.
        asked = ~self._is_hand[data.contact.geom].all(1)
        on_plane = (data.contact.geom == self._plane).any(1)
        # The plane's distance is allowed for in where it lies.
        of_plane = not (data.contact.dist < 0)[asked & on_plane].any()
        return bool(on_plane[asked].all()), of_plane


def spread(pose: np.ndarray, number: int, rng: np.random.Generator) -> np.ndarray:
    """i[number]: poses f64[C, 4, 4], each the farthest from those before it.

    Two poses are as far apart as their positions, and as their axes of approach and of closing, where half
    a turn about the approach changes nothing: a right angle counts as much as 10 cm.
    """
    if not len(pose):
        return np.zeros(0, np.int64)
    distance = np.full(len(pose), np.inf)
    chosen = [int(rng.integers(len(pose)))]
    while len(chosen) < number:
        near = pose[chosen[-1]]
        place = np.linalg.norm(pose[:, :3, 3] - near[:3, 3], axis=1)
        approach = np.arccos(np.clip(pose[:, :3, 2] @ near[:3, 2], -1, 1))
        closing = np.arccos(np.clip(np.abs(pose[:, :3, 1] @ near[:3, 1]), 0, 1))
        distance = np.minimum(distance, place + 0.1 * (approach + closing) / (np.pi / 2))
        chosen.append(int(distance.argmax()))
    return np.array(chosen[:number], np.int64)
