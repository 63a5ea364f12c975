"""Motion planning: paths of the joints by RRT-Connect and shortcuts, and time laws for them (toppra)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from cluttergen_jax.downstream.robot.grasping.grips import Grip
from cluttergen_jax.downstream.robot.motion.collision import Mode, PlanningWorld
from cluttergen_jax.downstream.robot.motion.ik import ArmKinematics, import_extra
from cluttergen_jax.downstream.robot.protocols import PathPlanner, PathQuery
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.own_parts import array_of, part_name

MOST_CHECKS = 15_000
"""Collision queries after which a search is given up; time would depend on the machine."""
CHECKED_STEP = 0.00625
"""Radians between two states of an edge that are looked at: 5 mm of the tool at 0.8 m from an axis."""
MAX_TILT = float(np.radians(30))
"""Radians by which what is carried leans at most, where there is a way to keep it up."""
_COARSE = 16
_ATTEMPTS = 4
_NEXT_SEED = 7919
IsFree = Callable[[np.ndarray], bool]
_SHORTCUTS = 100
_BEND_STEPS = 2


class PickPlan(NamedTuple):
    """How an object is picked up.

    Attributes:
      grip: how the hand holds it.
      path: f64[L, n], joints, to before the object; come: f64[L, n], from there to it; lift: f64[L, n].
    """

    grip: Grip
    path: np.ndarray
    come: np.ndarray
    lift: np.ndarray


class PlacePlan(NamedTuple):
    """How what is held is placed.

    Attributes:
      path: f64[L, n], joints, to above the place; lower: f64[L, n]; leave: f64[L, n], out of the hand.
    """

    path: np.ndarray
    lower: np.ndarray
    leave: np.ndarray


class Planner:
    """Finds paths for the arm in one world; world: what stands there; kinematics: of the arm.

    Args:
      own: a user's planner, which finds the paths between places in place of RRT-Connect.
    """

    def __init__(
        self, world: PlanningWorld, kinematics: ArmKinematics, own: PathPlanner | None = None
    ) -> None:
        self._own = own
        names = ("base", "geometric", "util")
        parts: list[Any] = [import_extra(f"ompl.{name}", "motion planning") for name in names]
        self._ob, self._og, self._util = parts
        # It prints what it does, and it warns of each new seed.
        self._util.setLogLevel(self._util.LogLevel.LOG_NONE)
        self.world = world
        self.kinematics = kinematics

    def connect(
        self,
        start: np.ndarray,
        goal: np.ndarray,
        opening: float,
        seed: int,
        mode: Mode = Mode.TRAVEL,
        up: np.ndarray | None = None,
    ) -> np.ndarray | None:
        """Joints f64[L, n] from `start` to `goal`, bent smoothly; None where no path was found.

        The straight one where it is free. Equal seeds give equal paths.

        Args:
          up: f64[3], what of what is held shall point up, to within `MAX_TILT`, if there is such a path.
        """
        if not all(self.world.is_free(joints, opening, mode) for joints in (start, goal)):
            return None
        if self._own is not None:
            return self._ask(self._own, start, goal, opening, seed, mode)
        is_free = partial(self.world.is_free, opening=opening, mode=mode)
        ways: list[IsFree] = [is_free]
        if up is not None:
            ways.insert(0, lambda joints: is_free(joints) and self.world.tilt(up) <= MAX_TILT)
        found = (self._shortest(start, goal, is_good, seed) for is_good in ways)
        return next((path for path in found if path is not None), None)

    def _shortest(
        self, start: np.ndarray, goal: np.ndarray, is_free: IsFree, seed: int
    ) -> np.ndarray | None:
        """The straight path if it is free, else of some that are found that on which the tool goes least."""
        # OMPL waits for ever for a goal that it may not reach.
        if not (is_free(start) and is_free(goal)):
            return None
        number = max(1, int(np.linalg.norm(goal - start) / (CHECKED_STEP * _COARSE)))
        straight = np.linspace(start, goal, number * _COARSE + 1)
        # What is in the way is mostly found by a few looks.
        if all(map(is_free, straight[::_COARSE])) and all(map(is_free, straight)):
            return straight[::_COARSE] if number > 1 else straight
        found: list[np.ndarray] = []
        for attempt in range(_ATTEMPTS):
            path = self._search(start, goal, is_free, seed + attempt * _NEXT_SEED)
            if path is None:
                break
            found.append(path)
        return min(found, key=self._tool_way, default=None)

    def _tool_way(self, path: np.ndarray) -> float:
        """Metres that the tool goes."""
        tool = np.array([self.kinematics.tool(joints)[:3, 3] for joints in path])
        return float(np.linalg.norm(np.diff(tool, axis=0), axis=1).sum())

    def _search(
        self, start: np.ndarray, goal: np.ndarray, is_free: IsFree, seed: int
    ) -> np.ndarray | None:
        self._util.RNG.setSeed(seed + 1)
        space = self._space()
        setup = self._og.SimpleSetup(space)
        last = self.world.num_checks + MOST_CHECKS
        setup.setStateValidityChecker(lambda state: is_free(self._joints(state)))
        information = setup.getSpaceInformation()
        information.setStateValidityCheckingResolution(CHECKED_STEP / space.getMaximumExtent())
        setup.setStartAndGoalStates(self._state(space, start), self._state(space, goal))
        planner = self._og.RRTConnect(information)
        setup.setPlanner(planner)
        setup.setup()
        stop = self._ob.PlannerTerminationCondition(lambda: self.world.num_checks > last)
        setup.solve(stop)
        if not setup.haveExactSolutionPath():
            return None
        path = setup.getSolutionPath()
        simplifier = self._og.PathSimplifier(information)
        simplifier.reduceVertices(path, _SHORTCUTS)
        simplifier.partialShortcutPath(path, _SHORTCUTS)
        simplifier.smoothBSpline(path, _BEND_STEPS)
        return np.stack([self._joints(state) for state in path.getStates()])

    def _ask(
        self,
        own: PathPlanner,
        start: np.ndarray,
        goal: np.ndarray,
        opening: float,
        seed: int,
        mode: Mode,
    ) -> np.ndarray | None:
        """What a user's planner finds. Raises ConfigError: it is no path."""
        path = own(
            PathQuery(
                start.copy(),
                goal.copy(),
                self.kinematics.low,
                self.kinematics.high,
                seed,
                lambda joints: self.world.is_free(np.asarray(joints, np.float64), opening, mode),
                self.kinematics.tool,
            )
        )
        if path is None:
            return None
        found = array_of(path)
        if fault := _path_fault(found, start, goal):
            raise ConfigError(
                f"planner {part_name(own)!r} returned {fault}",
                f"f[L, {len(start)}] of finite numbers from start to goal, L at least 2, or None",
            )
        return found.astype(np.float64)

    def line(
        self, start: np.ndarray, along: np.ndarray, opening: float, mode: Mode
    ) -> np.ndarray | None:
        """Joints f64[L, n] on a straight line of the tool (`ArmKinematics.line`), or None.

        A third of its points are looked at, and both ends.
        """
        path = self.kinematics.line(start, along)
        if path is None:
            return None
        looked = {*range(0, len(path), 3), len(path) - 1}
        return (
            path
            if all(self.world.is_free(path[k], opening, mode) for k in sorted(looked))
            else None
        )

    def _space(self) -> Any:
        number = len(self.kinematics.low)
        space = self._ob.RealVectorStateSpace(number)
        bounds = self._ob.RealVectorBounds(number)
        for joint in range(number):
            bounds.setLow(joint, float(self.kinematics.low[joint]))
            bounds.setHigh(joint, float(self.kinematics.high[joint]))
        space.setBounds(bounds)
        return space

    @staticmethod
    def _state(space: Any, joints: np.ndarray) -> Any:
        state = space.allocState()
        for joint, angle in enumerate(joints):
            state[joint] = float(angle)
        return state

    def _joints(self, state: Any) -> np.ndarray:
        return np.array([state[joint] for joint in range(len(self.kinematics.low))])


SHARE = 0.5
"""Of an arm's limits of speed and acceleration that is used."""
_STILL = 1e-6
_LEAST_STEP = 0.03
# Radians between two points of a path that its spline goes through, and how many there are at least.
_LEAST_POINTS = 5
_LEAST_GRID = 100


class Trajectory(NamedTuple):
    """T steps of a motion; joints: f64[T, n], radians; speed: f64[T, n], rad/s."""

    joints: np.ndarray
    speed: np.ndarray


def time_path(
    path: np.ndarray,
    step: float,
    max_speed: Sequence[float],
    max_acceleration: Sequence[float],
    share: float = SHARE,
) -> Trajectory:
    """The fastest motion along joints f64[L, n] within a share of the limits, from rest to rest.

    Args:
      step: seconds between two points of the result.
      max_speed, max_acceleration: n limits, rad/s and rad/s^2.

    Raises:
      MissingExtraError: the extra `robot` is not installed.
    """
    toppra = import_extra("toppra", "time laws of motions")
    algorithm = import_extra("toppra.algorithm", "time laws of motions")
    constraint = import_extra("toppra.constraint", "time laws of motions")
    toppra.setup_logging("ERROR")
    if np.abs(np.ptp(path, axis=0)).max() < _STILL:
        return Trajectory(np.asarray(path)[-1:], np.zeros((1, path.shape[1])))
    points = thin_path(path)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    path = toppra.SplineInterpolator(length, points, bc_type="natural")
    speed, acceleration = (
        np.array([[-most, most] for most in each]) for each in (max_speed, max_acceleration)
    )
    limits = [
        constraint.JointVelocityConstraint(speed * share),
        constraint.JointAccelerationConstraint(acceleration * share),
    ]
    grid = np.linspace(0, length[-1], max(_LEAST_GRID, 8 * len(points)))
    law = algorithm.TOPPRA(limits, path, gridpoints=grid, parametrizer="ParametrizeConstAccel")
    motion = law.compute_trajectory(0, 0)
    times = np.append(np.arange(0, motion.duration, step), motion.duration)
    return Trajectory(motion(times), motion(times, 1))


def thin_path(path: np.ndarray) -> np.ndarray:
    """Points of a path, the ends included, as far apart as a spline wants them; at least `_LEAST_POINTS`."""
    path = np.asarray(path, np.float64)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    kept = [0]
    for k in range(1, len(path) - 1):
        if min(length[k] - length[kept[-1]], length[-1] - length[k]) >= _LEAST_STEP:
            kept.append(k)
    at = length[[*kept, len(path) - 1]]
    if len(at) < _LEAST_POINTS:
        at = np.linspace(0, length[-1], _LEAST_POINTS)
    return np.stack([np.interp(at, length, joint) for joint in path.T], axis=1)


def _path_fault(found: np.ndarray, start: np.ndarray, goal: np.ndarray) -> str:
    """What is wrong with a path from start to goal, f[n] each; empty if nothing is."""
    if (
        found.ndim != 2
        or found.shape[1] != len(start)
        or len(found) < 2
        or found.dtype.kind not in "fiu"
    ):
        return f"an array of {found.dtype}, shape {found.shape}"
    if not np.isfinite(found).all():
        return f"an array of shape {found.shape} with numbers that are not finite"
    for row, end, name in ((found[0], start, "start"), (found[-1], goal, "goal")):
        if (off := abs(row - end).max()) > 1e-4:
            return f"a path that {'begins' if name == 'start' else 'ends'} {off:.3g} rad off the {name}"
    return ""
