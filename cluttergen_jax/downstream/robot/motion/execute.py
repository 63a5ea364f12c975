"""Execution: the arm's actuators alone move the arm, and what it touches is watched.

After the start nothing is ever written into the state of the simulation: set-points of servos go in, and
poses that a perfect camera would see come out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from cluttergen_jax.assets import VISUAL_GROUP, Box
from cluttergen_jax.downstream.episodes.simulation import TOUCHING, Phase, Simulation
from cluttergen_jax.downstream.robot.description import RobotDescription, find_robot
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.robot.model import Robot, add_pedestals, base_pose, with_robot
from cluttergen_jax.downstream.robot.motion.collision import add_stand
from cluttergen_jax.downstream.robot.motion.plan import SHARE, time_path
from cluttergen_jax.scene import Scene
from cluttergen_jax.sensing import Camera, cast_rays

CLOSING = 0.5
"""Seconds in which the fingers close."""
_DRAWN = np.isin(np.arange(mujoco.mjNGROUP), (0, VISUAL_GROUP)).astype(np.uint8)
"""Groups of geoms that a camera sees: surfaces, and boxes such as stands."""
_REST = 0.15


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


class Execution(Simulation):
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
        spec, model = self._compile(scene, stands)
        if sleeps:
            model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
        arm = Robot.of(model, self.robot)
        super().__init__(model, arm, gripper_of(self.robot), scene.names, target)
        self._trace = trace
        if trace is not None:
            trace.scene = scene
            trace.target = target
            trace.stands = tuple(stands)
            trace.robot = self.robot
            trace.spec = spec
            trace.data = self.data
            trace.arm = arm
        self.put_home(scene.names, scene.poses, self.robot.arm.home)

    def _compile(self, scene: Scene, stands: Sequence[Box]) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
        """A model of the scene, the stands and the arm; where many scenes have one model, that one."""
        spec = with_robot(scene, self.robot)
        for number, box in enumerate(stands):
            add_stand(spec, box, f"ground-{number}")
        return spec, spec.compile()

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
            if until_touch and self._pressing(TOUCHING) is not None:
                end = motion.joints[number]
                has_touched = True
                break
        self.data.ctrl[self.arm.ctrl] = end
        return has_touched

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

    def _keep(self) -> None:
        trace = self._trace
        if trace is not None and self.num_steps % trace.every == 0:
            trace.states.append(self.data.qpos.copy())
            trace.controls.append(self.data.ctrl.copy())
            trace.openings.append(self.opening)
            trace.held.append(self._target if self.is_closed else -1)
