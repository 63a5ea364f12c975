"""What an environment asks of the world that its episodes run in: of `RobotWorld` and `ExportedWorld`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import mujoco
import numpy as np

from cluttergen_jax.downstream.episodes.robot_parts import Gripper, PartNames, RobotParts


class BankRows(Protocol):
    """S scenes of up to N objects.

    Attributes:
      index: i[S], their numbers in the bank. object_index: i[S, N], numbers of objects, -1 for none.
      poses: f32[S, N, 7], T_world_object.
    """

    @property
    def index(self) -> Any: ...
    @property
    def object_index(self) -> Any: ...
    @property
    def poses(self) -> Any: ...


class SimulatedWorld(Protocol):
    """A robot and all objects of a bank in one model.

    Attributes:
      model: compiled. bank: its scenes. robot: where that is in the model; parts: what its parts are called.
      gripper: how that moves; opened: the control that opens it.
      prefix: before the robot's names. speed: rad/s, of the arm's joints. home: f[n], radians.
      stand: `center`, `half_extents` and `yaw` of the box beside the support that objects are placed from.
    """

    @property
    def model(self) -> mujoco.MjModel: ...
    @property
    def bank(self) -> BankRows: ...
    @property
    def robot(self) -> RobotParts: ...
    @property
    def parts(self) -> PartNames: ...
    @property
    def gripper(self) -> Gripper: ...
    @property
    def opened(self) -> float: ...
    @property
    def prefix(self) -> str: ...
    @property
    def speed(self) -> Sequence[float]: ...
    @property
    def home(self) -> Sequence[float]: ...
    @property
    def stand(self) -> Any: ...

    def reset(self, seed: int, index: int | None = None) -> Any:
        """The beginning of an episode in the scene of this number; seed: of what is randomized."""

    def put(self, data: mujoco.MjData, state: Any) -> None:
        """Puts `data` at rest at the beginning of an episode."""

    def scene(self, state: Any) -> Any:
        """The scene of a state, a dataclass.

        It has `names`, `objects` (with `label`, `half_extents`, `resting`), `poses` f64[N, 7], `support`
        (with `region`, `top`, `lowest`) and `to_mjspec()`.
        """

    def symmetries(self, scene: Any) -> Sequence[int]:
        """Of each object of a scene, after how many equal turns about its z it looks the same."""

    def kinematics(self) -> Any:
        """`tool(joints)` and `solve(T_world_tool, joints)` of the arm (ConfigError: there are none here)."""

    def new_context(self, width: int, height: int) -> Any:
        """A GL context, made current."""


def joints_of_objects(model: mujoco.MjModel, names: Sequence[str]) -> np.ndarray:
    """i[K, 7], where the pose of each object is in `qpos`."""
    first = [int(model.joint(name).qposadr[0]) for name in names]
    return np.array(first, int)[:, None] + np.arange(7)


def numbers_of(given: object) -> np.ndarray:
    """f64 of what was given, of no shape that is wanted if it is none."""
    try:
        return np.asarray(given, np.float64)
    except (TypeError, ValueError):
        return np.full((0, 0), np.nan)
