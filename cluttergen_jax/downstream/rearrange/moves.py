"""Moves: one object after another is picked up and put down by what is seen of it; each time is counted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cluttergen_jax.downstream.rearrange.judge import RearrangementJudge
from cluttergen_jax.downstream.rearrange.observe import Cause, ObjectTracker
from cluttergen_jax.downstream.robot.grasping.grasps import Grasps
from cluttergen_jax.downstream.robot.model import base_pose
from cluttergen_jax.downstream.robot.motion.collision import ROOMS, PlanningWorld
from cluttergen_jax.downstream.robot.motion.execute import Execution, Phase
from cluttergen_jax.downstream.robot.motion.ik import ArmKinematics
from cluttergen_jax.downstream.robot.motion.mover import Mover
from cluttergen_jax.downstream.robot.motion.plan import PickPlan
from cluttergen_jax.downstream.robot.outcome import Failed, Outcome
from cluttergen_jax.downstream.robot.protocols import PathPlanner
from cluttergen_jax.downstream.transforms import matrix_of
from cluttergen_jax.scene import Scene

MAX_RETRIES = 2
"""Times an object is picked up again because it was lost, or is not where it was put."""
MAX_BACKS = 6
"""Times in an episode that what was picked up and finds no place is brought back to where it was."""
_CARE = (*((True, room) for room in ROOMS), (False, 0.0))
"""How a move is planned, the most careful way first: `is_apart` of `Mover`, and its room."""
_IN_HAND = 0.06
"""Metres that an object may have slipped and still be carried on."""


class Moves:
    """Moves objects of a scene, looks after each move, and counts.

    Args:
      scene: N objects as they stood at the start. grasps: of each.
      execution: the simulation; sight: what is known of it; judge: is told before and after each move.
      rng: draws what is drawn. planner: a user's own (`Mover`).

    Attributes:
      base: f64[7], T_world_base of the arm. kinematics: its own.
      picks, waits, retries: of `RearrangeResult`.
      homed, waited: i[N], how often each was picked up for its place and to wait, since `forget`.
      why: the last cause for which there was no way.
    """

    def __init__(
        self,
        scene: Scene,
        grasps: Sequence[Grasps],
        execution: Execution,
        sight: ObjectTracker,
        judge: RearrangementJudge,
        rng: np.random.Generator,
        planner: PathPlanner | None = None,
    ) -> None:
        self._scene = scene
        self._grasps = grasps
        self._rng = rng
        self._planner = planner
        self._execution = execution
        self._sight = sight
        self._judge = judge
        self.base = base_pose(scene.support, execution.robot)
        self.kinematics = ArmKinematics(self.base, execution.robot)
        self.picks = self.waits = self.retries = self._backs = 0
        self.why = Failed(Cause.NO_ORDER)
        self.forget()

    def forget(self) -> None:
        """What is counted for each object is counted anew."""
        self.homed, self.waited = np.zeros((2, len(self._scene.names)), int)

    def look(self, is_home: bool = True) -> None:
        """Looks for all: with the hand over the table, then drawn back out of the other camera's way."""
        if is_home:
            self._sight.glance()
            run = self._execution
            drawn_back = np.array(run.robot.arm.drawn_back)
            run.follow(run.motion_along(np.linspace(run.set_point, drawn_back, 8)), Phase.FREE)
            run.wait(0.2, Phase.FREE)
        self._sight()

    def first(
        self, numbers: Sequence[int], places: Sequence[np.ndarray], *, is_wait: bool = False
    ) -> bool:
        """Brings the first of objects for which there is a way to one of its places; False if there is none.

        The most careful way of any of them comes first: where all goes with room to spare, nothing brushes
        its neighbours.

        Args:
          numbers: n objects. places: of each f64[M, 4, 4], T_world_object. is_wait: it shall come home later.

        Raises:
          Failed: something went wrong that cannot be mended.
        """
        return any(
            self._move(k, where, care, is_wait)
            for care in _CARE
            for k, where in zip(numbers, places, strict=True)
            if len(where)
        )

    def _move(self, k: int, places: np.ndarray, care: tuple[bool, float], is_wait: bool) -> bool:
        """Brings an object to one of places f64[M, 4, 4]; False if there is no way: it is where it was."""
        scene = self._scene
        stood = matrix_of(self._sight.poses[k])
        known = (scene.names, scene.objects, self._sight.poses)
        world = PlanningWorld(*known, k, scene.support, self.base, robot=self._execution.robot)
        seed = int(self._rng.integers(2**30))
        feels = not self._sight.sees_held
        is_apart, room = care
        ways = (self._sight, is_apart, (room,), feels, self._planner)
        mover = Mover(self._execution, world, self.kinematics, k, seed, *ways)
        try:
            plan = mover.find_pick(self._grasps[k], places)
        except Failed as failure:
            self.why = Failed(failure.outcome, f"{scene.names[k]} {failure.detail}")
            return False
        self._count(k, is_wait)
        self._execution.aim_at(k)
        self._sight.take(k, plan.grip.T_tool_object)
        self._judge.begin_move()
        is_back = self._carry(mover, plan, np.concatenate([places, stood[None]])) == len(places)
        self.look(is_home=mover.go_home())
        self._judge.check_others(k)
        if is_back:
            # It counts as a pick, and as nothing else.
            (self.waited if is_wait else self.homed)[k] -= 1
            self.waits -= is_wait
            self.retries -= not is_wait and bool(self.homed[k])
            self._backs += 1
            self.why = Failed(Outcome.NO_PATH, f"{scene.names[k]} from above where it was")
            if self._backs >= MAX_BACKS:
                raise self.why
        return not is_back

    def _carry(self, mover: Mover, plan: PickPlan, places: np.ndarray) -> int | None:
        """Picks up and puts down; an object that slipped is put down as it lies in the hand, or lost.

        Returns:
          At which place it was put down; None of one that slipped.
        """
        try:
            mover.pick(plan)
        except Failed as failure:
            if failure.outcome != Outcome.SLIP:
                raise
        if mover.has_lost(_IN_HAND):
            mover.let_go()
            return None
        try:
            return self._put(mover, plan, places)
        except Failed as failure:
            if failure.outcome != Outcome.SLIP:
                raise
            mover.let_go()
            return None

    def _put(self, mover: Mover, plan: PickPlan, places: np.ndarray) -> int:
        """Puts down what is held at one of places, the last of which is where it was, and says at which."""
        slipped = None
        last = len(places) - 1
        for part, first in ((places[:last], 0), (places[last:], last)):
            try:
                return first + mover.place(part)
            except Failed as failure:
                if (
                    failure.outcome == Outcome.SLIP
                    and slipped is None
                    and not mover.has_lost(_IN_HAND)
                ):
                    slipped = failure
                elif failure.outcome != Outcome.NO_PATH:
                    raise
        if slipped is not None:
            # The hand is no longer where it took the object.
            raise slipped
        mover.put_back(plan)
        return last

    def _count(self, k: int, is_wait: bool) -> None:
        """Counts a pick. Raises Failed: it is one too many."""
        is_retry = not is_wait and bool(self.homed[k])
        if is_retry and self.homed[k] > MAX_RETRIES:
            raise Failed(Cause.MISPLACED, f"{self._scene.names[k]} after {MAX_RETRIES} retries")
        self.picks += 1
        self.waits += is_wait
        self.retries += is_retry
        (self.waited if is_wait else self.homed)[k] += 1
