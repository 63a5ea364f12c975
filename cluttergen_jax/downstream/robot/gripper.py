"""How a gripper moves: what its actuator is told for a width, and where its pads and joints then are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np

from cluttergen_jax.config import ContactConfig
from cluttergen_jax.downstream.robot.description import (
    GripperTable,
    RobotDescription,
    compile_model,
)
from cluttergen_jax.downstream.robot.model import hand_spec
from cluttergen_jax.downstream.transforms import matrix_of
from cluttergen_jax.errors import ConfigError

SPARE = 0.01
"""Metres by which each finger is opened wider than the object, where the hand opens so far."""
# Controls at which a gripper is looked at, and seconds that it has for each.
_ROWS = 64
_SETTLING = 0.25

_LEAST_STEP = 1e-4
"""Metres by which a row is narrower than the one before it."""
_FAR = 1.0


@dataclass(frozen=True, eq=False)
class Gripper:
    """A gripper's table, T rows from closed to open, of k joints.

    Attributes:
      opening: f64[T], metres that each pad is from the middle. control: f64[T]. joints: f64[T, k].
      depth: f64[T], metres that the pads are before the tool's origin.
      driven: which of the joints tell how far it is open. closed: the control that closes it.
      T_hand_tool: f64[4, 4].
    """

    opening: np.ndarray
    control: np.ndarray
    joints: np.ndarray
    depth: np.ndarray
    driven: np.ndarray
    closed: float
    T_hand_tool: np.ndarray

    @property
    def max_opening(self) -> float:
        """Metres that each pad can be from the middle."""
        return float(self.opening[-1])

    def opening_of(self, width: np.ndarray | float) -> np.ndarray:
        """Metres that each pad is from the middle before it closes on something of this width."""
        return np.minimum(self.max_opening, np.asarray(width) / 2 + SPARE)

    def control_of(self, opening: np.ndarray | float) -> np.ndarray:
        """f64[...]: the actuator's control for metres of each pad from the middle."""
        return np.interp(opening, self.opening, self.control)

    def opening_at(self, control: np.ndarray | float) -> np.ndarray:
        """f64[...]: metres of each pad from the middle that a control asks for; below 0 where it presses."""
        order = np.argsort(self.control)
        span = self.control[-1] - self.control[0]
        pressed = (np.asarray(control) - self.control[0]) * np.sign(-span)
        free = np.interp(control, self.control[order], self.opening[order])
        return np.where(pressed > 0, -pressed * self.max_opening / abs(span), free)

    def joints_of(self, opening: np.ndarray | float) -> np.ndarray:
        """f64[..., k]: the joints' positions at metres of each pad from the middle."""
        return np.stack([np.interp(opening, self.opening, each) for each in self.joints.T], axis=-1)

    def depth_of(self, width: np.ndarray | float) -> np.ndarray:
        """f64[...]: metres that the pads are before the tool's origin, so far apart."""
        return np.interp(np.asarray(width) / 2, self.opening, self.depth)

    def side_of(self, width: np.ndarray | float) -> np.ndarray:
        """f64[...]: metres along the tool's y from its axis to the middle between the pads, so far apart."""
        return np.zeros_like(np.asarray(width, np.float64))

    def shift_of(self, width: np.ndarray | float) -> np.ndarray:
        """f64[...]: metres along the tool's y from its axis to the middle of what the hand comes to."""
        return np.zeros_like(np.asarray(width, np.float64))

    def measure(self, joints: np.ndarray) -> float:
        """Metres that each pad is from the middle at joints f64[k]."""
        drive = self.joints[:, self.driven].mean(1)
        order = np.argsort(drive)
        return float(np.interp(joints[self.driven].mean(), drive[order], self.opening[order]))

    def is_closing(self, control: float) -> bool:
        """Whether a control closes the gripper on whatever is between its pads."""
        return bool((control - self.control[0]) * (self.closed - self.control[0]) > 0)


@cache
def gripper_of(robot: RobotDescription) -> Gripper:
    """The gripper of a robot.

    Raises:
      ConfigError: it does not open and close as its description says.
    """
    given = robot.gripper
    model = compile_model(hand_spec(ContactConfig(), robot), robot.name)
    driven = np.array([model.joint(name).id for name in given.joints])
    table = given.table or _close(model, robot)
    joints = np.array(table.joints)
    if joints.shape[1] != model.nq:
        raise ConfigError(
            f"robot {robot.name}: gripper.table.joints of {joints.shape[1]}",
            f"{model.nq}, as its model has",
        )
    columns = (np.array(each) for each in (table.width, table.control, table.depth))
    width, control, depth = columns
    return Gripper(
        width / 2, control, joints, depth, driven, given.closed, matrix_of(np.array(given.tool))
    )


def _close(model: mujoco.MjModel, robot: RobotDescription) -> GripperTable:
    """Closes a gripper step by step, with nothing between its pads."""
    given = robot.gripper
    data = mujoco.MjData(model)
    model.opt.gravity = 0
    pads = [model.geom(name).id for name in given.pads]
    line = np.zeros(6)
    approach = matrix_of(np.array(given.tool))[:3, 2]
    rows: list[tuple[float, float, tuple[float, ...], float]] = []
    for control in np.linspace(given.open, given.closed, _ROWS):
        data.ctrl[0] = control
        for _ in range(round(_SETTLING / model.opt.timestep)):
            mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        width = mujoco.mj_geomDistance(model, data, *pads, _FAR, line)
        depth = float(data.geom_xpos[pads].mean(0) @ approach)
        if rows and width > rows[-1][0] - _LEAST_STEP:
            continue
        rows.append((max(float(width), 0.0), float(control), tuple(data.qpos.tolist()), depth))
        if width < _LEAST_STEP:
            break
    if len(rows) < 2 or rows[-1][0] > _LEAST_STEP:
        raise ConfigError(
            f"robot {robot.name}: its pads are {1e3 * rows[0][0]:.0f} mm apart at gripper.open, and "
            f"{1e3 * rows[-1][0]:.0f} mm at gripper.closed",
            "pads that meet",
            "exchanging `open` and `closed`, or other `pads`",
        )
    widths, controls, joints, depths = zip(*reversed(rows), strict=True)
    return GripperTable(
        (0.0, *widths[1:]), controls, joints, tuple(each - depths[-1] for each in depths)
    )
