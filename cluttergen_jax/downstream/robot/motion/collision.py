"""Collision queries: may the arm, and what it holds, be where its joints bring it?"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from enum import IntEnum
from typing import NamedTuple

import mujoco
import numpy as np

from cluttergen_jax.assets import (
    VISUAL_GROUP,
    Box,
    ObjectAsset,
    SupportAsset,
    add_part,
    populated_spec,
)
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.downstream.episodes.simulation import Kind, kinds_of
from cluttergen_jax.downstream.robot.description import RobotDescription
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.robot.model import Robot, arm_spec, attach_robot, remove_drawings
from cluttergen_jax.downstream.transforms import inverse, matrix_of, pose_of
from cluttergen_jax.geometry import yaw_quaternion
from cluttergen_jax.placement import VOID
from cluttergen_jax.sensing import PartialMap

CELL = 0.005
"""Metres: the sides of a cell of the map that the arm is planned in."""
THIN = 0.005
"""Metres above the top from which on something is taken to stand there: depth cameras are not more exact."""
_BAND = 0.005
"""Metres that heights within one box may differ by; the box has the highest."""


class OccupancyBoxes(NamedTuple):
    """Boxes from the support's top upwards, world frame.

    Attributes:
      seen: up to the highest surface that was seen. hidden: up to where it was seen to be empty.
    """

    seen: tuple[Box, ...]
    hidden: tuple[Box, ...]


def occupancy_boxes(found: PartialMap) -> OccupancyBoxes:
    """The columns of a map: all that was not seen to be empty counts as taken."""
    is_on = found.grid.bare > VOID
    seen = np.where(is_on & (found.height > THIN), found.height, 0.0)
    hidden = np.where(is_on & ~found.is_seen, found.ceiling, 0.0)
    return OccupancyBoxes(tuple(_boxes(seen, found)), tuple(_boxes(hidden, found)))


def _boxes(height: np.ndarray, found: PartialMap) -> Iterator[Box]:
    """Boxes that cover heights f[W, H] above 0: runs of like cells, joined with those of the next row."""
    open_runs: dict[tuple[int, int], tuple[int, float, float]] = {}
    for row in range(len(height) + 1):
        runs = _runs(height[row]) if row < len(height) else {}
        for span, (first, low, high) in list(open_runs.items()):
            if span in runs and max(high, runs[span][1]) - min(low, runs[span][0]) <= _BAND:
                more = runs.pop(span)
                open_runs[span] = first, min(low, more[0]), max(high, more[1])
            else:
                del open_runs[span]
                yield _box(found, (first, row), span, high)
        open_runs |= {span: (row, low, high) for span, (low, high) in runs.items()}


def _runs(row: np.ndarray) -> dict[tuple[int, int], tuple[float, float]]:
    """First cell and the one after the last of runs of like heights above 0: the least and the greatest."""
    runs = {}
    first = 0
    while first < len(row):
        end = first + 1
        low = float(row[first])
        high = float(row[first])
        while low > 0 and end < len(row) and row[end] > 0:
            lower = min(low, float(row[end]))
            higher = max(high, float(row[end]))
            if higher - lower > _BAND:
                break
            end = end + 1
            low = lower
            high = higher
        if low > 0:
            runs[first, end] = low, high
        first = end
    return runs


def _box(found: PartialMap, rows: tuple[int, int], span: tuple[int, int], height: float) -> Box:
    grid = found.grid
    T = found.grid.T_world_region
    ends = grid.corner + np.array([rows, span], np.float64).T * grid.cell
    middle = T[:3, :3] @ np.array([*ends.mean(0), height / 2]) + T[:3, 3]
    half = (ends[1] - ends[0]) / 2
    yaw = float(np.arctan2(T[1, 0], T[0, 0]))
    x, y, z = middle.tolist()
    return Box((x, y, z), (float(half[0]), float(half[1]), height / 2), yaw)


CLEARANCE = 0.005
"""Metres that everything that moves keeps from everything else on its way."""
NEAR = 0.001
"""Metres that the hand keeps from neighbours while it comes straight to an object or leaves it."""
APART = 0.003
"""Metres that what is held keeps from neighbours where it is asked to."""
ROOM = 0.004
"""Metres that the hand and what it holds keep besides from objects that may be off by as much."""
ROOMS: tuple[float, ...] = (ROOM, ROOM / 2, 0.0)
"""The same, in the order of trying."""
SELF_CLEARANCE = 0.002
"""Metres that the links of the arm keep from each other, the hand, and what it holds."""
_SAG = 0.0015
"""Metres that the hand keeps from the table, however near: the arm is not quite where it is told to be."""
_TOUCH = -0.001
"""Metres that a held object may overlap with what it is taken from or put on."""
_DIP = -0.005
"""The same of a table or stand, which holds level what will hang turned in the hand."""
_BLUR = -0.005
"""The same of columns that were seen, whose sides are known to a cell."""
_AWAY = 100.0
_HELD = "held"
_GROUND = "ground"


_COLUMN_KINDS = (Kind.SEEN, Kind.HIDDEN)


class Mode(IntEnum):
    """What is allowed.

    TRAVEL: nothing comes within the clearance of anything.
    COME: the open hand is about the target, near to it and to all else.
    CARRY: as TRAVEL, but what is held may touch what it stood on or will stand on.
    CLEAR: as CARRY, but what is held touches nothing. APART: it keeps a few millimetres from all else.
    """

    TRAVEL = 0
    COME = 1
    CARRY = 2
    CLEAR = 3
    APART = 4


def _thresholds() -> np.ndarray:
    """f64[modes, kinds, kinds]: metres below which a pair of geoms is too close."""
    limit = np.full((len(Mode), len(Kind), len(Kind)), CLEARANCE)

    def put(modes: Collection[Mode], a: Kind, b: Kind, least: float) -> None:
        for mode in modes:
            limit[mode, a, b] = limit[mode, b, a] = least

    moving = (Kind.ARM, Kind.HAND, Kind.HELD)
    for a in moving:
        for b in moving:
            # Fingers may touch each other and press on what they hold; no link may touch anything.
            limit[:, a, b] = SELF_CLEARANCE if Kind.ARM in (a, b) else 0.0 if a == b else -np.inf
    near = set(Mode) - {Mode.TRAVEL}
    put(near, Kind.HAND, Kind.OTHER, NEAR)
    put(near, Kind.HAND, Kind.GROUND, _SAG)
    put(near, Kind.HAND, Kind.TARGET, NEAR)
    put([Mode.CARRY], Kind.HELD, Kind.GROUND, _DIP)
    put([Mode.CARRY], Kind.HELD, Kind.OTHER, _TOUCH)
    for other in (Kind.GROUND, Kind.OTHER):
        put([Mode.CLEAR], Kind.HELD, other, NEAR)
        put([Mode.APART], Kind.HELD, other, APART)
    # Of columns the whole clearance is kept, but for what is lowered where a placer wants it.
    put([Mode.CARRY, Mode.CLEAR], Kind.HELD, Kind.SEEN, _BLUR)
    put([Mode.CARRY, Mode.CLEAR], Kind.HELD, Kind.HIDDEN, -np.inf)
    return limit


def _roomy() -> np.ndarray:
    """bool[kinds, kinds]: the pairs that keep more where objects may be off from where they are said."""
    pairs = np.zeros((len(Kind), len(Kind)), bool)
    pairs[Kind.HAND, [Kind.OTHER, Kind.TARGET]] = True
    pairs[Kind.HELD, Kind.OTHER] = True
    return pairs | pairs.T


_LIMIT = _thresholds()
_IS_ROOMY = _roomy()


class PlanningWorld:
    """A scene that stands still, the arm, and one object that may be in its hand.

    Only the arm's joints move, so that objects which lie on each other cost nothing.

    Args:
      names, objects: N of the scene; poses: f64[N, 7], T_world_object.
      target: the number of the object that is to be moved.
      base: f64[7], T_world_base, of the `robot`.
      stands: more boxes that objects can stand on.
      columns: boxes in place of objects of which no more is known than what was seen, and where it may hide.

    Attributes:
      room: metres that the hand and what it holds keep besides from objects, `ROOM` at most.
      num_checks: how often it was asked.
    """

    def __init__(
        self,
        names: Sequence[str],
        objects: Sequence[ObjectAsset],
        poses: np.ndarray,
        target: int,
        support: SupportAsset,
        base: np.ndarray,
        robot: RobotDescription,
        stands: Sequence[Box] = (),
        columns: OccupancyBoxes | None = None,
    ) -> None:
        contact = ContactConfig()
        spec = populated_spec(
            names, objects, support, StabilityConfig().timestep, contact, poses=poses
        )
        for joint in list(spec.joints):
            spec.delete(joint)
        for number, box in enumerate(stands):
            add_stand(spec, box, f"{_GROUND}-{number}")
        for kind, boxes in zip(_COLUMN_KINDS, columns or (), strict=False):
            body = spec.worldbody.add_body(name=_name_of(kind))
            for box in boxes:
                _add_box(body, box)
        arm = arm_spec(contact, robot)
        remove_drawings(arm)
        held = arm.body(robot.of_gripper(robot.gripper.body)).add_body(name=_HELD)
        for index, part in enumerate(objects[target].parts):
            add_part(arm, held, f"{_HELD}/part-{index}", part.vertices)
        for geom in arm.geoms:
            geom.margin = CLEARANCE + ROOM
        self.model = attach_robot(spec, arm, robot, base).compile()
        self.data = mujoco.MjData(self.model)
        self.arm = Robot.of(self.model, robot)
        self.gripper = gripper_of(robot)
        self._T_tool_hand = inverse(self.gripper.T_hand_tool)
        self._bodies = [self.model.body(name).id for name in names]
        self._target = self._bodies[target]
        self._held = self.model.body(robot.prefix + _HELD).id
        self._kind = self._kinds()
        self.num_checks = 0
        self.room = 0.0
        self._home = np.array(robot.arm.home)
        self.data.qpos[self.arm.qpos] = self._home
        mujoco.mj_kinematics(self.model, self.data)
        wrist = self.data.body(int(self.model.body_parentid[self.arm.hand]))
        self._T_wrist_world = inverse(matrix_of(np.concatenate([wrist.xpos, wrist.xquat])))
        hand = self.arm.hand
        self._turned: np.ndarray | None = None
        if self.model.body_jntnum[hand]:
            # The arm's last joint may be the hand's own, and turns it besides.
            fixed = np.concatenate([self.model.body_pos[hand], self.model.body_quat[hand]])
            T_world_hand = matrix_of(np.concatenate([self.data.xpos[hand], self.data.xquat[hand]]))
            self._turned = inverse(self._T_wrist_world @ T_world_hand) @ matrix_of(fixed)
        self.release(poses[target])

    def _kinds(self) -> np.ndarray:
        """i[ngeom]: the kind of each geom."""
        kind = kinds_of(self.arm, self._bodies, self._target)
        kind[self._held] = Kind.HELD
        for each in _COLUMN_KINDS:
            body = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, _name_of(each))
            if body >= 0:
                kind[body] = each
        return kind[self.model.geom_bodyid]

    def move(self, number: int, pose: np.ndarray) -> None:
        """Object `number` stands at f64[7] from now on."""
        self._put(self._bodies[number], pose)

    def hold(self, T_tool_object: np.ndarray) -> None:
        """The target is in the hand from now on."""
        self._put(self._held, pose_of(self.gripper.T_hand_tool @ T_tool_object))
        self._put(self._target, np.array([0, 0, -_AWAY, 1, 0, 0, 0]))

    def release(self, pose: np.ndarray) -> None:
        """The target stands at f64[7] from now on."""
        self._put(self._held, np.array([0, 0, _AWAY, 1, 0, 0, 0]))
        self._put(self._target, pose)

    def _put(self, body: int, pose: np.ndarray) -> None:
        self.model.body_pos[body] = pose[:3]
        self.model.body_quat[body] = pose[3:]

    def is_free(self, joints: np.ndarray, opening: float, mode: Mode = Mode.TRAVEL) -> bool:
        """Whether the arm may be at joints f64[n], each finger `opening` metres from the middle."""
        return self.blocker(joints, opening, mode) is None

    def tilt(self, up: np.ndarray) -> float:
        """Radians from the vertical of a direction f64[3] of what is held, at the joints last looked at."""
        return float(np.arccos(np.clip(self.data.xmat[self._held].reshape(3, 3)[2] @ up, -1, 1)))

    def is_hand_free(self, T_world_tool: np.ndarray, opening: float, mode: Mode) -> bool:
        """Whether the hand alone, with what it holds, may be there, wherever the arm would have to be.

        It costs one look and no inverse kinematics. The arm waits at home, above all else.
        """
        model = self.model
        hand = self.arm.hand
        own = model.body_pos[hand].copy(), model.body_quat[hand].copy()
        T_world_hand = T_world_tool @ self._T_tool_hand
        T_wrist_hand = self._T_wrist_world @ T_world_hand
        self._put(
            hand, pose_of(T_wrist_hand if self._turned is None else T_wrist_hand @ self._turned)
        )
        try:
            return self.is_free(self._home, opening, mode)
        finally:
            model.body_pos[hand], model.body_quat[hand] = own

    def blocker(
        self, joints: np.ndarray, opening: float, mode: Mode = Mode.TRAVEL
    ) -> tuple[str, str] | None:
        """The names of two bodies that come too close, None where none do."""
        self.num_checks += 1
        data = self.data
        data.qpos[self.arm.qpos] = joints
        data.qpos[self.arm.fingers] = self.gripper.joints_of(opening)
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_collision(self.model, data)
        if not data.ncon:
            return None
        geoms = data.contact.geom
        kinds = self._kind[geoms]
        pairs = kinds[:, 0], kinds[:, 1]
        too_close = data.contact.dist < _LIMIT[mode][pairs] + self.room * _IS_ROOMY[pairs]
        if not too_close.any():
            return None
        a, b = (
            self.model.body(self.model.geom_bodyid[geom]).name for geom in geoms[too_close.argmax()]
        )
        return a, b


def add_stand(spec: mujoco.MjSpec, box: Box, name: str) -> None:
    """A box that objects can stand on."""
    _add_box(spec.worldbody, box).name = name


def _add_box(body: mujoco.MjsBody, box: Box) -> mujoco.MjsGeom:
    return body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=box.center,
        quat=yaw_quaternion(box.yaw),
        size=box.half_extents,
        rgba=box.rgba,
        group=VISUAL_GROUP,
    )


def _name_of(kind: Kind) -> str:
    """Of the body of columns."""
    return f"columns/{kind.name.lower()}"
