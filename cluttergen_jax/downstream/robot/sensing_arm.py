"""An arm that looks: it picks an object up, asks a placer by pictures, and puts it there."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.ndimage import binary_dilation

from cluttergen_jax.assets import VISUAL_GROUP, Box, ObjectAsset, SupportAsset, add_part
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.downstream.robot.cameras import wrist_camera
from cluttergen_jax.downstream.robot.description import RobotDescription
from cluttergen_jax.downstream.robot.grasping.grasps import Grasps
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.robot.model import Robot, arm_spec, attach_robot, base_pose
from cluttergen_jax.downstream.robot.motion.collision import ROOMS, PlanningWorld
from cluttergen_jax.downstream.robot.motion.execute import Execution, Phase
from cluttergen_jax.downstream.robot.motion.ik import ArmKinematics, first_axis
from cluttergen_jax.downstream.robot.motion.mover import Mover
from cluttergen_jax.downstream.robot.motion.plan import PickPlan
from cluttergen_jax.downstream.robot.outcome import Failed, Outcome
from cluttergen_jax.downstream.robot.places import CameraPlacer, DepthView
from cluttergen_jax.downstream.robot.protocols import PathPlanner
from cluttergen_jax.downstream.transforms import inverse, matrix_of, pose_of
from cluttergen_jax.sensing import Camera, cast_rays

_GROWN = 3
"""Pixels around it that are left out, too: what is in front grows in a noisy picture."""
_BROUGHT = "brought"
_DRAWN = np.isin(np.arange(mujoco.mjNGROUP), VISUAL_GROUP).astype(np.uint8)


class ArmSilhouette:
    """Says which pixels of a picture the arm and one object cover.

    Args:
      base: f64[7], T_world_base, of the `robot`.
      asset: the object that it brings; None leaves only the arm out.
    """

    def __init__(
        self,
        base: np.ndarray,
        robot: RobotDescription,
        asset: ObjectAsset | None = None,
    ) -> None:
        spec = attach_robot(mujoco.MjSpec(), arm_spec(ContactConfig(), robot), robot, base)
        brought = spec.worldbody.add_body(name=_BROUGHT)
        for index, part in enumerate(() if asset is None else asset.parts):
            add_part(spec, brought, f"{_BROUGHT}/part-{index}", part.vertices).group = VISUAL_GROUP
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._arm = Robot.of(self._model, robot)
        self._gripper = gripper_of(robot)
        self._brought = self._model.body(_BROUGHT).id

    def __call__(
        self, camera: Camera, joints: np.ndarray, opening: float, pose: np.ndarray | None = None
    ) -> np.ndarray:
        """bool[H, W]: pixels that may show them.

        Args:
          camera: where it is believed to stand.
          joints: f64[n]; opening: metres of each pad from the middle; pose: f64[7],
            T_world_object, where there is one.
        """
        model = self._model
        data = self._data
        data.qpos[self._arm.qpos] = joints
        data.qpos[self._arm.fingers] = self._gripper.joints_of(opening)
        if pose is not None:
            model.body_pos[self._brought] = pose[:3]
            model.body_quat[self._brought] = pose[3:]
        mujoco.mj_kinematics(model, data)
        covered = np.isfinite(cast_rays(model, data, camera, _DRAWN)[0])
        return binary_dilation(covered, np.ones((3, 3)), _GROWN)


_ASIDE = -1.3
"""Radians of the first joint, from home, at which the arm is out of the overhead camera's sight."""
_LOST = 0.5
"""Share of its opening as it took the object below which a closed hand has lost it."""


class HeldPose:
    """Where the object is by what the arm knows: as it stood, and in the closed hand as it was grasped.

    Args:
      execution: of which the tool and the fingers are read, nothing else. start: f64[7], T_world_object.
    """

    def __init__(self, execution: Execution, start: np.ndarray) -> None:
        self._execution = execution
        self._pose = matrix_of(start)
        self._T_tool_object: np.ndarray | None = None
        self._opening = 0.0

    def __call__(self, only: int | None = None) -> np.ndarray:
        """f64[1, 7]: T_world_object (`mover.See`).

        Raises:
          Failed: the hand has closed since it took the object: it is lost.
        """
        run = self._execution
        if not run.is_closed:
            self._T_tool_object = None
        elif self._T_tool_object is None:
            self._T_tool_object = inverse(run.tool) @ self._pose
            self._opening = run.opening
        else:
            self._pose = run.tool @ self._T_tool_object
            if run.opening < _LOST * self._opening:
                raise Failed(Outcome.SLIP, "the hand has closed")
        return pose_of(self._pose)[None]


@dataclass(eq=False)
class SensingArm:
    """Brings one object from its stand to where a placer wants it, by what its cameras see.

    It knows its own joints, the support, the stand, and the object with the pose at which that stands there.
    All else it sees; where the other objects truly are is never asked.

    Args:
      execution: the simulation. asset: the object. start: f64[7], T_world_object, on the stand.
      placer: is asked. name: of the object in the placer's world. seed: of the motions, noise and proposals.
      planner: a user's own (`Mover`).

    Attributes:
      looks: pictures that were taken.
    """

    execution: Execution
    asset: ObjectAsset
    start: np.ndarray
    support: SupportAsset
    stand: Box
    placer: CameraPlacer
    name: str
    seed: int
    planner: PathPlanner | None = None

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng((self.seed, 1))
        self._base = base_pose(self.support, self.execution.robot)
        self._silhouette = ArmSilhouette(self._base, self.execution.robot, self.asset)
        self._object = HeldPose(self.execution, self.start)
        self._views: list[DepthView] = []
        self._fitting: np.ndarray | None = None
        self.looks = 0

    @property
    def believed(self) -> np.ndarray:
        """f64[4, 4]: T_world_object, where the arm takes it to be."""
        return matrix_of(self._object()[0])

    def pick(self, grasps: Grasps) -> Mover:
        """Looks, and lifts the object from the stand by a grasp that fits one of the places proposed so far.

        Raises:
          Failed: no grasp, no way, or something went wrong.
        """
        self._look(wrist_camera(self.execution.tool))
        self._swing_aside()
        self._look(self.placer.overhead)
        run = self.execution
        kinematics = ArmKinematics(self._base, run.robot)
        mover = Mover(
            run,
            self._world(),
            kinematics,
            0,
            self.seed,
            see=self._object,
            rooms=ROOMS,
            feels=True,
            planner=self.planner,
        )
        mover.pick(self._find_pick(mover, grasps))
        return mover

    def put(self, mover: Mover) -> tuple[int, np.ndarray]:
        """Looks again, asks the placer, and puts the object down at the first proposal that works.

        Returns:
          The proposal's number, and f64[4, 4], T_world_object.

        Raises:
          Failed: nothing was proposed, there is no way, or something went wrong.
        """
        self._look(self.placer.overhead)
        mover.plan_in(self._world())
        places = self.placer.in_world(self._propose(self._fitting))
        if not len(places):
            raise Failed(Outcome.NO_PLACE)
        number = mover.place(places)
        return number, mover.put

    def _look(self, camera: Camera) -> None:
        """Takes a picture; what it shows of the arm and the object is left out."""
        run = self.execution
        depth, camera = self.placer.measure(run.depth(camera), camera, self._rng)
        is_own = self._silhouette(camera, run.joints, run.opening, self._object()[0])
        self._views.append(DepthView(np.where(is_own, np.float32(np.nan), depth), camera))
        self.looks += 1

    def _swing_aside(self) -> None:
        """Turns the arm at its base, at the height at which it waits: above all that stands on a table."""
        run = self.execution
        aside = run.set_point
        turn = _ASIDE * (first_axis(run.robot).sign or 1.0)
        aside[0] = np.clip(aside[0] + turn, run.arm.low[0], run.arm.high[0])
        run.follow(np.linspace(run.set_point, aside, 8), Phase.FREE)
        run.wait(0.2, Phase.FREE)

    def _world(self) -> PlanningWorld:
        return PlanningWorld(
            (self.name,),
            (self.asset,),
            self.start[None],
            0,
            self.support,
            self._base,
            self.execution.robot,
            (self.stand,),
            self.placer.columns(self._views),
        )

    def _propose(self, last: np.ndarray | None = None) -> np.ndarray:
        return self.placer.propose(self._views, self.name, self.seed, last)

    def _find_pick(self, mover: Mover, grasps: Grasps) -> PickPlan:
        """A grasp that fits one of the places that are proposed so far, if there is one."""
        proposed = self._propose()
        if len(proposed):
            try:
                found = mover.find_pick(grasps, self.placer.in_world(proposed))
                self._fitting = proposed[mover.fitting]
                return found
            except Failed:
                # With more to be seen, other places may be proposed.
                pass
        return mover.find_pick(grasps)
