"""A robot in a compiled model: where its parts are, and how its gripper moves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Self

import mujoco
import numpy as np

SPARE = 0.01
"""Metres by which each finger is opened wider than the object, where the hand opens so far."""
_GAP = 0.003
"""Metres that a pad which hardly moves keeps from an object as the hand comes to it."""
_GRIP_RATE = 8.0
"""By how many times its range the gripper's set-point moves in a second at most: 0.32 m/s of the Panda's."""


class PartNames(NamedTuple):
    """What the parts of a robot are called in a model.

    Attributes:
      joints, actuators: of the arm. hand: the body of the gripper. grip: its actuator. tool: the site between
        its pads.
    """

    joints: tuple[str, ...]
    actuators: tuple[str, ...]
    hand: str
    grip: str
    tool: str


@dataclass(frozen=True, eq=False)
class RobotParts:
    """Where a robot of n joints is found in a compiled model.

    Attributes:
      qpos: i[n], of the arm's joints in `qpos`; fingers: i[k], of the hand's joints that are not the arm's,
        in the order of the gripper's model.
      dofs: i[n], of the arm's joints in `qvel`; finger_dofs: i[k].
      ctrl: i[n], of the arm's actuators; grip: of the gripper's.
      lag: f64[n], seconds by which each servo's damping lets its joint trail behind a moving set-point.
      low, high: f64[n], the joints' limits, radians.
      site: of the tool. hand: its body; is_hand, is_arm: bool[nbody], the bodies that move with it, and those
        of the whole robot.
    """

    qpos: np.ndarray
    fingers: np.ndarray
    dofs: np.ndarray
    finger_dofs: np.ndarray
    ctrl: np.ndarray
    grip: int
    lag: np.ndarray
    low: np.ndarray
    high: np.ndarray
    site: int
    hand: int
    is_hand: np.ndarray
    is_arm: np.ndarray

    @classmethod
    def find(cls, model: mujoco.MjModel, names: PartNames) -> Self:
        """The parts of these names."""
        arm = [model.joint(name).id for name in names.joints]
        ctrl = np.array([model.actuator(name).id for name in names.actuators])
        hand = model.body(names.hand).id
        is_hand = bodies_of_tree(model, hand)
        fingers = [
            joint
            for joint in range(model.njnt)
            if is_hand[model.jnt_bodyid[joint]] and joint not in arm
        ]
        return cls(
            qpos=model.jnt_qposadr[arm],
            fingers=model.jnt_qposadr[fingers],
            dofs=model.jnt_dofadr[arm],
            finger_dofs=model.jnt_dofadr[fingers],
            ctrl=ctrl,
            grip=model.actuator(names.grip).id,
            lag=model.actuator_biasprm[ctrl, 2] / model.actuator_biasprm[ctrl, 1],
            low=model.jnt_range[arm, 0],
            high=model.jnt_range[arm, 1],
            site=model.site(names.tool).id,
            hand=hand,
            is_hand=is_hand,
            is_arm=bodies_of_tree(model, int(model.body_rootid[hand])),
        )

    def tool(self, data: mujoco.MjData) -> np.ndarray:
        """f64[4, 4]: T_world_tool, after the kinematics."""
        pose = np.eye(4)
        pose[:3, :3] = data.site_xmat[self.site].reshape(3, 3)
        pose[:3, 3] = data.site_xpos[self.site]
        return pose


def bodies_of_tree(model: mujoco.MjModel, root: int) -> np.ndarray:
    """bool[nbody]: the body and all that hang on it."""
    is_below = np.zeros(model.nbody, bool)
    for body in range(1, model.nbody):
        is_below[body] = body == root or is_below[model.body_parentid[body]]
    return is_below


@dataclass(frozen=True, eq=False)
class Gripper:
    """A gripper's table, T rows from closed to open, of k joints.

    Attributes:
      opening: f64[T], metres that each pad is from the middle. control: f64[T]. joints: f64[T, k].
      depth: f64[T], metres that the pads are before the tool's origin.
      side: f64[T], metres that the middle between the pads is from the tool's axis, along the tool's y.
      driven: which of the joints tell how far it is open. closed: the control that closes it.
      T_hand_tool: f64[4, 4].
    """

    opening: np.ndarray
    control: np.ndarray
    joints: np.ndarray
    depth: np.ndarray
    side: np.ndarray
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
        return np.interp(np.asarray(width) / 2, self.opening, self.side)

    def shift_of(self, width: np.ndarray | float) -> np.ndarray:
        """f64[...]: metres along the tool's y from its axis to the middle of what the hand comes to.

        It is where the pads will meet it, but that a pad which hardly moves must not scrape along it.
        """
        width = np.asarray(width)
        meet = self.side_of(width)
        if self.is_even:
            return meet
        opening = self.opening_of(width)
        spare = opening - width / 2
        middle = self.side_of(2 * opening)
        room = np.maximum(spare - _GAP, 0.0)
        return np.clip(meet, middle - room, middle + room)

    @property
    def is_even(self) -> bool:
        """Both pads move alike: half a turn about the approach makes no difference."""
        return not self.side.any()

    def measure(self, joints: np.ndarray) -> float:
        """Metres that each pad is from the middle at joints f64[k]."""
        drive = self.joints[:, self.driven].mean(1)
        order = np.argsort(drive)
        return float(np.interp(joints[self.driven].mean(), drive[order], self.opening[order]))

    def is_closing(self, control: float) -> bool:
        """Whether a control closes the gripper on whatever is between its pads."""
        return bool((control - self.control[0]) * (self.closed - self.control[0]) > 0)


class GripShare:
    """The gripper's set-point as a number: 1 is open, 0 is where the fingers meet, -1 presses hardest.

    Args:
      gripper: its table. opened: the control that opens it.

    Attributes:
      speed: how fast the set-point moves at most, in units of the actuator, per second.
    """

    def __init__(self, gripper: Gripper, opened: float) -> None:
        self._meet = float(gripper.control[0])
        self._open = opened - self._meet
        self._closed = gripper.closed - self._meet
        self.speed = _GRIP_RATE * abs(self._open)

    def control_of(self, share: float) -> float:
        """The set-point."""
        return self._meet + share * (self._open if share >= 0 else -self._closed)

    def share_of(self, control: float) -> float:
        """What `control_of` makes a set-point of; 0 to -1 where the gripper cannot press."""
        beyond = control - self._meet
        side = self._open if beyond * self._open >= 0 else -self._closed
        return beyond / side if side else 0.0
