"""Inverse kinematics of the arm: joints for a pose of the tool, and along a straight line."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Any, NamedTuple

import mujoco
import numpy as np
from scipy.spatial import KDTree

from cluttergen_jax.config import ContactConfig
from cluttergen_jax.downstream.robot.description import (
    EXTRA,
    RobotDescription,
    compile_model,
)
from cluttergen_jax.downstream.robot.model import TOOL, Robot, arm_spec
from cluttergen_jax.downstream.transforms import inverse, matrix_of, pose_of, turn_matrix
from cluttergen_jax.errors import MissingExtraError

# Metres and radians that a solution may be off.
TOLERANCE = 5e-4
TURN_TOLERANCE = np.radians(0.2)

MAX_JUMP = 0.1
"""Radians that a joint may move between two points of a line."""
LINE_STEP = 0.002
"""Metres between two points of a line."""
_ITERATIONS = 25
_GAIN = 1.0
_NEAR_LIMIT = np.radians(1)
_UPRIGHT = 1 - 1e-6
_NUM_STARTS = 10_000
_NEAREST = 24
"""Solutions are sought from those of so many joints, drawn at random, whose tools are nearest to a pose."""
_TURN_METRES = 0.15
"""Metres that count as much as a radian in this."""
_FULL = 6
"""Joints with which an arm brings its tool into any pose within its reach."""
_PIVOT = "pivot"
_PIVOT_COST = (0.5, 0.5, 0.005)
"""Of turns about the axes of a frame about whose z an arm of fewer joints may turn."""
_NEAR_COST = (0.02, 0.004, 0.02)
"""The same of the tool where an arm of fewer joints comes near: the pads hold as well however the hand has
turned about the line between them, its y."""
MOST_ASKEW = np.radians(6)
"""Radians that this line may be off then."""
_AT_REST = 1e-4
_TURNS = tuple(np.radians([0, 45, -45, 90, -90, 135, -135, 180]))
"""About a pivot, from each of which one solution is sought."""


def import_extra(module: str, purpose: str) -> Any:
    """A module of the extra `robot`. Raises MissingExtraError: it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError(EXTRA, purpose) from error


class ArmKinematics:
    """An arm of n joints alone, its base where it stands.

    Args:
      base: f64[7], T_world_base. robot: whose arm it is.

    Attributes:
      is_short: the arm has fewer than six joints, so that it brings its tool into some poses only.
    """

    def __init__(self, base: np.ndarray, robot: RobotDescription) -> None:
        mink = import_extra("mink", "inverse kinematics")
        self._robot = robot
        model, arm = _arm(self._robot)
        self._solve_ik: Any = mink.solve_ik
        self._SE3: Any = mink.SE3
        self._state = mink.Configuration(model)
        self._task = mink.FrameTask(
            self._robot.of_gripper(TOOL),
            "site",
            position_cost=1.0,
            orientation_cost=0.5,
            lm_damping=1e-6,
        )
        self.is_short = len(arm.qpos) < _FULL
        self._turning = mink.FrameTask(
            self._robot.of_gripper(_PIVOT),
            "site",
            position_cost=1.0,
            orientation_cost=_PIVOT_COST,
            lm_damping=1e-6,
        )
        self._nearing = mink.FrameTask(
            self._robot.of_gripper(TOOL),
            "site",
            position_cost=1.0,
            orientation_cost=_NEAR_COST,
            lm_damping=1e-6,
        )
        self._pivot = model.site(self._robot.of_gripper(_PIVOT)).id
        self._hand_to_tool = matrix_of(np.array(self._robot.gripper.tool))
        still = np.setdiff1d(np.arange(model.nv), arm.dofs)
        self._fixed = [mink.DofFreezingTask(model, dof_indices=still.tolist())]
        self._limits = [mink.ConfigurationLimit(model)]
        self._arm = arm
        self._data = mujoco.MjData(model)
        self._model = model
        self.low, self.high = _limits(arm)
        self.home = np.array(self._robot.arm.home)
        self.T_world_base = matrix_of(base)
        self._T_base_world = inverse(self.T_world_base)
        self.tool(self.home)
        self._axis = first_axis(self._robot)
        x, y, _ = arm.tool(self._data)[:3, 3] - self._axis.anchor
        self._ahead = self.home[0] - self._axis.sign * np.arctan2(y, x)

    def tool(self, joints: np.ndarray) -> np.ndarray:
        """f64[4, 4]: T_world_tool of joints f64[n]."""
        self._data.qpos[self._arm.qpos] = joints
        mujoco.mj_kinematics(self._model, self._data)
        return self.T_world_base @ self._arm.tool(self._data)

    def solve(
        self, T_world_tool: np.ndarray, start: np.ndarray, T_tool_pivot: np.ndarray | None = None
    ) -> np.ndarray | None:
        """Joints f64[n] that bring the tool there, near to `start`; None where none were found.

        An arm of fewer than six joints that cannot bring the tool there brings it to the place and turns it
        as it can, mostly about the line between the pads (`tool` tells how it is turned then).

        Args:
          T_tool_pivot: f64[4, 4]; such an arm may turn it about the z axis of this frame, and only so.
        """
        joints = self._descend(self._task, T_world_tool, start, 3)
        if joints is None and self.is_short:
            joints = self._reduced(T_world_tool, start, T_tool_pivot)
        return joints

    def _reduced(
        self, T_world_tool: np.ndarray, start: np.ndarray, T_tool_pivot: np.ndarray | None
    ) -> np.ndarray | None:
        """Joints f64[n] of an arm that cannot bring the tool there: see `solve`."""
        if T_tool_pivot is None:
            return self._come_near(T_world_tool, start)
        pivot = pose_of(self._hand_to_tool @ T_tool_pivot)
        self._model.site_pos[self._pivot] = pivot[:3]
        self._model.site_quat[self._pivot] = pivot[3:]
        return self._descend(self._turning, T_world_tool @ T_tool_pivot, start, 2)

    def _descend(
        self, task: Any, T_world_frame: np.ndarray, start: np.ndarray, num_turns: int
    ) -> np.ndarray | None:
        """Joints f64[n] that do a task near to `start`; num_turns: so many of its turns must be right."""
        target = pose_of(self._T_base_world @ T_world_frame)
        task.set_target(self._SE3(wxyz_xyz=np.concatenate([target[3:], target[:3]])))
        state = np.zeros(self._model.nq)
        state[self._arm.qpos] = np.clip(start, self.low, self.high)
        self._state.update(state)
        for _ in range(_ITERATIONS):
            error = task.compute_error(self._state)
            off = error[3 : 3 + num_turns]
            if np.linalg.norm(error[:3]) < TOLERANCE and np.linalg.norm(off) < TURN_TOLERANCE:
                joints = self._state.q[self._arm.qpos]
                return joints if self._allows(joints) else None
            self._step(task)
        return None

    def _come_near(self, T_world_tool: np.ndarray, start: np.ndarray) -> np.ndarray | None:
        """Joints f64[n] that bring the tool to its place, turned as little as they can."""
        target = pose_of(self._T_base_world @ T_world_tool)
        self._nearing.set_target(self._SE3(wxyz_xyz=np.concatenate([target[3:], target[:3]])))
        state = np.zeros(self._model.nq)
        state[self._arm.qpos] = np.clip(start, self.low, self.high)
        self._state.update(state)
        for _ in range(2 * _ITERATIONS):
            before = self._state.q[self._arm.qpos]
            self._step(self._nearing)
            if np.abs(self._state.q[self._arm.qpos] - before).max() < _AT_REST:
                break
        error = self._nearing.compute_error(self._state)
        joints = self._state.q[self._arm.qpos]
        is_there = np.linalg.norm(error[:3]) < TOLERANCE and np.hypot(*error[3::2]) < MOST_ASKEW
        return joints if is_there and self._allows(joints) else None

    def _step(self, task: Any) -> None:
        """One step towards what a task wants."""
        speed = self._solve_ik(
            self._state,
            [task],
            1.0,
            "daqp",
            damping=1e-8,
            limits=self._limits,
            constraints=self._fixed,
        )
        self._state.integrate_inplace(speed, _GAIN)

    def _allows(self, joints: np.ndarray) -> bool:
        return bool(((joints >= self.low) & (joints <= self.high)).all())

    def solutions(
        self, T_world_tool: np.ndarray, number: int, T_tool_pivot: np.ndarray | None = None
    ) -> Iterator[np.ndarray]:
        """Up to so many different solutions, f64[n] each, unlike one another where the arm allows it.

        Args:
          T_tool_pivot: see `solve`.
        """
        found = False
        for joints in self._search(
            T_world_tool, number, lambda start: self._descend(self._task, T_world_tool, start, 3)
        ):
            found = True
            yield joints
        if self.is_short and not found:
            turned = [T_world_tool]
            if T_tool_pivot is not None:
                T_world_pivot = T_world_tool @ T_tool_pivot
                back = inverse(T_tool_pivot)
                turned = [T_world_pivot @ turn_matrix(angle) @ back for angle in _TURNS]
                number = 1
            for pose in turned:
                yield from self._search(
                    pose, number, partial(self._reduced, pose, T_tool_pivot=T_tool_pivot)
                )

    def _search(
        self,
        T_world_tool: np.ndarray,
        number: int,
        solve: Callable[[np.ndarray], np.ndarray | None],
    ) -> Iterator[np.ndarray]:
        """Those that a solver finds from starts f64[n] near to a pose."""
        starts = self._starts(self._T_base_world @ T_world_tool)
        found: list[np.ndarray] = []
        for _ in range(min(2 * number, len(starts))):
            # Begun near one that is known, a search ends there.
            unlike = [
                min((float(np.linalg.norm(start - each)) for each in found), default=0.0)
                for start in starts
            ]
            joints = solve(starts.pop(int(np.argmax(unlike))))
            if joints is None or any(np.abs(joints - each).max() <= 0.2 for each in found):
                continue
            found.append(joints)
            yield joints
            if len(found) == number:
                return

    def _starts(self, T_base_tool: np.ndarray) -> list[np.ndarray]:
        """Joints f64[n] whose tool is near there, those nearest to the home pose turned there first."""
        starts, turns, tree = _start_table(self._robot)
        features, turn = _from_axis(T_base_tool[None], self._axis)
        near = tree.query(features[0], _NEAREST)[1]
        joints = starts[near].copy()
        sign = self._axis.sign
        if not sign:
            return list(joints[np.argsort(np.linalg.norm(joints - self.home, axis=1))])
        joints[:, 0] = (sign * (turn[0] - turns[near]) + np.pi) % (2 * np.pi) - np.pi
        joints = joints[(joints[:, 0] >= self.low[0]) & (joints[:, 0] <= self.high[0])]
        home = np.array([sign * turn[0] + self._ahead, *self.home[1:]])
        return list(joints[np.argsort(np.linalg.norm(joints - home, axis=1))])

    def line(self, start: np.ndarray, along: np.ndarray) -> np.ndarray | None:
        """Joints f64[L, n] along a straight line of the tool, from `start`, both ends included.

        Args:
          along: f64[3], metres in world axes; the tool does not turn, or as little as an arm of fewer than
            six joints can (`solve`).

        Returns:
          None where a point cannot be reached, or only by a jump.
        """
        number = max(int(np.ceil(np.linalg.norm(along) / LINE_STEP)), 1)
        pose = self.tool(start)
        path = [np.asarray(start, np.float64)]
        for step in range(1, number + 1):
            target = pose.copy()
            target[:3, 3] += along * step / number
            joints = self.solve(target, path[-1])
            if joints is None or np.abs(joints - path[-1]).max() > MAX_JUMP:
                return None
            path.append(joints)
        return np.stack(path)

    def split(
        self, path: np.ndarray, distance: float, from_end: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """A straight path in two, of which the first is `distance` metres long, or the last."""
        places = np.array([self.tool(joints)[:3, 3] for joints in path])
        end = places[-1] if from_end else places[0]
        far = np.linalg.norm(places - end, axis=1) > distance
        cut = int(np.flatnonzero(far)[-1 if from_end else 0]) if far.any() else len(path) // 2
        cut = min(max(cut, 1), len(path) - 2)
        return path[: cut + 1], path[cut:]


@cache
def _arm(robot: RobotDescription) -> tuple[mujoco.MjModel, Robot]:
    """The arm without its shapes."""
    spec = arm_spec(ContactConfig(), robot)
    for geom in list(spec.geoms):
        spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    for body in spec.bodies[1:]:
        # Masses may have been those of the shapes; kinematics have no use for them.
        if not body.explicitinertial:
            body.explicitinertial = True
            body.mass = 1.0
            body.inertia = (1.0, 1.0, 1.0)
    # MuJoCo would take it for the body's frame wherever it is put, if it began there.
    hand = spec.body(robot.of_gripper(robot.gripper.body))
    hand.add_site(name=robot.of_gripper(_PIVOT), pos=(0.01, 0.02, 0.03), quat=(0.8, 0.6, 0.0, 0.0))
    model = compile_model(spec, robot.name)
    return model, Robot.of(model, robot, prefix="")


class Axis(NamedTuple):
    """The first joint's axis.

    Attributes:
      sign: 1 where it points up, -1 down, 0 where it is not upright, or is that of a slide.
      anchor: f64[3], where it is in the base's frame; its height does not count.
    """

    sign: float
    anchor: np.ndarray


@cache
def first_axis(robot: RobotDescription) -> Axis:
    """The axis about which the arm turns as a whole."""
    model, _ = _arm(robot)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    first = model.joint(robot.arm.joints[0]).id
    up = data.xaxis[first, 2]
    turns = model.jnt_type[first] == mujoco.mjtJoint.mjJNT_HINGE
    anchor = np.array([*data.xanchor[first, :2], 0.0])
    if np.hypot(*anchor[:2]) <= TOLERANCE:
        anchor[:] = 0.0
    return Axis(float(np.sign(up)) if turns and abs(up) >= _UPRIGHT else 0.0, anchor)


def _limits(arm: Robot) -> tuple[np.ndarray, np.ndarray]:
    return arm.low + _NEAR_LIMIT, arm.high - _NEAR_LIMIT


@cache
def _samples(robot: RobotDescription) -> tuple[np.ndarray, np.ndarray]:
    """Joints at random, f64[S, n], their first 0 if it is upright, and T_base_tool, f64[S, 4, 4], at each."""
    model, arm = _arm(robot)
    data = mujoco.MjData(model)
    starts = np.random.default_rng(0).uniform(*_limits(arm), (_NUM_STARTS, len(arm.qpos)))
    if first_axis(robot).sign:
        starts[:, 0] = 0
    tools = np.empty((_NUM_STARTS, 4, 4))
    for index, joints in enumerate(starts):
        data.qpos[arm.qpos] = joints
        mujoco.mj_kinematics(model, data)
        tools[index] = arm.tool(data)
    return starts, tools


def sampled_tools(robot: RobotDescription) -> np.ndarray:
    """f64[S, 4, 4]: T_base_tool at joints drawn at random, the first of which is 0 if its axis is upright."""
    return _samples(robot)[1]


@cache
def _start_table(robot: RobotDescription) -> tuple[np.ndarray, np.ndarray, KDTree]:
    """Joints (`_samples`); the turns of their tools about the first axis; and the tools, to be searched."""
    starts, tools = _samples(robot)
    features, turns = _from_axis(tools, first_axis(robot))
    return starts, turns, KDTree(features)


def _from_axis(T_base_tool: np.ndarray, axis: Axis) -> tuple[np.ndarray, np.ndarray]:
    """Poses f64[n, 4, 4] as seen from the first joint's axis: f64[n, 8], and their turns about it, f64[n].

    Where that axis is not upright: f64[n, 9], as seen from the base, and no turns.
    """
    x, y, z = (T_base_tool[:, :3, 3] - axis.anchor).T
    if not axis.sign:
        turned = _TURN_METRES * T_base_tool[:, :3, 1:3].reshape(-1, 6)
        return np.column_stack([x, y, z, turned]), np.zeros(len(x))
    turns = np.arctan2(y, x)
    cos = np.cos(turns)
    sin = np.sin(turns)
    axes = T_base_tool[:, :3, 1:3]
    ahead = cos[:, None] * axes[:, 0] + sin[:, None] * axes[:, 1]
    aside = cos[:, None] * axes[:, 1] - sin[:, None] * axes[:, 0]
    turned = _TURN_METRES * np.concatenate([ahead, aside, axes[:, 2]], axis=1)
    return np.column_stack([np.hypot(x, y), z, turned]), turns
