"""Picking up and putting down: grasps, joints and paths are chosen, then run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import chain, count, product

import numpy as np

from cluttergen_jax.downstream.episodes.outcome import Failed, Outcome, told_motion
from cluttergen_jax.downstream.episodes.progress import LIFT
from cluttergen_jax.downstream.robot.grasping.grasps import Grasps
from cluttergen_jax.downstream.robot.grasping.grips import Grip, rank_grasps
from cluttergen_jax.downstream.robot.motion.collision import ROOM, ROOMS, Mode, PlanningWorld
from cluttergen_jax.downstream.robot.motion.execute import Execution, Phase
from cluttergen_jax.downstream.robot.motion.ik import LINE_STEP, ArmKinematics
from cluttergen_jax.downstream.robot.motion.plan import PickPlan, PlacePlan, Planner
from cluttergen_jax.downstream.robot.protocols import PathPlanner
from cluttergen_jax.downstream.transforms import (
    angle_between,
    inverse,
    matrix_of,
    pose_of,
    raise_by,
    rigid,
    turn_matrix,
)

# Metres that the hand comes straight to an object and leaves it, the first that is free; the latter of
# leaving what has turned in the hand since this was planned.
_APPROACH = (0.10, 0.06)
_LEAVE = (0.10, 0.06, 0.03)

RELEASE = 0.001
"""Metres over where it shall stand at which an object is let go."""
TOUCH = 0.01
"""Metres of lifting and lowering in which an object may touch what it stands on."""
FELT = 0.02
"""The same of lowering where the arm does not see how the object lies in the hand, but feels the touch."""
# How far an object may slip in the hand from the closing of the fingers on.
MAX_SLIP = 0.015
MAX_TURN = np.radians(20)

WIDE = 0.015
"""Metres by which the fingers open wider than they came, if there is room, where poses may be off."""
CARRY_SHARE = 0.25
"""Of the arm's limits, while something is held."""
_LEVEL = 0.05
"""Of the line between the fingers, its z component up to which they open wider."""
GENTLE_SHARE = 0.12
"""The same where it is not seen how what is held swings between the fingers."""
_UP = np.array([0.0, 0.0, 1.0])
_MOST_TURNED = np.radians(60)
"""By which an arm of fewer than six joints turns a grasp about the line between the pads to reach it."""
_ARMS = 3
"""Solutions of the inverse kinematics that are tried for a pose."""
_HEIGHTS = np.arange(TOUCH, LIFT, TOUCH)
"""Metres above a place at which the hand alone is looked at, before the arm's joints for it are sought."""
_PLACES = 4
"""Places that are tried with one grasp."""
_ENDS = (Outcome.NO_GRASP, Outcome.NO_PATH, Outcome.NO_PLACE, Outcome.NO_IK, Outcome.NO_PATH)
"""Why there is no pick, by how far a grasp came: free, left upwards by the hand, for a place, with joints."""
See = Callable[[int | None], np.ndarray]
"""f64[N, 7], T_world_object of a scene's objects as far as they are known; a number asks for one alone."""


class Mover:
    """Moves one object of a scene.

    Args:
      execution: the simulation; world: its copy for planning; target: the object's number.
      seed: of what is drawn; equal seeds do the same.
      rooms: metres that grasps and places need besides (`PlanningWorld.room`), in the order of trying.
      planner: a user's own, for the paths between places.
      feels: how the object lies in the hand is not seen: it is carried gently, lowered until it touches
        something, and let go with the fingers wide open.
      is_apart: what is held keeps `collision.APART` from all else once it is a centimetre above its place; it
        moves a little as the fingers close.
      see: tells where objects are, asked whenever something may have moved; the true poses if not given.
        Nothing else tells the mover.

    Attributes:
      fitting: the number of the place that the last grasp of `find_pick` was found to fit; None if none was.
      put: f64[4, 4], T_world_object where `place` was to put the object last: turned about the vertical where
        an arm of fewer than six joints could not place it otherwise.
    """

    def __init__(
        self,
        execution: Execution,
        world: PlanningWorld,
        kinematics: ArmKinematics,
        target: int,
        seed: int,
        see: See | None = None,
        is_apart: bool = False,
        rooms: Sequence[float] = (0.0,),
        feels: bool = False,
        planner: PathPlanner | None = None,
    ) -> None:
        self.execution = execution
        self.world = world
        self.kinematics = kinematics
        self.target = target
        self._see: See = see or (lambda only: execution.poses())
        self.planner = Planner(world, kinematics, planner)
        self._seeds = count(seed)
        self._above = Mode.APART if is_apart else Mode.CLEAR
        self._rooms = rooms
        self._feels = feels
        self._opening = 0.0
        self._width = 0.0
        self._T_tool_object = np.eye(4)
        self._grasped = np.eye(4)
        self.fitting: int | None = None
        self.put = np.eye(4)
        self._joints: np.ndarray | None = None

    def plan_in(self, world: PlanningWorld) -> None:
        """From now on this is what is known of the world; the object's number in it is the same."""
        self.world = self.planner.world = world

    # Picking up

    def find_pick(self, grasps: Grasps, places: np.ndarray | None = None) -> PickPlan:
        """The first grasp that is free of contact, reached, and left upwards with the object.

        Args:
          places: f64[M, 4, 4], T_world_object where the object shall come; at one of them at least the same
            grasp must be possible too.

        Raises:
          Failed: no grasp, none that fits a place, no joints for one, or no path to one.
        """
        stood = self._survey()
        T_world_object = matrix_of(stood)
        furthest = 0
        is_reached = False
        self.fitting = self._joints = None
        for room, ranked in product(
            self._rooms, rank_grasps(grasps, T_world_object, self.execution.gripper)
        ):
            self.world.room = room
            grip = self._grip_in_reach(ranked, T_world_object)
            if grip is None:
                continue
            is_reached = True
            T_world_tool = T_world_object @ grip.T_object_tool
            opening = grip.opening
            if not self.world.is_hand_free(T_world_tool, opening, Mode.COME):
                continue
            furthest = max(furthest, 1)
            self.world.hold(grip.T_tool_object)
            # Of two fingers that are not level one goes down as they close.
            is_lifted = self.world.is_hand_free(T_world_tool, grip.width / 2, Mode.CARRY)
            is_lifted = is_lifted and self._hand_leaves(T_world_tool, opening)
            self.world.release(stood)
            if not is_lifted:
                continue
            furthest = max(furthest, 2)
            fitting = self._hand_fits(grip.T_tool_object, places, opening, stood)
            if places is not None and not fitting:
                continue
            furthest = max(furthest, 3)
            for joints in self.kinematics.solutions(T_world_tool, _ARMS):
                furthest = 4
                if not self.world.is_free(joints, opening, Mode.COME):
                    continue
                if places is not None and not self._fits(grip, fitting, stood):
                    break
                plan = self._pick_plan(joints, grip, stood, opening, places is not None)
                if plan is not None:
                    return plan
        is_far = len(grasps) > 0 and not is_reached
        raise Failed(Outcome.NO_IK if is_far else _ENDS[furthest], "to pick it up")

    def _grip_in_reach(self, grip: Grip, T_world_object: np.ndarray) -> Grip | None:
        """The grasp as the arm reaches it; None where one of fewer than six joints does not.

        Such an arm may turn the hand about the line between the pads.
        """
        if not self.kinematics.is_short:
            return grip
        wanted = T_world_object @ grip.T_object_tool
        poses = [self.kinematics.tool(q) for q in self.kinematics.solutions(wanted, _ARMS)]
        reached = min(poses, key=lambda pose: float(angle_between(pose, wanted)), default=None)
        if reached is None or angle_between(reached, wanted) > _MOST_TURNED:
            return None
        turned = inverse(wanted) @ reached
        return grip._replace(
            T_object_tool=grip.T_object_tool @ turned,
            T_tool_object=inverse(turned) @ grip.T_tool_object,
        )

    def _place_in_reach(self, place: np.ndarray, T_tool_object: np.ndarray) -> np.ndarray | None:
        """A place f64[4, 4] as the arm reaches it with what it holds; None where it cannot.

        One of fewer than six joints may turn the object about the vertical.
        """
        if not self.kinematics.is_short:
            return place
        target = _tool_at(place, T_tool_object)
        pivot = _upright_at(place, T_tool_object)
        joints = next(self.kinematics.solutions(target, _ARMS, pivot), None)
        if joints is None:
            return None
        turned = self.kinematics.tool(joints) @ T_tool_object @ inverse(place)
        yaw = float(np.arctan2(turned[1, 0], turned[0, 0]))
        return rigid(turn_matrix(yaw)[:3, :3] @ place[:3, :3], place[:3, 3])

    def pick(self, plan: PickPlan) -> None:
        """Runs it: the object is lifted by `LIFT` afterwards.

        Raises:
          Failed: an unplanned contact, or the object was lost.
        """
        run = self.execution
        self._opening = plan.grip.opening
        self._width = plan.grip.width
        run.move_fingers(self._opening, Phase.FREE, 0.2)
        run.follow(plan.path, Phase.FREE)
        run.follow(plan.come, Phase.FREE, CARRY_SHARE)
        run.wait(0.1, Phase.FREE)
        run.close()
        self._grasped = before = self._in_hand()
        first, rest = self.kinematics.split(plan.lift, TOUCH)
        run.follow(first, Phase.TOUCH, CARRY_SHARE)
        self._carry(rest, before)

    def _hand_fits(
        self,
        T_tool_object: np.ndarray,
        places: np.ndarray | None,
        opening: float,
        stood: np.ndarray,
    ) -> dict[int, np.ndarray]:
        """The first few of the places where the hand alone could put the object down from above."""
        found: dict[int, np.ndarray] = {}
        self.world.hold(T_tool_object)
        for number, wanted in enumerate(() if places is None else places):
            place = self._place_in_reach(wanted, T_tool_object)
            if place is None:
                continue
            target = _tool_at(place, T_tool_object)
            top = raise_by(target, LIFT)
            if self._hand_leaves(target, opening) and self.world.is_hand_free(
                top, opening, Mode.TRAVEL
            ):
                found[number] = place
            if len(found) == _PLACES:
                break
        self.world.release(stood)
        return found

    def _hand_leaves(self, T_world_tool: np.ndarray, opening: float) -> bool:
        """Whether the hand alone, with what it holds, gets straight up from there."""
        looks = [(0.0, Mode.CARRY), *((height, self._above) for height in _HEIGHTS)]
        return all(
            self.world.is_hand_free(raise_by(T_world_tool, up), opening, mode) for up, mode in looks
        )

    def _fits(self, grip: Grip, places: dict[int, np.ndarray], stood: np.ndarray) -> bool:
        """Whether the arm can put the object down at one of some places, and leave it there; keeps how."""
        try:
            for number, place in places.items():
                target = _tool_at(place, grip.T_tool_object)
                for joints in self.kinematics.solutions(target, _ARMS):
                    if self._lowering(joints, place, grip) is not None:
                        self.fitting = number
                        self._joints = joints
                        return True
            return False
        finally:
            self.world.release(stood)

    def _pick_plan(
        self, joints: np.ndarray, grip: Grip, stood: np.ndarray, opening: float, is_high: bool
    ) -> PickPlan | None:
        back = self._back(joints, matrix_of(stood) @ grip.T_object_tool, opening)
        if back is None:
            return None
        # The fingers turn an object as they close.
        self.world.hold(grip.T_tool_object)
        lifts = (self._lifting(joints, opening, height) for height in (LIFT, 2 * LIFT))
        # What lies around something tall must be lifted off it before it can go anywhere.
        lift = next(
            (each for each in lifts if each is not None and self.world.is_free(each[-1], opening)),
            None,
        )
        if lift is None and not is_high:
            lift = self._lifting(joints, opening)
        self.world.release(stood)
        if lift is None:
            return None
        path = self.planner.connect(self.execution.set_point, back[-1], opening, next(self._seeds))
        return None if path is None else PickPlan(grip, path, back[::-1], lift)

    # Putting down

    def place(self, places: np.ndarray) -> int:
        """Puts down what is held at the first of places f64[M, 4, 4] (T_world_object) that works, says which.

        Raises:
          Failed: none is reached, an unplanned contact, or the object slipped.
        """
        rooms = [room for room in ROOMS if room <= self.world.room]
        for room, (number, wanted) in product(rooms, enumerate(places)):
            self.world.room = room
            place = self._place_in_reach(wanted, self._T_tool_object)
            if place is not None and (found := self._place_plan(place)) is not None:
                self.put = place
                self._carry(found.path, self._T_tool_object)
                lower = self._correct_lowering(found.lower, place)
                # What hangs askew and cannot be levelled is lowered until it is felt to touch.
                way, feels = (found.lower, True) if lower is None else (lower, self._feels)
                self._put_down(way, found.leave, place, feels)
                return number
        raise Failed(Outcome.NO_PATH, "to put it down")

    def _place_plan(self, place: np.ndarray) -> PlacePlan | None:
        """How what is held comes to a place and the hand away, if it can by joints as they were planned."""
        target = _tool_at(place, self._T_tool_object)
        known = [] if self._joints is None else [self.kinematics.solve(target, self._joints)]
        for joints in chain(known, self.kinematics.solutions(target, 2 * _ARMS)):
            found = None if joints is None else self._lowering(joints, place)
            if found is None:
                continue
            self.world.hold(self._T_tool_object)
            asked = self.execution.set_point, found[0][-1], self._opening, next(self._seeds)
            path = self.planner.connect(*asked, up=place[2, :3])
            if path is not None:
                return PlacePlan(path, found[0][::-1], found[1])
        return None

    def _lowering(
        self, joints: np.ndarray, place: np.ndarray, planned: Grip | None = None
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Joints f64[L, n] straight up from a place with what is held or planned, and off it."""
        T_tool_object = self._T_tool_object if planned is None else planned.T_tool_object
        opening = self._opening if planned is None else planned.opening
        self.world.hold(T_tool_object)
        # A line costs a hundred times as much as one look.
        if not self.world.is_free(joints, opening, Mode.CARRY):
            return None
        lift = self._lifting(joints, opening)
        if lift is None or not self.world.is_free(lift[-1], opening):
            return None
        self.world.release(pose_of(place))
        distances = _LEAVE if planned is None else _APPROACH
        aside = self._aside(joints, self._width if planned is None else planned.width)
        if aside is None:
            return None
        leave = self._back(aside[-1], _tool_at(place, T_tool_object), opening, distances)
        return None if leave is None else (lift, leave)

    def _aside(self, joints: np.ndarray, width: float) -> np.ndarray | None:
        """Joints f64[L, n] that move an open hand aside, so that its still pad no longer touches the object.

        The hand then is about the object as it came to it. One row for a hand whose pads move alike; None
        where the arm cannot follow the line.
        """
        gripper = self.execution.gripper
        if gripper.is_even:
            return joints[None]
        shift = gripper.side_of(width) - gripper.shift_of(width)
        return self.kinematics.line(joints, shift * self.kinematics.tool(joints)[:3, 1])

    def put_back(self, plan: PickPlan) -> None:
        """Puts what has just been picked up back where it stood, the way it came.

        Raises:
          Failed: an unplanned contact, or the object slipped.
        """
        place = self.kinematics.tool(plan.lift[0]) @ self._T_tool_object
        self._put_down(plan.lift[::-1], plan.come[::-1], place, self._feels)

    def _put_down(
        self, lower: np.ndarray, leave: np.ndarray, place: np.ndarray, feels: bool
    ) -> None:
        """Lowers what is held, at the end until it touches if it feels, opens the hand, and leaves."""
        run = self.execution
        upper, last = self.kinematics.split(lower, FELT if feels else TOUCH, from_end=True)
        if not feels:
            self._carry(upper, self._T_tool_object, rest=0.0)
        elif run.follow(upper, Phase.TOUCH, GENTLE_SHARE, until_touch=True):
            self._rise(self.kinematics.tool(upper[0])[2, 3] - run.tool[2, 3], Phase.TOUCH)
            raise Failed(Outcome.SLIP, "it touched something too early")
        run.follow(last, Phase.TOUCH, CARRY_SHARE / 2, feels)
        run.wait(0.2, Phase.TOUCH)
        self._in_hand()
        if feels:
            self._opening = self._widest(leave, place)
        run.move_fingers(self._opening, Phase.TOUCH)
        aside = self._aside(run.set_point, self._width)
        if aside is not None and len(aside) > 1:
            run.follow(aside, Phase.GRASP, CARRY_SHARE)
        begin, end = (self.kinematics.tool(leave[each])[:3, 3] for each in (0, -1))
        line = self.kinematics.line(run.set_point, end - begin)
        first, rest = self.kinematics.split(leave if line is None else line, TOUCH)
        run.follow(first, Phase.GRASP, CARRY_SHARE)
        # What hung askew rocks: the fingers may brush it until they are clear of it.
        run.follow(rest, Phase.GRASP if feels else Phase.FREE)

    def _widest(self, leave: np.ndarray, place: np.ndarray) -> float:
        """How far the fingers can open and leave: what hung askew between them rocks as it is let go."""
        self.world.release(pose_of(place))
        needed, self.world.room = self.world.room, ROOM
        run = self.execution
        wide = min(run.gripper.max_opening, self._opening + WIDE)
        axis = run.tool[:3, 1]
        # One of two fingers that are not level goes down as they open.
        looks = leave[:: len(leave) // 6 or 1]
        is_free = abs(axis[2]) < _LEVEL and all(
            self.world.is_free(q, wide, Mode.COME) for q in looks
        )
        self.world.room = needed
        return wide if is_free else self._opening

    def _correct_lowering(self, lower: np.ndarray, place: np.ndarray) -> np.ndarray | None:
        """The path down with the object as it really lies in the hand; None if the arm cannot go it."""
        start = self.kinematics.solve(
            raise_by(_tool_at(place, self._T_tool_object), LIFT),
            lower[0],
            _upright_at(place, self._T_tool_object),
        )
        path = None if start is None else self.kinematics.line(start, -LIFT * _UP)
        self.world.hold(self._T_tool_object)
        if path is None or not self.world.is_free(path[-1], self._opening, Mode.CARRY):
            return None
        return np.concatenate([self.execution.set_point[None], path])

    def has_lost(self, distance: float) -> bool:
        """Whether the object is more than so many metres from where it was in the hand as it closed."""
        return float(np.linalg.norm((self._in_hand() @ inverse(self._grasped))[:3, 3])) > distance

    def let_go(self) -> None:
        """Opens the hand where it is, with whatever is in it, and goes up."""
        self.execution.move_fingers(self._opening, Phase.TOUCH)
        self._rise(LIFT, Phase.GRASP)

    def _rise(self, height: float, phase: Phase) -> None:
        run = self.execution
        path = self.kinematics.line(run.set_point, height * _UP)
        if path is not None:
            run.follow(path, phase, CARRY_SHARE)

    def go_home(self) -> bool:
        """Brings the empty hand back to where it starts; whether there was a path."""
        self.world.release(self._see(self.target)[self.target])
        self.world.room = 0.0
        run = self.execution
        home = self.kinematics.home
        path = self.planner.connect(run.set_point, home, self._opening, next(self._seeds))
        if path is not None:
            run.follow(path, Phase.FREE)
        return path is not None

    # What both need

    def _lifting(
        self, joints: np.ndarray, opening: float, height: float = LIFT
    ) -> np.ndarray | None:
        """Joints f64[L, n] straight up with what is held."""
        path = self.planner.line(joints, height * _UP, opening, Mode.CARRY)
        if path is None:
            return None
        above = path[round(TOUCH / LINE_STEP) :: 3]
        return (
            path if all(self.world.is_free(each, opening, self._above) for each in above) else None
        )

    def _back(
        self,
        joints: np.ndarray,
        tool: np.ndarray,
        opening: float,
        distances: Sequence[float] = _APPROACH,
    ) -> np.ndarray | None:
        """Joints along a straight line out of a grasp at f64[4, 4]."""
        for distance in distances:
            path = self.planner.line(joints, -distance * tool[:3, 2], opening, Mode.COME)
            if path is not None and self.world.is_free(path[-1], opening):
                return path
        return None

    def _survey(self) -> np.ndarray:
        """Objects stand in the copy for planning where they are seen; f64[7] of the target."""
        poses = self._see(None)
        for number, pose in enumerate(poses):
            if number != self.target:
                self.world.move(number, pose)
        self.world.release(poses[self.target])
        return poses[self.target]

    def _in_hand(self) -> np.ndarray:
        self._T_tool_object = inverse(self.execution.tool) @ matrix_of(
            self._see(self.target)[self.target]
        )
        return self._T_tool_object

    def _carry(self, path: np.ndarray, before: np.ndarray, rest: float = 0.2) -> None:
        """Moves what is held; where it touches something because it slipped, the slip is the cause."""
        try:
            share = GENTLE_SHARE if self._feels else CARRY_SHARE
            self.execution.follow(path, Phase.CARRY, share)
            self.execution.wait(rest, Phase.CARRY)
        except Failed:
            self._check_slip(before, TOUCH / 2)
            raise
        self._check_slip(before)

    def _check_slip(self, before: np.ndarray, most: float = MAX_SLIP) -> None:
        now = self._in_hand()
        # Of the object's point that was between the fingers.
        moved = float(np.linalg.norm((now @ inverse(before))[:3, 3]))
        turned = float(angle_between(now, before))
        if moved > most or turned > MAX_TURN:
            raise Failed(Outcome.SLIP, told_motion(moved, turned))


def _tool_at(place: np.ndarray, T_tool_object: np.ndarray) -> np.ndarray:
    """f64[4, 4]: T_world_tool that holds an object just above a place."""
    return raise_by(place, RELEASE) @ inverse(T_tool_object)


def _upright_at(place: np.ndarray, T_tool_object: np.ndarray) -> np.ndarray:
    """f64[4, 4]: T_tool_pivot of a frame in the middle of what is held, its z up where the place is."""
    return T_tool_object @ rigid(place[:3, :3].T, np.zeros(3))
