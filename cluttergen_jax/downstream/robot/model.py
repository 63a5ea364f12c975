"""A robot beside a table: the models of its arm and its gripper, set up so that it can hold things."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

import mujoco
import numpy as np

from cluttergen_jax.assets import VISUAL_GROUP, Box, SupportAsset
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.downstream.episodes.robot_parts import PartNames, RobotParts
from cluttergen_jax.downstream.robot.description import (
    GripperDescription,
    RobotDescription,
    arm_limits,
    find_robot,
    mujoco_spec,
)
from cluttergen_jax.geometry import rotate_in_plane, yaw_quaternion
from cluttergen_jax.scene import Scene

TOOL = "tool"
"""The site between the pads of the fingers: z is the direction of approach, y that in which they close."""
TIMESTEP = 1 / 960
"""Seconds. Scenes are made with 1/240; what is pressed between two fingers chatters at that."""
_LIBCCD = int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
"""The flag of models whose collisions libccd finds."""
_OPTIONS = ("timestep", "gravity", "cone", "impratio", "iterations", "noslip_iterations")
IMPRATIO = 10.0
"""As Menagerie has it for the Panda. At 1, which scenes are made with, soft friction creeps by millimetres a
second under what hangs beside the fingers."""
_WORLD = "world"
_OF_JOINTS = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
PAD_PRIORITY = 1_000_000
"""Above that of objects with a friction of their own."""
_HIDDEN_GROUP = 3
"""Of shapes that only collide, as Menagerie has it; it and those above are not drawn."""
# Metres, half of its side.
_PEDESTAL = 0.11
_PEDESTAL_RGBA = (0.36, 0.37, 0.39, 1.0)


def arm_spec(contact: ContactConfig, robot: RobotDescription) -> mujoco.MjSpec:
    """A whole robot with its base at the origin."""
    spec = mujoco_spec(robot.arm.path)
    _hold_still(spec, robot)
    if not robot.gripper.attach:
        _prepare_gripper(spec, robot.gripper)
    _prepare(spec, contact)
    if not robot.gripper.attach:
        _prepare_pads(spec, robot.gripper, contact)
    _prepare_arm(spec, robot)
    if robot.gripper.attach:
        hand = hand_spec(contact, robot)
        copy_options(spec, hand)
        pose = robot.gripper.pose
        name = robot.gripper.attach
        prefix = robot.of_gripper("")
        site = next((each for each in spec.sites if each.name == name), None)
        frame = (spec.body(name) if site is None else site.parent).add_frame()
        if site is not None:
            frame.pos = site.pos
            frame.quat = site.quat
        inner = frame.parent.add_frame(frame, pos=pose[:3], quat=pose[3:])
        spec.attach(hand, prefix=prefix, frame=inner)
    return spec


def hand_spec(contact: ContactConfig, robot: RobotDescription) -> mujoco.MjSpec:
    """The gripper alone, fixed in the world, its hand's frame the world's."""
    gripper = robot.gripper
    spec = mujoco_spec(gripper.path)
    _cut_out(spec, gripper.body, robot.arm.joints)
    _prepare_gripper(spec, gripper)
    _prepare(spec, contact)
    _prepare_pads(spec, gripper, contact)
    hand = spec.body(gripper.body)
    hand.pos = (0, 0, 0)
    hand.quat = (1, 0, 0, 0)
    return spec


def _hold_still(spec: mujoco.MjSpec, robot: RobotDescription) -> None:
    """Takes away the joints of what is not part of the arm: of a base that drives, of a second arm."""
    first = spec.joint(robot.arm.joints[0]).parent
    moved = {joint.name for joint in (*first.joints, *_joints_below(first))}
    others = [joint for joint in spec.joints if joint.name not in moved]
    if others:
        _delete_keys(spec)
    for joint in others:
        _delete_joint(spec, joint)


def _cut_out(spec: mujoco.MjSpec, name: str, arm: tuple[str, ...]) -> None:
    """Leaves a hand of a model, fixed in the world: of the arm that carries it nothing but empty bodies."""
    hand = spec.body(name)
    if hand.parent.name == _WORLD and len(spec.worldbody.bodies) == 1:
        return
    _delete_keys(spec)
    for joint in [each for each in hand.joints if each.name in arm]:
        _delete_joint(spec, joint)
    below = hand
    while below.name != _WORLD:
        carrier = below.parent
        for body in [each for each in carrier.bodies if not _carries(each, name)]:
            _delete_body(spec, body)
        for joint in [] if carrier.name == _WORLD else list(carrier.joints):
            _delete_joint(spec, joint)
        for element in (*carrier.geoms, *carrier.sites, *carrier.cameras, *carrier.lights):
            spec.delete(element)
        if carrier.name != _WORLD:
            carrier.pos = (0, 0, 0)
            carrier.quat = (1, 0, 0, 0)
        below = carrier
    _delete_lost(spec)


def _carries(body: mujoco.MjsBody, name: str) -> bool:
    """It is the body of that name, or that one hangs on it."""
    return body.name == name or any(
        each.name == name for each in body.find_all(mujoco.mjtObj.mjOBJ_BODY)
    )


def _delete_keys(spec: mujoco.MjSpec) -> None:
    """They are of all joints."""
    for key in list(spec.keys):
        spec.delete(key)


def _delete_lost(spec: mujoco.MjSpec) -> None:
    """Takes away what refers to bodies that are no longer there, and sensors of what is not."""
    known = {body.name for body in spec.bodies}
    for pair in list(spec.excludes):
        if not {pair.bodyname1, pair.bodyname2} <= known:
            spec.delete(pair)
    for tie in list(spec.equalities):
        is_body = tie.objtype == mujoco.mjtObj.mjOBJ_BODY
        if is_body and not {tie.name1, tie.name2 or _WORLD} <= known:
            spec.delete(tie)
    for sensor in list(spec.sensors):
        spec.delete(sensor)


def _joints_below(body: mujoco.MjsBody) -> list[mujoco.MjsJoint]:
    return list(body.find_all(mujoco.mjtObj.mjOBJ_JOINT))


def _delete_body(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    for joint in _joints_below(body):
        _delete_joint(spec, joint)
    spec.delete(body)


def _delete_joint(spec: mujoco.MjSpec, joint: mujoco.MjsJoint) -> None:
    """Takes a joint away, and what moves it or ties it to others."""
    for actuator in list(spec.actuators):
        if actuator.trntype in _OF_JOINTS and actuator.target == joint.name:
            spec.delete(actuator)
    for tie in list(spec.equalities):
        if tie.type == mujoco.mjtEq.mjEQ_JOINT and joint.name in (tie.name1, tie.name2):
            spec.delete(tie)
    spec.delete(joint)


def _prepare(spec: mujoco.MjSpec, contact: ContactConfig) -> None:
    """Its weight carried by its motors, and contacts as the scene's."""
    _delete_keys(spec)
    for body in spec.bodies:
        body.gravcomp = 1.0
    # The default as well: what is added later, and friction of its own, go by it.
    for geom in (spec.default.geom, *spec.geoms):
        geom.friction = contact.friction
        geom.condim = contact.condim
        geom.priority = 0
        geom.solref = contact.solref
        geom.solimp = contact.solimp
    for body in spec.bodies:
        # Shapes that collide are drawn where a body has no others.
        drawn = [geom for geom in body.geoms if not (geom.contype or geom.conaffinity)]
        for geom in drawn or body.geoms:
            geom.group = VISUAL_GROUP if geom.group < _HIDDEN_GROUP else geom.group
        for geom in body.geoms if drawn else ():
            is_solid = geom.contype or geom.conaffinity
            geom.group = _HIDDEN_GROUP if is_solid else geom.group
    for site in spec.sites:
        # Some models draw the axes of their hands.
        site.group = _HIDDEN_GROUP
    _pass_over_joints(spec)
    _for_holding(spec)


def _pass_over_joints(spec: mujoco.MjSpec) -> None:
    """A body may touch the one that it is jointed to, as MuJoCo has it of all but fixed ones."""
    known = {frozenset((each.bodyname1, each.bodyname2)) for each in spec.excludes}
    fixed = [spec.worldbody]
    for below in fixed:
        for body in below.bodies:
            if not list(body.joints):
                fixed.append(body)
            elif below.name != _WORLD and frozenset((below.name, body.name)) not in known:
                spec.add_exclude(bodyname1=below.name, bodyname2=body.name)


def _prepare_arm(spec: mujoco.MjSpec, robot: RobotDescription) -> None:
    """Servos in place of motors, where the description asks for them, and its limits."""
    arm = robot.arm
    low, high = arm_limits(robot, spec)
    scale = 180 / np.pi if spec.compiler.degree else 1.0
    for k, (joint, name) in enumerate(zip(arm.joints, arm.actuators, strict=True)):
        if arm.limits:
            spec.joint(joint).range = low[k] * scale, high[k] * scale
        if arm.inertia:
            spec.joint(joint).armature = arm.inertia[k]
        if not arm.gain:
            continue
        actuator = spec.actuator(name)
        damping = arm.damping[k] if arm.damping else 0.0
        actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        actuator.gainprm[0] = arm.gain[k]
        actuator.biasprm[:3] = (0.0, -arm.gain[k], -damping)
        actuator.ctrlrange = low[k], high[k]
        if arm.torque:
            actuator.forcerange = -arm.torque[k], arm.torque[k]


def _prepare_gripper(spec: mujoco.MjSpec, gripper: GripperDescription) -> None:
    """The actuator as the description has it, and a tool's site."""
    actuator = spec.actuator(gripper.actuator)
    if gripper.gain is not None:
        actuator.gainprm[0] = gripper.gain
        actuator.biasprm[:3] = 0.0, -gripper.gain, -(gripper.damping or 0.0)
    actuator.ctrlrange = sorted((gripper.open, gripper.closed))
    if gripper.force is not None:
        actuator.forcerange = -gripper.force, gripper.force
    if gripper.inertia is not None:
        for joint in gripper.joints:
            spec.joint(joint).armature = gripper.inertia
    for name in gripper.pads:
        # Of some models other programs switch the pads on.
        pad = spec.geom(name)
        pad.contype |= 1
        pad.conaffinity |= 1
    spec.body(gripper.body).add_site(name=TOOL, pos=gripper.tool[:3], quat=gripper.tool[3:])


def pad_geoms(spec: mujoco.MjSpec, gripper: GripperDescription) -> list[mujoco.MjsGeom]:
    """What collides of the bodies of its pads; of its joints' bodies, where a table stands for the pads."""
    if gripper.pads:
        bodies = [spec.geom(name).parent for name in gripper.pads]
    else:
        bodies = [spec.joint(name).parent for name in gripper.joints]
    names = {body.name for body in bodies}
    found = [geom for body in spec.bodies if body.name in names for geom in body.geoms]
    return [geom for geom in found if geom.contype or geom.conaffinity or geom.name in gripper.pads]


def _prepare_pads(spec: mujoco.MjSpec, gripper: GripperDescription, contact: ContactConfig) -> None:
    """Pads of a friction of their own: it decides whatever they touch."""
    if gripper.friction is None:
        return
    # In the proportions of the contact's, and scaled with it, as objects' own are.
    scale = gripper.friction / ContactConfig().friction[0]
    friction = [scale * each for each in contact.friction]
    for geom in pad_geoms(spec, gripper):
        geom.friction = friction
        geom.priority = PAD_PRIORITY


def _for_holding(spec: mujoco.MjSpec) -> None:
    """Options without which the arm's servos are unstable (the scene's Euler), or what is held slides.

    Scenes may name libccd. Grasps are tested with MuJoCo's own detector, which finds more of the area where a
    pad and an object touch; with libccd a heavy pot, held by its rim, slides out of the hand.
    """
    spec.option.timestep = TIMESTEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.impratio = IMPRATIO
    spec.option.disableflags &= ~_LIBCCD


def copy_options(source: mujoco.MjSpec, target: mujoco.MjSpec) -> None:
    """Gives a model the options of what it is attached to."""
    for option in _OPTIONS:
        setattr(target.option, option, getattr(source.option, option))
    target.option.integrator = source.option.integrator


def base_pose(support: SupportAsset, robot: RobotDescription | None = None) -> np.ndarray:
    """f64[7]: T_world_base, beside the support as its description says, looking at the region's centre."""
    region = support.region
    robot = robot or find_robot()
    xy = region.center + rotate_in_plane(np.array([-robot.distance, 0.0]), region.yaw)
    return np.array([*xy, support.top + robot.height, *yaw_quaternion(region.yaw)])


def attach_robot(
    spec: mujoco.MjSpec, arm: mujoco.MjSpec, robot: RobotDescription, base: np.ndarray
) -> mujoco.MjSpec:
    """Puts a robot (`arm_spec`) into a model, its base at f64[7]; its options become those of the model."""
    copy_options(spec, arm)
    frame = spec.worldbody.add_frame(pos=base[:3], quat=base[3:])
    spec.attach(arm, prefix=robot.prefix, frame=frame)
    return spec


def with_robot(scene: Scene, robot: RobotDescription | None = None) -> mujoco.MjSpec:
    """A scene and a robot before it, the Panda if not given, ready to be compiled.

    Names of the scene stay as they are, those of the robot have its name before them. Its actuators come
    alone: those of its joints, in radians, then the gripper's.

    Raises:
      MissingExtraError: the extra `robot` is not installed.
    """
    robot = robot or find_robot()
    spec = scene.to_mjspec()
    _for_holding(spec)
    return attach_robot(
        spec, arm_spec(scene.contact, robot), robot, base_pose(scene.support, robot)
    )


def add_pedestal(
    spec: mujoco.MjSpec, place: np.ndarray, yaw: float, half_side: float = _PEDESTAL
) -> None:
    """Draws a square pillar from the floor (z = 0) up to f[3], so that what stands there does not float.

    Nothing touches it: the physics stays what it was.
    """
    half_height = float(place[2]) / 2
    if half_height > 0:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(place[0], place[1], half_height),
            quat=yaw_quaternion(yaw),
            size=(half_side, half_side, half_height),
            rgba=_PEDESTAL_RGBA,
            group=VISUAL_GROUP,
            contype=0,
            conaffinity=0,
        )


def add_pedestals(spec: mujoco.MjSpec, base: np.ndarray, stands: Sequence[Box] = ()) -> None:
    """Draws pillars below a robot, whose base is at f64[7], and below stands (`add_pedestal`)."""
    add_pedestal(spec, base[:3], 2 * float(np.arctan2(base[6], base[3])))
    for box in stands:
        low = np.array([*box.center[:2], box.center[2] - box.half_extents[2]])
        add_pedestal(spec, low, box.yaw, min(box.half_extents[:2]))


class Robot(RobotParts):
    """Where a robot of n joints is found in a compiled model (`RobotParts`)."""

    @classmethod
    def of(
        cls, model: mujoco.MjModel, robot: RobotDescription | None = None, prefix: str | None = None
    ) -> Self:
        """The robot of a model, the Panda if not given; prefix: before its names, its own if not given."""
        return cls.find(model, part_names(robot or find_robot(), prefix))


def part_names(robot: RobotDescription, prefix: str | None = None) -> PartNames:
    """What a robot's parts are called; prefix: before its names, its own if not given."""
    before = robot.prefix if prefix is None else prefix
    return PartNames(
        joints=tuple(before + name for name in robot.arm.joints),
        actuators=tuple(before + name for name in robot.arm.actuators),
        hand=before + robot.of_gripper(robot.gripper.body),
        grip=before + robot.of_gripper(robot.gripper.actuator),
        tool=before + robot.of_gripper(TOOL),
    )


def remove_drawings(spec: mujoco.MjSpec) -> None:
    """Takes away the surfaces that are only drawn, and their meshes."""
    for geom in list(spec.geoms):
        if not (geom.contype or geom.conaffinity):
            spec.delete(geom)
    remove_unused_meshes(spec)


def remove_unused_meshes(spec: mujoco.MjSpec) -> None:
    """Takes away the meshes that no geom has."""
    used = {geom.meshname for geom in spec.geoms}
    for mesh in list(spec.meshes):
        if mesh.name not in used:
            spec.delete(mesh)
