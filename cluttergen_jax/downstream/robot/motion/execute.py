"""Execution: the arm's actuators alone move the arm, and what it touches is watched.

After the start nothing is ever written into the state of the simulation: set-points of servos go in, and
poses that a perfect camera would see come out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import mujoco
import numpy as np

from cluttergen_jax.assets import VISUAL_GROUP, Box
from cluttergen_jax.downstream.robot.description import RobotDescription, find_robot
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.robot.model import Robot, add_pedestals, base_pose, with_robot
from cluttergen_jax.downstream.robot.motion.collision import Kind, add_stand, kinds_of
from cluttergen_jax.downstream.robot.motion.plan import SHARE, time_path
from cluttergen_jax.downstream.robot.outcome import Failed, Outcome
from cluttergen_jax.downstream.transforms import matrix_of
from cluttergen_jax.scene import Scene
from cluttergen_jax.sensing import Camera, cast_rays

MAX_FORCE = 2.0
"""N; an unplanned contact that presses harder ends an episode."""
CLOSING = 0.5
"""Seconds in which the fingers close."""
_DRAWN = np.isin(np.arange(mujoco.mjNGROUP), (0, VISUAL_GROUP)).astype(np.uint8)
"""Groups of geoms that a camera sees: surfaces, and boxes such as stands."""
_REST = 0.15
_MEASURED = 16
_WARNING = mujoco.mjtWarning
_DIVERGED = (_WARNING.mjWARN_BADQPOS, _WARNING.mjWARN_BADQVEL, _WARNING.mjWARN_BADQACC)


class Phase(IntEnum):
    """Which contacts are planned, besides those among objects and with what they stand on.

    FREE: none of the arm. GRASP: the hand may touch the target. CARRY: so it may, and the target touches
    nothing else. TOUCH: as GRASP, the target may touch what it stands on or will.
    """

    FREE = 0
    GRASP = 1
    CARRY = 2
    TOUCH = 3


def _unplanned_contacts() -> np.ndarray:
    """bool[phases, kinds, kinds]."""
    table = np.zeros((len(Phase), len(Kind), len(Kind)), bool)
    table[:, [Kind.ARM, Kind.HAND], :] = True
    table[:, :, [Kind.ARM, Kind.HAND]] = True
    # Fingers meet where an object is lost, which is told otherwise.
    table[:, Kind.HAND, Kind.HAND] = False
    for phase in (Phase.GRASP, Phase.CARRY, Phase.TOUCH):
        table[phase, Kind.HAND, Kind.TARGET] = table[phase, Kind.TARGET, Kind.HAND] = False
    for other in (Kind.GROUND, Kind.OTHER):
        table[Phase.CARRY, Kind.TARGET, other] = table[Phase.CARRY, other, Kind.TARGET] = True
    return table


_UNPLANNED = _unplanned_contacts()
_TOUCHING = _UNPLANNED[Phase.CARRY] & ~_UNPLANNED[Phase.TOUCH]
"""bool[kinds, kinds]: what is held and what it may be put on."""


@dataclass(eq=False)
class Trace:
    """What is kept of an episode so that it can be drawn: its state at every so manieth step.

    Attributes:
      every: steps from one state to the next.
      states: f64[nq] each.
      controls: f64[nu] each, the set-points of the actuators then.
      openings: metres that the fingers are from the middle.
      held: the number of the object that the hand is closed on at each of them, -1 if it is open.
      scene: at the start; stands: that are there besides. robot: that moves; arm: where it is found.
      target: the number of the object that is to be moved (first).
      goals: f64[N, 7], T_world_object where the scene's objects shall go, of a rearrangement; words: the
        task, where it was asked for in words.
      spec, data: of the simulation; its state stays the last one.
    """

    every: int
    states: list[np.ndarray] = field(default_factory=list)
    controls: list[np.ndarray] = field(default_factory=list)
    openings: list[float] = field(default_factory=list)
    held: list[int] = field(default_factory=list)
    goals: np.ndarray | None = None
    words: str = ""
    target: int = field(init=False)
    scene: Scene = field(init=False)
    stands: tuple[Box, ...] = field(init=False)
    robot: RobotDescription = field(init=False)
    arm: Robot = field(init=False)
    spec: mujoco.MjSpec = field(init=False)
    data: mujoco.MjData = field(init=False)

    def spec_on_pedestals(self) -> mujoco.MjSpec:
        """What was simulated, on pillars below the arm and the stands, which would float beside the table."""
        support = self.scene.support
        spec = self.spec.copy()
        add_pedestals(spec, base_pose(support, self.robot), self.stands)
        return spec


class Execution:
    """A scene with the arm before it, simulated.

    Args:
      scene: what stands there at the start. target: the number of the object that is to be moved first.
      stands: more boxes that objects can stand on.
      trace: is filled, where one is given.
      sleeps: what rests sleeps until something touches it, which saves most of the time of many objects.
      robot: that stands before it; the Panda if not given.

    Attributes:
      robot: as it is described; arm: where it is found in `model`; gripper: how that moves.
      travel: metres that the tool has moved.
    """

    def __init__(
        self,
        scene: Scene,
        target: int,
        stands: Sequence[Box] = (),
        trace: Trace | None = None,
        sleeps: bool = False,
        robot: RobotDescription | None = None,
    ) -> None:
        self.robot = robot or find_robot()
        spec, self.model = self._compile(scene, stands)
        if sleeps:
            self.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
        self.data = mujoco.MjData(self.model)
        self.arm = Robot.of(self.model, self.robot)
        self.gripper = gripper_of(self.robot)
        self.step_time = float(self.model.opt.timestep)
        self._bodies = [self.model.body(name).id for name in scene.names]
        self.aim_at(target)
        self._trace = trace
        self.num_steps = 0
        if trace is not None:
            trace.scene = scene
            trace.target = target
            trace.stands = tuple(stands)
            trace.robot = self.robot
            trace.spec = spec
            trace.data = self.data
            trace.arm = self.arm
        self.travel = 0.0
        self._start(scene)

    def _compile(self, scene: Scene, stands: Sequence[Box]) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
        """A model of the scene, the stands and the arm; where many scenes have one model, that one."""
        spec = with_robot(scene, self.robot)
        for number, box in enumerate(stands):
            add_stand(spec, box, f"ground-{number}")
        return spec, spec.compile()

    def wake(self) -> None:
        """From now on nothing sleeps."""
        self.model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)

    def aim_at(self, target: int) -> None:
        """From now on this object is the one that the hand may touch."""
        kind = kinds_of(self.arm, self._bodies, self._bodies[target])
        self._kind = kind[self.model.geom_bodyid]
        self._target = target

    def _start(self, scene: Scene) -> None:
        for name, pose in zip(scene.names, scene.poses, strict=True):
            first = int(self.model.joint(name).qposadr[0])
            self.data.qpos[first : first + 7] = pose
        self.data.qpos[self.arm.qpos] = self.data.ctrl[self.arm.ctrl] = self.robot.arm.home
        widest = self.gripper.max_opening
        self.data.qpos[self.arm.fingers] = self.gripper.joints_of(widest)
        self.data.ctrl[self.arm.grip] = self.gripper.control_of(widest)
        mujoco.mj_forward(self.model, self.data)
        self._last_tool = self.data.site_xpos[self.arm.site].copy()

    @property
    def joints(self) -> np.ndarray:
        """f64[n]: where the arm is."""
        return self.data.qpos[self.arm.qpos].copy()

    @property
    def set_point(self) -> np.ndarray:
        """f64[n]: where the arm's servos want it, as long as it rests."""
        return self.data.ctrl[self.arm.ctrl].copy()

    @property
    def tool(self) -> np.ndarray:
        """f64[4, 4]: T_world_tool."""
        mujoco.mj_kinematics(self.model, self.data)
        return self.arm.tool(self.data)

    @property
    def opening(self) -> float:
        """Metres that each pad is from the middle."""
        return self.gripper.measure(self.data.qpos[self.arm.fingers])

    @property
    def is_closed(self) -> bool:
        """The fingers are told to close on something."""
        return self.gripper.is_closing(float(self.data.ctrl[self.arm.grip]))

    def poses(self) -> np.ndarray:
        """f64[N, 7]: T_world_object of the scene's objects."""
        mujoco.mj_kinematics(self.model, self.data)
        return np.concatenate([self.data.xpos[self._bodies], self.data.xquat[self._bodies]], axis=1)

    def pose(self, number: int) -> np.ndarray:
        """f64[4, 4]: T_world_object of one."""
        return matrix_of(self.poses()[number])

    def depth(self, camera: Camera) -> np.ndarray:
        """f32[H, W]: what a depth camera sees now, the arm included; metres along its axis, inf: nothing."""
        mujoco.mj_kinematics(self.model, self.data)
        return cast_rays(self.model, self.data, camera, _DRAWN)[0]

    def follow(
        self, path: np.ndarray, phase: Phase, share: float = SHARE, until_touch: bool = False
    ) -> bool:
        """Runs along joints f64[L, n], as fast as a share of the arm's limits allows (`plan.time_path`).

        Args:
          until_touch: stops where the hand feels that what it holds presses on something harder than
            `MAX_FORCE`, as a force sensor at the wrist would tell.

        Returns:
          Whether it stopped at a touch.

        Raises:
          Failed: an unplanned contact pressed harder than `MAX_FORCE`.
        """
        limits = self.robot.arm
        motion = time_path(path, self.step_time, limits.speed, limits.acceleration, share)
        # A servo with damping trails behind a moving set-point by a known time.
        points = motion.joints + self.arm.lag * motion.speed
        end = motion.joints[-1]
        has_touched = False
        for number, joints in enumerate(np.clip(points, self.arm.low, self.arm.high)):
            self.data.ctrl[self.arm.ctrl] = joints
            self._step(phase)
            if until_touch and self._pressing(_TOUCHING) is not None:
                end = motion.joints[number]
                has_touched = True
                break
        self.data.ctrl[self.arm.ctrl] = end
        return has_touched

    def wait(self, seconds: float, phase: Phase) -> None:
        """Lets time pass, the set-points as they are."""
        for _ in range(round(seconds / self.step_time)):
            self._step(phase)

    def move_fingers(self, opening: float, phase: Phase, seconds: float = CLOSING) -> None:
        """Brings the fingers to metres from the middle for each, evenly."""
        self._command(float(self.gripper.control_of(opening)), phase, seconds)

    def _command(self, target: float, phase: Phase, seconds: float = CLOSING) -> None:
        """Brings the control of the gripper there, evenly."""
        start = float(self.data.ctrl[self.arm.grip])
        number = round(seconds / self.step_time)
        for step in range(1, number + 1):
            self.data.ctrl[self.arm.grip] = start + (target - start) * step / number
            self._step(phase)
        self.wait(_REST, phase)

    def close(self) -> None:
        """Closes the fingers on what is between them."""
        self._command(self.gripper.closed, Phase.GRASP)

    def _step(self, phase: Phase) -> None:
        mujoco.mj_step(self.model, self.data)
        self.num_steps += 1
        if self._trace is not None and self.num_steps % self._trace.every == 0:
            self._trace.states.append(self.data.qpos.copy())
            self._trace.controls.append(self.data.ctrl.copy())
            self._trace.openings.append(self.opening)
            self._trace.held.append(self._target if self.is_closed else -1)
        if self.num_steps % _MEASURED == 0:
            now = self.data.site_xpos[self.arm.site].copy()
            self.travel += float(np.linalg.norm(now - self._last_tool))
            self._last_tool = now
            self._check_diverged()
        self._watch(phase)

    def _check_diverged(self) -> None:
        # MuJoCo has begun anew by then, with the arm somewhere.
        if any(self.data.warning[kind].number for kind in _DIVERGED):
            raise Failed(Outcome.UNSTABLE, "the simulation diverged")

    def _watch(self, phase: Phase) -> None:
        contact = self._pressing(_UNPLANNED[phase])
        if contact is not None:
            self._check_diverged()
            bodies = self.model.geom_bodyid[self.data.contact.geom[contact]]
            a, b = (self.model.body(body).name or "ground" for body in bodies)
            raise Failed(Outcome.CONTACT, f"{a} and {b}, {phase.name.lower()}")

    def _pressing(self, asked: np.ndarray) -> int | None:
        """The first contact of kinds bool[kinds, kinds] that presses harder than `MAX_FORCE`."""
        data = self.data
        if not data.ncon:
            return None
        kinds = self._kind[data.contact.geom]
        force = np.zeros(6)
        for contact in np.flatnonzero(asked[kinds[:, 0], kinds[:, 1]]):
            mujoco.mj_contactForce(self.model, data, int(contact), force)
            if np.linalg.norm(force[:3]) > MAX_FORCE:
                return int(contact)
        return None
