"""The arm of a world: the one file here that knows which robot it is."""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.config import ContactConfig, no_such
from cluttergen_jax.downstream.robot.cameras import SIZE, wrist_camera
from cluttergen_jax.downstream.robot.description import find_robot
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.robot.model import Robot as Arm
from cluttergen_jax.downstream.robot.model import arm_spec as whole_arm
from cluttergen_jax.downstream.robot.model import base_pose
from cluttergen_jax.downstream.robot.motion.ik import ArmKinematics
from cluttergen_jax.scene.cameras import Camera

ROBOTS = ("panda",)
HAND_CAMERA = "hand"
"""The camera on the hand; others bear the names of `scene.cameras`."""
_LEARNING_MODEL = "mjx_panda.xml"
PREFIX = "panda/"
NUM_JOINTS = 7


def check_robot(robot: str) -> None:
    """Refuses a robot that there is none of (ConfigError), and an extra that is missing."""
    if robot not in ROBOTS:
        raise no_such("robot", str(robot), ROBOTS)
    find_robot(robot)


def arm_spec(contact: ContactConfig, is_simple: bool) -> mujoco.MjSpec:
    """The arm with its base at the origin, and a camera on its hand; is_simple: few, simple colliders."""
    robot = find_robot()
    spec = whole_arm(contact, robot)
    for light in list(spec.lights):
        spec.delete(light)
    if is_simple:
        _simplify(spec)
    camera = Camera.of(HAND_CAMERA, wrist_camera(gripper_of(robot).T_hand_tool))
    spec.body(robot.gripper.body).add_camera(
        name=HAND_CAMERA, pos=camera.position, quat=camera.quaternion, fovy=camera.fovy, resolution=SIZE
    )
    return spec


def _simplify(spec: mujoco.MjSpec) -> None:
    """Replaces colliders by those of Menagerie's model for MJX: a capsule for the hand, a pad a finger."""
    for geom in list(spec.geoms):
        if geom.contype or geom.conaffinity:
            spec.delete(geom)
    simple = mujoco.MjSpec.from_file(str(find_robot().arm.path.with_name(_LEARNING_MODEL)))
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
    used = {geom.meshname for geom in spec.geoms}
    for mesh in list(spec.meshes):
        if mesh.name not in used:
            spec.delete(mesh)


def base_of(support: SupportAsset, pose: np.ndarray | None) -> np.ndarray:
    """f64[7]: T_world_base; before the support if it is not given."""
    return base_pose(support) if pose is None else np.asarray(pose, np.float64)


def find_arm(model: mujoco.MjModel) -> Arm:
    """Where the arm is in a model in which `PREFIX` is before its names."""
    return Arm.of(model)


def set_home(arm: Arm, qpos: np.ndarray, ctrl: np.ndarray) -> None:
    """Writes the home pose, the hand open, into f64[nq] and f64[nu]."""
    gripper = gripper_of()
    qpos[arm.qpos] = ctrl[arm.ctrl] = find_robot().arm.home
    qpos[arm.fingers] = gripper.joints_of(np.array(gripper.max_opening))
    ctrl[arm.grip] = gripper.control_of(np.array(gripper.max_opening))


def max_speed() -> np.ndarray:
    """f64[7]: rad/s, of the joints."""
    return np.array(find_robot().arm.speed)


def control_of(share: float) -> float:
    """The gripper's set-point: 1 is open, 0 is where the fingers meet, -1 presses as hard as it can."""
    given = find_robot().gripper
    return share * (given.open if share >= 0 else -given.closed)


def share_of(control: float) -> float:
    """What `control_of` makes a set-point of."""
    given = find_robot().gripper
    return control / (given.open if control >= 0 else -given.closed)


def kinematics_of(base: np.ndarray) -> ArmKinematics:
    """Inverse kinematics of the arm whose base stands at f64[7]."""
    return ArmKinematics(base)


def move_tool(T_world_tool: np.ndarray, shift: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """f64[4, 4]: a pose moved by f[3] metres and turned by the rotation vector f[3], in world axes."""
    pose = T_world_tool.copy()
    pose[:3, 3] += shift
    pose[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ pose[:3, :3]
    return pose
