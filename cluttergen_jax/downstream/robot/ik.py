"""Inverse kinematics of the arm: joints for a pose of the tool, and along a straight line."""

from __future__ import annotations

import importlib
from typing import Any

import mujoco
import numpy as np

from cluttergen_jax.config import ContactConfig
from cluttergen_jax.downstream.robot.frames import inverse, matrix_of, pose_of
from cluttergen_jax.downstream.robot.model import ARM, EXTRA, TOOL, Panda, home_pose, panda_spec
from cluttergen_jax.errors import MissingExtraError

TOLERANCE, TURN_TOLERANCE = 5e-4, np.radians(0.2)
"""Metres and radians that a solution may be off."""
MAX_JUMP = 0.1
"""Radians that a joint may move between two points of a line."""
LINE_STEP = 0.002
"""Metres between two points of a line."""
_ITERATIONS = 25
_GAIN = 1.0
_NEAR_LIMIT = np.radians(1)


def need(module: str, purpose: str) -> Any:
    """A module of the extra `robot`.

    Raises:
      MissingExtraError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError(EXTRA, purpose) from error


class ArmKinematics:
    """The arm alone, its base where it stands.

    Args:
      base: f64[7], T_world_base.
    """

    def __init__(self, base: np.ndarray) -> None:
        mink = need("mink", "inverse kinematics")
        spec = panda_spec(ContactConfig())
        for geom in list(spec.geoms):
            spec.delete(geom)
        for mesh in list(spec.meshes):
            spec.delete(mesh)
        model = spec.compile()
        arm = Panda.of(model, prefix="")
        self._solve_ik: Any = mink.solve_ik
        self._SE3: Any = mink.SE3
        self._state = mink.Configuration(model)
        self._task = mink.FrameTask(TOOL, "site", position_cost=1.0, orientation_cost=0.5, lm_damping=1e-6)
        self._fixed = [mink.DofFreezingTask(model, dof_indices=[7, 8])]
        self._limits = [mink.ConfigurationLimit(model)]
        self._arm, self._data = arm, mujoco.MjData(model)
        self._model = model
        self.low, self.high = arm.low + _NEAR_LIMIT, arm.high - _NEAR_LIMIT
        self.home = home_pose()
        self.T_world_base = matrix_of(base)
        self._T_base_world = inverse(self.T_world_base)

    def tool(self, joints: np.ndarray) -> np.ndarray:
        """f64[4, 4]: T_world_tool of joints f64[7]."""
        self._data.qpos[: len(ARM)] = joints
        mujoco.mj_kinematics(self._model, self._data)
        return self.T_world_base @ self._arm.tool(self._data)

    def solve(self, T_world_tool: np.ndarray, start: np.ndarray) -> np.ndarray | None:
        """Joints f64[7] that bring the tool there, near to `start`; None where none were found."""
        target = pose_of(self._T_base_world @ T_world_tool)
        self._task.set_target(self._SE3(wxyz_xyz=np.concatenate([target[3:], target[:3]])))
        fingers = np.zeros(2)
        self._state.update(np.concatenate([np.clip(start, self.low, self.high), fingers]))
        for _ in range(_ITERATIONS):
            error = self._task.compute_error(self._state)
            if np.linalg.norm(error[:3]) < TOLERANCE and np.linalg.norm(error[3:]) < TURN_TOLERANCE:
                joints = self._state.q[: len(ARM)].copy()
                return joints if ((joints >= self.low) & (joints <= self.high)).all() else None
            speed = self._solve_ik(
                self._state,
                [self._task],
                1.0,
                "daqp",
                damping=1e-8,
                limits=self._limits,
                constraints=self._fixed,
            )
            self._state.integrate_inplace(speed, _GAIN)
        return None

    def solutions(self, T_world_tool: np.ndarray, number: int, rng: np.random.Generator) -> list[np.ndarray]:
        """Up to so many different solutions, the first sought from the home pose, turned to the target."""
        towards = (self._T_base_world @ T_world_tool)[:2, 3]
        found: list[np.ndarray] = []
        for attempt in range(2 * number):
            start = self.home.copy()
            start[0] = np.arctan2(towards[1], towards[0])
            if attempt:
                start += rng.normal(0, 0.6, 7)
            joints = self.solve(T_world_tool, start)
            if joints is not None and all(np.abs(joints - each).max() > 0.2 for each in found):
                found.append(joints)
            if len(found) == number:
                break
        return found

    def line(self, start: np.ndarray, along: np.ndarray) -> np.ndarray | None:
        """Joints f64[L, 7] along a straight line of the tool, from `start`, both ends included.

        Args:
          along: f64[3], metres in world axes; the tool does not turn.

        Returns:
          None where a point cannot be reached, or only by a jump.
        """
        number = max(int(np.ceil(np.linalg.norm(along) / LINE_STEP)), 1)
        pose, path = self.tool(start), [np.asarray(start, np.float64)]
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
