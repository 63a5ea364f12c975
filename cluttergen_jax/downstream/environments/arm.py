"""The robot of a world: its model, exact or simple, and what set-points of its gripper mean."""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from cluttergen_jax.config import ContactConfig
from cluttergen_jax.downstream.robot.cameras import SIZE, wrist_camera
from cluttergen_jax.downstream.robot.description import RobotDescription
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.robot.model import Robot as Arm
from cluttergen_jax.downstream.robot.model import arm_spec as whole_arm
from cluttergen_jax.downstream.robot.model import remove_unused_meshes
from cluttergen_jax.scene import FixedCamera

HAND_CAMERA = "hand"
"""The camera on the hand; others bear the names of `scene.cameras`."""
_LEARNING_MODELS = {"panda": "mjx_panda.xml"}
"""Of Menagerie: the same robot with few, simple colliders, beside the file of the arm."""
_GRIP_RATE = 8.0
"""By how many times its range the gripper's set-point moves in a second at most: 0.32 m/s of the Panda's."""


def arm_spec(contact: ContactConfig, robot: RobotDescription, is_simple: bool) -> mujoco.MjSpec:
    """The robot with its base at the origin, and a camera on its hand; is_simple: few, simple colliders."""
    spec = whole_arm(contact, robot)
    for light in list(spec.lights):
        spec.delete(light)
    if is_simple:
        _simplify(spec, robot)
    camera = FixedCamera.of(HAND_CAMERA, wrist_camera(gripper_of(robot).T_hand_tool))
    spec.body(robot.of_gripper(robot.gripper.body)).add_camera(
        name=HAND_CAMERA,
        pos=camera.position,
        quat=camera.quaternion,
        fovy=camera.fovy,
        resolution=SIZE,
    )
    return spec


def _simplify(spec: mujoco.MjSpec, robot: RobotDescription) -> None:
    """Leaves the links without colliders; the hand has those of Menagerie's model for MJX if there is one."""
    simple = _LEARNING_MODELS.get(robot.name)
    root = spec.body(robot.of_gripper(robot.gripper.body))
    hand = {root.name, *(body.name for body in root.find_all("body"))}
    for geom in list(spec.geoms):
        if (geom.contype or geom.conaffinity) and (simple or geom.parent.name not in hand):
            spec.delete(geom)
    if simple:
        _add_colliders(spec, mujoco.MjSpec.from_file(str(robot.arm.path.with_name(simple))))
    remove_unused_meshes(spec)


def _add_colliders(spec: mujoco.MjSpec, simple: mujoco.MjSpec) -> None:
    """Those of another model of the same robot."""
    for geom in simple.geoms:
        if not (geom.contype or geom.conaffinity):
            continue
        spec.body(geom.parent.name).add_geom(
            name=geom.name,
            type=geom.type,
            size=geom.size,
            pos=geom.pos,
            quat=geom.quat,
            contype=geom.contype,
            conaffinity=geom.conaffinity,
            group=geom.group,
            mass=0,
            # Of their own: so small a pad holds too little with the friction of scenes.
            friction=geom.friction,
            condim=spec.default.geom.condim,
            solref=geom.solref,
            solimp=geom.solimp,
        )


def set_home(robot: RobotDescription, arm: Arm, qpos: np.ndarray, ctrl: np.ndarray) -> None:
    """Writes the home pose, the hand open, into f64[nq] and f64[nu]."""
    gripper = gripper_of(robot)
    qpos[arm.qpos] = ctrl[arm.ctrl] = robot.arm.home
    qpos[arm.fingers] = gripper.joints_of(np.array(gripper.max_opening))
    ctrl[arm.grip] = gripper.control_of(np.array(gripper.max_opening))


class GripShare:
    """The gripper's set-point as a number: 1 is open, 0 is where the fingers meet, -1 presses hardest.

    Args:
      robot: whose gripper it is.

    Attributes:
      speed: how fast the set-point moves at most, in units of the actuator, per second.
    """

    def __init__(self, robot: RobotDescription) -> None:
        given = robot.gripper
        self._meet = float(gripper_of(robot).control[0])
        self._open = given.open - self._meet
        self._closed = given.closed - self._meet
        self.speed = _GRIP_RATE * abs(self._open)

    def control_of(self, share: float) -> float:
        """The set-point."""
        return self._meet + share * (self._open if share >= 0 else -self._closed)

    def share_of(self, control: float) -> float:
        """What `control_of` makes a set-point of; 0 to -1 where the gripper cannot press."""
        beyond = control - self._meet
        side = self._open if beyond * self._open >= 0 else -self._closed
        return beyond / side if side else 0.0


def move_tool(T_world_tool: np.ndarray, shift: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """f64[4, 4]: a pose moved by f[3] metres and turned by the rotation vector f[3], in world axes."""
    pose = T_world_tool.copy()
    pose[:3, 3] += shift
    pose[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ pose[:3, :3]
    return pose
