"""Episodes: an object is lifted out of clutter, or brought from a stand into it, and all of it is judged."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cluttergen_jax.assets import Box, SupportAsset
from cluttergen_jax.downstream.episodes.outcome import Failed, Outcome, told_motion
from cluttergen_jax.downstream.episodes.progress import LIFT
from cluttergen_jax.downstream.episodes.referee import EpisodeReferee, pose_on_stand
from cluttergen_jax.downstream.robot.description import RobotDescription
from cluttergen_jax.downstream.robot.grasping.grasps import Grasps
from cluttergen_jax.downstream.robot.model import base_pose
from cluttergen_jax.downstream.robot.motion.collision import PlanningWorld
from cluttergen_jax.downstream.robot.motion.execute import Execution, Trace
from cluttergen_jax.downstream.robot.motion.ik import ArmKinematics
from cluttergen_jax.downstream.robot.motion.mover import MAX_SLIP, MAX_TURN, Mover
from cluttergen_jax.downstream.robot.outcome import Ending, run_to_end
from cluttergen_jax.downstream.robot.places import CameraPlacer
from cluttergen_jax.downstream.robot.protocols import PathPlanner
from cluttergen_jax.downstream.robot.sensing_arm import SensingArm
from cluttergen_jax.downstream.transforms import angle_between, matrix_of
from cluttergen_jax.geometry import rotate_in_plane
from cluttergen_jax.scene import Scene

STAND_SIDE = 0.26
"""Metres; the square beside the table from which objects are picked up."""
_STAND_GAP = 0.01
_STAND_HALF_HEIGHT = 0.01
_STAND_BEFORE = 0.1


@dataclass(frozen=True)
class EpisodeResult(Ending):
    """What became of an episode.

    Attributes:
      object: the name of the object that was moved; num_others: objects besides it.
      error, turn_error: metres in plan and radians in the end from where it was put; nan if it never was.
        z_error: metres.
      displaced: metres that another object moved at most.
      proposal: which of the places proposed in the region was used, -1 if none was.
      seconds: of the simulated time. cpu: seconds of this process.
      placer: what proposed the places. looks: pictures that the arm's cameras took.
      scene: the number of the scene in its bank, -1 where it is not known.
    """

    object: str
    num_others: int
    error: float
    turn_error: float
    z_error: float
    displaced: float
    proposal: int
    seconds: float
    cpu: float
    placer: str = "none"
    looks: int = 0
    scene: int = -1


def stand_beside(support: SupportAsset) -> Box:
    """A square on the level of the support's top, beside it at the region's -y, nearer to the arm."""
    region = support.region
    center = np.asarray(region.center)
    parts = [
        rotate_in_plane(part.vertices[:, :2] - center, -region.yaw)[:, 1].min()
        for part in support.parts
    ]
    low = min([_low_side(box, region.yaw, center) for box in support.boxes] + parts)
    middle = np.array([-_STAND_BEFORE, low - _STAND_GAP - STAND_SIDE / 2])
    x, y = np.asarray(region.center) + rotate_in_plane(middle, region.yaw)
    half = STAND_SIDE / 2
    place = (float(x), float(y), support.top - _STAND_HALF_HEIGHT)
    return Box(place, (half, half, _STAND_HALF_HEIGHT), region.yaw)


def _low_side(box: Box, yaw: float, center: np.ndarray) -> float:
    """The least y of a box in the region's frame."""
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    corners = (
        np.asarray(box.center[:2]) + rotate_in_plane(signs * box.half_extents[:2], box.yaw) - center
    )
    return float(rotate_in_plane(corners, -yaw)[:, 1].min())


class Referee(EpisodeReferee):
    """A simulated episode and its judge; besides an arm that is told the true state it alone reads that.

    Args:
      scene: all objects, where they stand at the start.
      target: the number of the one that is to be moved.
      stands: more boxes that objects can stand on.
      trace, robot: see `Execution`.

    Attributes:
      put: where the object was put, once it was.
      displaced: metres that another object was seen to have moved at most.
    """

    execution: Execution

    def __init__(
        self,
        scene: Scene,
        target: int,
        stands: tuple[Box, ...],
        trace: Trace | None = None,
        robot: RobotDescription | None = None,
    ) -> None:
        self.put: Put | None = None
        super().__init__(scene, target, Execution(scene, target, stands, trace, robot=robot))

    def errors(self, place: np.ndarray) -> tuple[float, float, float]:
        """Metres in plan, radians and metres in height of the object from a pose f64[4, 4]."""
        now = self.execution.pose(self.target)
        off = now[:3, 3] - place[:3, 3]
        return float(np.linalg.norm(off[:2])), float(angle_between(now, place)), float(off[2])

    def check_near(self, place: np.ndarray, outcome: Outcome) -> None:
        """The object is where the arm believes it, f64[4, 4], as far as it may slip in a hand.

        Raises:
          Failed: it is not.
        """
        shift, turn, height = self.errors(place)
        shift = float(np.hypot(shift, height))
        if shift > MAX_SLIP or turn > MAX_TURN:
            raise Failed(outcome, told_motion(shift, turn))


class EpisodeWorld(Referee):
    """An episode whose arm is told where everything is: the simulation and its copy for planning.

    Args: as those of `Referee`; seed: of what is drawn; planner: a user's own (`Mover`).
    """

    def __init__(
        self,
        scene: Scene,
        target: int,
        stands: tuple[Box, ...],
        seed: int,
        trace: Trace | None = None,
        planner: PathPlanner | None = None,
        robot: RobotDescription | None = None,
    ) -> None:
        super().__init__(scene, target, stands, trace, robot)
        robot = self.execution.robot
        base = base_pose(scene.support, robot)
        known = (scene.names, scene.objects, scene.poses)
        planning = PlanningWorld(*known, target, scene.support, base, robot, stands)
        self.mover = Mover(
            self.execution, planning, ArmKinematics(base, robot), target, seed, planner=planner
        )


class Put(NamedTuple):
    """Where an object was put: the number of the proposal, and f64[4, 4], T_world_object."""

    number: int
    place: np.ndarray


def robot_episode(
    scene: Scene,
    target: int,
    grasps: Grasps,
    seed: int,
    places: np.ndarray | CameraPlacer | None = None,
    trace: Trace | None = None,
    planner: PathPlanner | None = None,
    robot: RobotDescription | None = None,
) -> EpisodeResult:
    """One object is lifted out of those that stand around it, or picked from a stand and put among them.

    Args:
      scene: all objects; where the target stands in it does not count if it is placed.
      seed: of its turn on the stand, of the motions, noise and proposals.
      places: f64[M, 7], T_world_object, settled poses that are proposed for it, best first, to an arm that
        knows all; or a placer for the scene's bank, which an arm asks that sees the others; None lifts it by
        `mover.LIFT`.
      planner: see `Mover`. robot: the Panda if not given.
    """
    if places is None:
        world = EpisodeWorld(scene, target, (), seed, trace, planner, robot)
        return _run_episode(world, lambda: _lift(world, grasps))
    scene, stand = set_on_stand(scene, target, seed)
    if not isinstance(places, CameraPlacer):
        wanted = matrix_of(places)
        world = EpisodeWorld(scene, target, (stand,), seed, trace, planner, robot)
        return _run_episode(world, lambda: _place(world, grasps, wanted))
    referee = Referee(scene, target, (stand,), trace, robot)
    asset = scene.objects[target]
    known = (referee.execution, asset, scene.poses[target], scene.support, stand, places)
    arm = SensingArm(*known, scene.names[target], seed, planner)
    row = _run_episode(referee, lambda: _place_by_sight(referee, arm, grasps))
    return replace(row, placer=places.name, looks=arm.looks)


def _lift(world: EpisodeWorld, grasps: Grasps) -> None:
    height = world.execution.pose(world.target)[2, 3]
    world.mover.pick(world.mover.find_pick(grasps))
    world.check_others()
    if world.execution.pose(world.target)[2, 3] < height + 0.8 * LIFT:
        raise Failed(Outcome.SLIP, "not lifted")


def _place(world: EpisodeWorld, grasps: Grasps, wanted: np.ndarray) -> None:
    world.mover.pick(world.mover.find_pick(grasps, wanted))
    world.check_others()
    used = world.mover.place(wanted)
    world.put = Put(used, world.mover.put)
    world.check_others()
    world.check_placed()


def _place_by_sight(referee: Referee, arm: SensingArm, grasps: Grasps) -> None:
    mover = arm.pick(grasps)
    referee.check_others()
    referee.check_near(arm.believed, Outcome.SLIP)
    referee.put = Put(*arm.put(mover))
    referee.check_others()
    referee.check_near(referee.put.place, Outcome.UNSTABLE)
    referee.check_placed()


def set_on_stand(scene: Scene, target: int, seed: int) -> tuple[Scene, Box]:
    """The scene with the target on a stand beside the table, somehow turned."""
    stand = stand_beside(scene.support)
    yaw = np.random.default_rng(seed).uniform(-np.pi, np.pi)
    resting = scene.objects[target].resting[0]
    poses = scene.poses.copy()
    poses[target] = pose_on_stand(stand.center, scene.support.top, resting, yaw)
    return replace(scene, poses=poses), stand


def _run_episode(world: Referee, run: Callable[[], None]) -> EpisodeResult:
    begun = time.process_time()
    outcome, detail = run_to_end(run)
    world.moved_others()
    put = world.put
    error, turn_error, z_error = (float("nan"),) * 3 if put is None else world.errors(put.place)
    return EpisodeResult(
        outcome=outcome,
        detail=detail,
        object=world.scene.objects[world.target].name,
        num_others=len(world.scene.names) - 1,
        error=error,
        turn_error=turn_error,
        z_error=z_error,
        displaced=world.displaced,
        proposal=-1 if put is None else put.number,
        seconds=world.execution.num_steps * world.execution.step_time,
        cpu=time.process_time() - begun,
    )
