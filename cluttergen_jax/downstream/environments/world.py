"""A bank and a robot together: one model with resets of both, exact or made for learning."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np
from scipy.spatial import KDTree

from cluttergen_jax.assets import Box, SupportAsset, turn_symmetry
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.downstream.environments.randomization import (
    RandomizationConfig,
    draw_fields,
    prepare,
)
from cluttergen_jax.downstream.episodes.robot_parts import Gripper, PartNames
from cluttergen_jax.downstream.episodes.tasks import Task
from cluttergen_jax.downstream.episodes.world import numbers_of
from cluttergen_jax.downstream.robot.cameras import SIZE, wrist_camera
from cluttergen_jax.downstream.robot.check import usable_robot
from cluttergen_jax.downstream.robot.description import RobotDescription, RobotLike, find_robot
from cluttergen_jax.downstream.robot.episode import stand_beside
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.robot.model import Robot as Arm
from cluttergen_jax.downstream.robot.model import (
    add_pedestals,
    base_pose,
    part_names,
    remove_unused_meshes,
)
from cluttergen_jax.downstream.robot.model import arm_spec as whole_arm
from cluttergen_jax.downstream.robot.motion.collision import add_stand
from cluttergen_jax.downstream.robot.motion.ik import ArmKinematics
from cluttergen_jax.downstream.words import RobotPhysics, check_choice
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.generation import BankArrays, BankAttachment, BankWorld, WorldState
from cluttergen_jax.geometry import Array
from cluttergen_jax.rendering import add_lighting, new_context
from cluttergen_jax.scene import FixedCamera, Scene, region_of

HAND_CAMERA = "hand"
"""The camera on the hand; others bear the names of `scene.cameras`."""
_LEARNING_MODELS = {"panda": "mjx_panda.xml"}
"""Of Menagerie: the same robot with few, simple colliders, beside the file of the arm."""


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


LEARNING_STEP = 1 / 480
"""Seconds."""
_ITERATIONS = 10
_OPTIONS = (
    "timestep",
    "gravity",
    "cone",
    "impratio",
    "iterations",
    "ls_iterations",
    "noslip_iterations",
)
# Metres that lamps and cameras are made for; what waits is farther away than they see.
_EXTENT = 1.5
_NEAR = 0.02
_FAR = 40.0

_REACHED = 4000
"""Poses of an arm that are drawn to find how near it comes to objects."""
_NEAR_ENOUGH = 0.15
"""Metres: neighbours among these are so far apart."""
_PROBED = 64
_HAND_CONTACTS = 32
_HEADROOM = 2.0
"""Contacts are looked for in so many scenes at rest; episodes have more, and those of the hand."""


class ContactLimits(NamedTuple):
    """What MJX with Warp has to be told before it makes its data.

    Attributes:
      nconmax: contacts of a world; `naconmax` is this times the number of worlds.
      njmax: rows of constraints of a world.
    """

    nconmax: int
    njmax: int


@dataclass(frozen=True, eq=False, repr=False)
class RobotWorld(BankWorld):
    """All objects of a bank, a support and a robot. Made by `with_robot`.

    `reset(seed or key)` gives states (`WorldState`); `put(data, state)` begins an episode in C MuJoCo.

    Attributes:
      spec: what `model` was compiled of, to be extended and compiled again (`attachment.world(model)`).
      physics: "accurate" or "learning".
      description: of the robot.
      base: f64[7], T_world_base.
      randomization: what differs between episodes, None for nothing.
    """

    spec: mujoco.MjSpec = field(default_factory=mujoco.MjSpec)
    physics: RobotPhysics = "accurate"
    description: RobotDescription = field(default_factory=find_robot)
    base: np.ndarray = field(default_factory=lambda: np.zeros(7))
    randomization: RandomizationConfig | None = None

    @cached_property
    def robot(self) -> Arm:
        """Where the robot's joints, actuators, fingers, tool site and bodies are in the model."""
        return Arm.of(self.model, self.description)

    @property
    def parts(self) -> PartNames:
        """What the parts of the robot are called in the model."""
        return part_names(self.description)

    @cached_property
    def gripper(self) -> Gripper:
        """How the gripper moves."""
        return gripper_of(self.description)

    @property
    def opened(self) -> float:
        """The control that opens the gripper."""
        return self.description.gripper.open

    @property
    def prefix(self) -> str:
        """Before the robot's names."""
        return self.description.prefix

    @property
    def speed(self) -> Sequence[float]:
        """rad/s, of the arm's joints at most."""
        return self.description.arm.speed

    @property
    def home(self) -> Sequence[float]:
        """Radians, of the arm's joints at the beginning."""
        return self.description.arm.home

    @cached_property
    def stand(self) -> Box:
        """The box beside the support that objects are placed from, where the task has one."""
        return stand_beside(self.support)

    @staticmethod
    def symmetries(scene: Scene) -> list[int]:
        """Of each object of a scene, after how many equal turns about its z it looks the same."""
        return [turn_symmetry(asset) for asset in scene.objects]

    def kinematics(self) -> ArmKinematics:
        """Of the arm, its base where it stands."""
        return ArmKinematics(self.base, self.description)

    @staticmethod
    def new_context(width: int, height: int) -> Any:
        """A GL context, made current (RendererError: nothing here can draw)."""
        return new_context(width, height)

    @cached_property
    def support(self) -> SupportAsset:
        """The support, its region that of the bank."""
        return support_of(self.bank)

    @cached_property
    def limits(self) -> ContactLimits:
        """Sized from scenes of the bank at rest, with the robot at home: twice as many, and the hand's."""
        # An episode that runs keeps its own model.
        other = replace(self, model=copy.copy(self.model), randomization=None)
        data = mujoco.MjData(other.model)
        most = np.zeros(2)
        numbers = np.asarray(self.bank.index)
        for number in numbers[:: -(-len(numbers) // _PROBED)]:
            other.put(data, other.reset(0, index=int(number)))
            most = np.maximum(most, (data.ncon, data.nefc))
        num_contacts, num_rows = (int(each) for each in np.ceil(_HEADROOM * most))
        return ContactLimits(num_contacts + _HAND_CONTACTS, num_rows + 6 * _HAND_CONTACTS)

    def scene(self, state: WorldState) -> Scene:
        """The scene of a state as a value, with this model's names; objects in the order of placement."""
        present = [int(number) for number in np.asarray(state.object_index) if number >= 0]
        return replace(
            self.bank.waiting_scene(),
            names=tuple(self.names[number] for number in present),
            objects=tuple(self.bank.compiled.objects[number] for number in present),
            poses=np.asarray(state.qpos, np.float64)[self.object_qpos[present]],
            support=self.support,
            cameras=(),
        )

    def state_of(self, scene: BankArrays, key: Array) -> WorldState:
        """The beginning of an episode in this scene of the bank; pure. key: of what is randomized."""
        return self._state(scene, key)

    def _state(self, scene: BankArrays, key: Array) -> WorldState:
        state = super()._state(scene, key)
        if self.randomization is None:
            return state
        drawn, mass = draw_fields(key, self.randomization, self)
        factor = jnp.ones(self.model.nbody).at[self.bodies].set(mass)
        return state.replace(fields=drawn, xfrc_applied=state.xfrc_applied * factor[:, None])


def support_of(bank: BankArrays) -> SupportAsset:
    """The support of a bank, its region the one that scenes were made in."""
    return replace(bank.bank.support, region=region_of(bank.bank))


def stands_of(task: Task, bank: BankArrays) -> tuple[Box, ...]:
    """Boxes that a task needs beside the support of a bank."""
    return (stand_beside(support_of(bank)),) if task.has_stand else ()


def with_robot(
    bank: BankArrays,
    robot: RobotLike = "panda",
    pose: Sequence[float] | None = None,
    physics: RobotPhysics = "accurate",
    *,
    stands: Sequence[Box] = (),
    randomization: RandomizationConfig | None = None,
) -> RobotWorld:
    """Puts a robot and all objects of a bank into one model, with resets of both. Extra `robot`.

        world = cg.robot.with_robot(cg.load_bank("bank"), physics="learning")
        states = jax.vmap(world.reset)(jax.random.split(jax.random.key(0), 1024))

    "accurate" is what `robot place` uses: convex parts of the arm, elliptic cones, 1/960 s. "learning" is for
    training: links touch nothing, 10 iterations, 1/480 s; the Panda's own hand has Menagerie's colliders for
    MJX, a capsule wider than the hand and a pad a finger. Objects and elliptic cones are the same in both:
    with pyramidal ones the hand threw what it held, and they were no faster. On a GPU it is meant for MJX
    with Warp (`mjx.put_model(world.model, impl="warp")`, sized by `world.limits`); MJX in pure JAX does not
    compile a step of it within two minutes, so on a CPU use MuJoCo itself.

    Args:
      bank: of `load_bank`.
      robot: a name, the path of a YAML file, or a `RobotDescription` (docs/guide/robots.md).
      pose: T_world_base, metres, wxyz; before the region at the height of the support's top if not given.
      physics: "accurate" or "learning".
      stands: more boxes that objects can stand on.
      randomization: what differs between episodes; `state.fields` are then fields of the model, written by
        `world.put`, or by `mjx_model.tree_replace(state.fields)`.

    Raises:
      ConfigError: there is no such robot or physics, or the pose is none.
      MissingExtraError: the extra `robot` is not installed.
    """
    if not isinstance(bank, BankArrays):
        raise ConfigError(
            f"a bank of type {type(bank).__name__}", "that of cg.load_bank", "load_bank(folder)"
        )
    check_choice("physics", physics, RobotPhysics)
    if pose is not None and not _is_pose(pose):
        raise ConfigError(
            f"pose = {pose!r}", "seven finite numbers: metres, then a unit quaternion wxyz"
        )
    if randomization is not None and not isinstance(randomization, RandomizationConfig):
        raise ConfigError(
            f"randomization = {randomization!r}",
            "None or a RandomizationConfig",
            "cg.robot.RandomizationConfig()",
        )
    found = usable_robot(robot)
    contact = bank.waiting_scene().contact
    spec = bank.to_mjspec()
    child = arm_spec(contact, found, is_simple=physics == "learning")
    spec.option.timestep = child.option.timestep
    spec.option.integrator = child.option.integrator
    spec.option.impratio = child.option.impratio
    spec.option.disableflags = child.option.disableflags
    if physics == "learning":
        _make_fast(spec)
    for option in _OPTIONS:
        setattr(child.option, option, getattr(spec.option, option))
    child.option.disableflags = spec.option.disableflags
    for number, box in enumerate(stands):
        add_stand(spec, box, f"stand-{number}")
    support = support_of(bank)
    base = base_pose(support, found) if pose is None else np.asarray(pose, np.float64)
    spec.attach(
        child, prefix=found.prefix, frame=spec.worldbody.add_frame(pos=base[:3], quat=base[3:])
    )
    add_pedestals(spec, base, stands)
    if randomization is not None:
        prepare(spec, randomization)
    add_lighting(spec)
    # Of what is looked at, not of where objects wait.
    spec.stat.center = support.region_points[0]
    spec.stat.extent = _EXTENT
    spec.visual.map.znear = _NEAR / _EXTENT
    spec.visual.map.zfar = _FAR / _EXTENT
    model = spec.compile()
    qpos = model.qpos0.copy()
    ctrl = np.zeros(model.nu)
    set_home(found, Arm.of(model, found), qpos, ctrl)
    attached = BankAttachment(bank)
    return RobotWorld(attached, model, qpos, ctrl, spec, physics, found, base, randomization)


def check_reach(world: RobotWorld, places: np.ndarray) -> None:
    """Refuses an arm that comes near to no last object of the scenes `places`, i[M].

    Raises:
      ConfigError: it does not. A tool that comes near may still come there in no useful pose.
    """
    model = world.model
    arm = world.robot
    poses = np.asarray(world.bank.poses)[places]
    last = (np.asarray(world.bank.object_index)[places] >= 0).sum(1) - 1
    targets = KDTree(poses[np.arange(len(places)), last, :3])
    data = mujoco.MjData(model)
    data.qpos[:] = world.qpos0
    rng = np.random.default_rng(0)
    tools = np.empty((_REACHED, 3))
    for tool, joints in zip(
        tools, rng.uniform(arm.low, arm.high, (_REACHED, len(arm.qpos))), strict=True
    ):
        data.qpos[arm.qpos] = joints
        mujoco.mj_kinematics(model, data)
        tool[:] = data.site_xpos[arm.site]
    away = float(targets.query(tools)[0].min())
    if away > _NEAR_ENOUGH:
        raise ConfigError(
            f"robot {world.description.name}, whose tool comes no nearer than {away:.2f} m to any object "
            "that is to be moved",
            "scenes within its reach",
            "another `distance` in its description, or a smaller region",
        )


def _make_fast(spec: mujoco.MjSpec) -> None:
    option = spec.option
    option.timestep = LEARNING_STEP
    option.iterations = _ITERATIONS
    option.noslip_iterations = 0


def _is_pose(pose: Sequence[float]) -> bool:
    values = numbers_of(pose)
    return values.shape == (7,) and bool(
        np.isfinite(values).all() and abs(np.linalg.norm(values[3:]) - 1) < 1e-6
    )
