"""How a gripper moves: what its actuator is told for a width, and where its pads and joints then are."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np

from cluttergen_jax.config import ContactConfig
from cluttergen_jax.downstream.episodes.robot_parts import Gripper
from cluttergen_jax.downstream.robot.description import (
    GripperTable,
    RobotDescription,
    compile_model,
)
from cluttergen_jax.downstream.robot.model import hand_spec
from cluttergen_jax.downstream.transforms import matrix_of, pose_of, rigid
from cluttergen_jax.errors import ConfigError

# Controls at which a gripper is looked at, and seconds that it has for each.
_ROWS = 64
_SETTLING = 0.25
_OPENING = 4.0
"""Seconds that it has to open."""
_MOVING = 0.01
_STILL = 1e-3
"""Radians or metres a second from which on it still opens, and up to which it has opened."""

_LEAST_STEP = 1e-4
"""Metres by which a row is narrower than the one before it."""
_ALIKE = 5e-4
"""Metres from the tool's axis up to which the middle between two pads counts as on it."""
_SEEN = 0.005
"""Metres between the pads from which on the direction between them is looked at."""
_MOST_ASKEW = np.radians(30)
_FAR = 1.0


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
    columns = (table.width, table.control, table.depth, table.side or np.zeros(len(joints)))
    width, control, depth, side = (np.array(each) for each in columns)
    tool = matrix_of(np.array(given.tool))
    return Gripper(width / 2, control, joints, depth, side, driven, given.closed, tool)


def _close(model: mujoco.MjModel, robot: RobotDescription) -> GripperTable:
    """Closes a gripper step by step, with nothing between its pads."""
    given = robot.gripper
    data = mujoco.MjData(model)
    model.opt.gravity = 0
    pads = [model.geom(name).id for name in given.pads]
    line = np.zeros(6)
    tool = matrix_of(np.array(given.tool))
    approach = tool[:3, 2]
    middle = between = tool[:3, 1]
    rows: list[tuple[float, float, tuple[float, ...], float, float]] = []
    for control in np.linspace(given.open, given.closed, _ROWS):
        data.ctrl[0] = control
        mujoco.mj_step(model, data, round(_SETTLING / model.opt.timestep))
        # A model need not begin open.
        is_opening = not rows and np.abs(data.qvel).max() > _MOVING
        while is_opening and np.abs(data.qvel).max() > _STILL and data.time < _OPENING:
            mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        width = mujoco.mj_geomDistance(model, data, *pads, _FAR, line)
        depth = float(data.geom_xpos[pads].mean(0) @ approach)
        if rows and width > rows[-1][0] - _LEAST_STEP:
            continue
        ends = line.reshape(2, 3)
        if width > _SEEN:
            middle = data.geom_xpos[pads].mean(0)
            between = (ends[1] - ends[0]) / width
        side = float((ends.mean(0) - tool[:3, 3]) @ tool[:3, 1])
        rows.append(
            (max(float(width), 0.0), float(control), tuple(data.qpos.tolist()), depth, side)
        )
        if width < _LEAST_STEP:
            break
    if len(rows) < 2 or rows[-1][0] > _LEAST_STEP:
        raise ConfigError(
            f"robot {robot.name}: its pads are {1e3 * rows[0][0]:.0f} mm apart at gripper.open, and "
            f"{1e3 * rows[-1][0]:.0f} mm at gripper.closed",
            "pads that meet",
            "exchanging `open` and `closed`, or other `pads`",
        )
    _check_direction(robot, middle, between)
    widths, controls, joints, depths, sides = zip(*reversed(rows), strict=True)
    is_even = max(map(abs, sides)) < _ALIKE
    # Of two fingers the description says where they are wide open; a jaw that swings is somewhere else then.
    origin = depths[-1] if is_even else float(tool[:3, 3] @ approach)
    return GripperTable(
        (0.0, *widths[1:]),
        controls,
        joints,
        tuple(each - origin for each in depths),
        () if is_even else sides,
    )


def _check_direction(robot: RobotDescription, middle: np.ndarray, between: np.ndarray) -> None:
    """Refuses a tool whose y is not the direction from pad to pad; f64[3] each, in the hand's frame."""
    tool = matrix_of(np.array(robot.gripper.tool))
    if abs(between @ tool[:3, 1]) >= np.cos(_MOST_ASKEW):
        return
    ahead = tool[:3, 2] if abs(between @ tool[:3, 2]) < np.cos(_MOST_ASKEW) else middle
    across = np.cross(between, ahead)
    across /= np.linalg.norm(across)
    turn = np.stack([across, between, np.cross(across, between)], axis=1)
    meant = pose_of(rigid(turn, middle)).round(4).tolist()
    raise ConfigError(
        f"robot {robot.name}: its pads close along {between.round(2).tolist()} of the hand's frame, and the "
        f"y of gripper.tool is {tool[:3, 1].round(2).tolist()}",
        f"the same, within {np.degrees(_MOST_ASKEW):.0f} degrees",
        f"other `pads`, or tool: {meant}, if the hand comes along z of that",
    )
