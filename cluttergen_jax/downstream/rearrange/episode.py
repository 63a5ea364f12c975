"""Episodes of rearrangement: see, choose a layout, find an order, move one object after another, look."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from cluttergen_jax.downstream.perception.symmetry import equal_places, offset
from cluttergen_jax.downstream.rearrange.judge import MAX_ERROR, Judge
from cluttergen_jax.downstream.rearrange.layouts import ROOM, Layouts, clearance_of, reach_of, roomy, unlike
from cluttergen_jax.downstream.rearrange.observe import Cause, EpisodeView, ObjectTracker, Observer
from cluttergen_jax.downstream.rearrange.order import Meetings, lowest_first, ready, smallest_waiting
from cluttergen_jax.downstream.rearrange.settings import AREA, RearrangeOptions
from cluttergen_jax.downstream.rearrange.task import Chooser, RearrangeResult, RearrangeTask
from cluttergen_jax.downstream.robot.cameras import DRAWN_BACK
from cluttergen_jax.downstream.robot.collision import PlanningWorld
from cluttergen_jax.downstream.robot.execute import Execution, Phase, Trace
from cluttergen_jax.downstream.robot.frames import matrix_of
from cluttergen_jax.downstream.robot.grasps import Grasps
from cluttergen_jax.downstream.robot.grips import first_grasp
from cluttergen_jax.downstream.robot.ik import ArmKinematics
from cluttergen_jax.downstream.robot.model import base_pose
from cluttergen_jax.downstream.robot.mover import Mover
from cluttergen_jax.downstream.robot.outcome import Failed, Outcome
from cluttergen_jax.downstream.robot.plan import PickPlan
from cluttergen_jax.downstream.robot.timing import timed

NEAR_GOAL, NEAR_GOAL_TURN = 0.01, float(np.radians(10))
"""Metres and radians from its place within which an object counts as brought there."""
MAX_RETRIES = 2
"""Times an object is picked up again because it was lost, or is not where it was put."""
MAX_WAITS = 2
"""Times an object is put down somewhere else on its way."""
MAX_BACKS = 6
"""Times in an episode that what was picked up and finds no place is brought back to where it was."""
MAX_LAYOUTS = 3
"""Layouts that are tried one after another where there is no way to the one before."""
_DRAWS = 4
"""Times that layouts are drawn, until as many have room as may be tried."""
_CARE = ((True, True), (True, False), (False, False))
"""How a move is planned, the most careful way first: `is_apart` of `Mover`, and whether it needs `ROOM`."""
_PLACES = 12
_IN_HAND = 0.06
"""Metres that an object may have slipped and still be carried on."""


class Rearranger:
    """Brings objects into a layout, by what is seen of them and the arm's motors alone.

    Args:
      task: what; options: how.
      execution: the simulation; sight: what is known of it; judge: is told before and after each move.
      ask: chooses in place of the rule.

    Attributes:
      picks, fewest, waits, retries, layouts, layout: of `RearrangeResult`.
      goals: f64[N, 7], the layout that was tried last.
    """

    def __init__(
        self,
        task: RearrangeTask,
        options: RearrangeOptions,
        execution: Execution,
        sight: ObjectTracker,
        judge: Judge,
        ask: Chooser | None = None,
    ) -> None:
        self._task, self._options, self._scene, self._ask = task, options, task.scene, ask
        self._execution, self._sight, self._judge = execution, sight, judge
        self._symmetry = task.symmetry
        self._base = base_pose(task.scene.support)
        self._kinematics = ArmKinematics(self._base)
        self._meetings = Meetings(task.scene.objects)
        self._num_moved = task.setting.num_objects
        self._rng = np.random.default_rng(task.seed)
        self.picks = self.fewest = self.waits = self.retries = self.layouts = 0
        self._times, self._backs = np.zeros((2, len(task.scene.names)), int), 0
        self._why = Failed(Cause.NO_ORDER)
        self.goals, self.layout = task.scene.poses, -1

    def run(self) -> None:
        """Until all objects are in one of the layouts.

        Raises:
          Failed: no layout could be reached, or something went wrong.
        """
        found = self.find_layouts()
        for number in self._chosen(found)[:MAX_LAYOUTS]:
            self.layouts += 1
            self._times[:] = 0
            self.goals, self.layout = found.poses[number], number
            if self._reach_layout(self.goals):
                return
        raise self._why

    def find_layouts(self) -> Layouts:
        """Looks, and draws unlike layouts around the objects that stay, as they are seen.

        Raises:
          Failed: none stands, or an object was never seen.
        """
        self._look()
        task, num_moved, poses = self._task, self._num_moved, self._sight.poses
        moved, stay = task.numbers[:num_moved], task.numbers[num_moved:]
        objects, region = self._scene.objects, task.setting.target
        full, clearance = np.zeros((0, len(poses), 7)), np.zeros(0)
        for draw in range(_DRAWS):
            drawn = task.draw(task.seed + draw, moved, region, stay, poses[num_moved:])
            others = np.broadcast_to(poses[num_moved:], (len(drawn), len(stay), 7))
            more = np.concatenate([drawn, others], axis=1)
            gaps = [clearance_of(objects, each, num_moved) for each in more]
            full, clearance = np.concatenate([full, more]), np.concatenate([clearance, gaps])
            if (clearance >= ROOM).sum() >= MAX_LAYOUTS:
                break
        if not len(full):
            raise Failed(Cause.NO_LAYOUT)
        drawn = full[:, :num_moved]
        kept = roomy(clearance, 2 * self._options.num_layouts)
        kept = kept[unlike(objects[:num_moved], drawn[kept], region, self._options.num_layouts)]
        drawn, full = drawn[kept], full[kept]
        all_moved, support = range(num_moved), self._scene.support
        return Layouts(
            poses=full,
            clearance=clearance[kept],
            reach=np.array(
                [reach_of(objects, each, all_moved, task.grasps, support, self._kinematics) for each in full]
            ),
            travel=np.linalg.norm(full[:, :num_moved, :2] - poses[:num_moved, :2], axis=-1).mean(1),
        )

    def _look(self, is_home: bool = True) -> None:
        """Looks for all objects: with the hand over the table, then drawn back out of the other camera's way.

        Raises:
          Failed: an object was never seen.
        """
        if is_home:
            self._sight.glance()
            run = self._execution
            run.follow(timed(np.linspace(run.set_point, DRAWN_BACK, 8), run.step_time), Phase.FREE)
            run.wait(0.2, Phase.FREE)
        self._sight()

    def _chosen(self, found: Layouts) -> list[int]:
        if self._ask is not None:
            return [self._ask(self._task, self._sight.poses, found)]
        if self._options.layout is not None:
            if self._options.layout >= len(found):
                raise Failed(Cause.NO_LAYOUT, f"number {self._options.layout} of {len(found)}")
            return [self._options.layout]
        return found.ranked(self._options.choose).tolist()

    def _reach_layout(self, goals: np.ndarray) -> bool:
        """Moves objects until all are at their goals f64[N, 7]; False where nothing more can be done."""
        relations = self._meetings.relations(self._sight.poses, goals)
        pending = self._pending(goals)
        waiting = smallest_waiting(relations, pending)
        if waiting is None:
            self._why = Failed(Cause.NO_ORDER)
            return False
        self.fewest += len(pending) + len(waiting)
        while pending:
            if not self._step(goals, pending):
                return False
            pending = self._pending(goals)
        return True

    def _pending(self, goals: np.ndarray) -> list[int]:
        """The objects that are not seen where they should be."""
        now, goal = matrix_of(self._sight.poses), matrix_of(goals)
        found = []
        for k in range(self._num_moved):
            shift, turn = offset(now[k], goal[k], self._symmetry[k])
            # After the last try what would do is left.
            near = NEAR_GOAL if self._times[0, k] <= MAX_RETRIES else MAX_ERROR
            if shift > near or turn > NEAR_GOAL_TURN:
                found.append(k)
        return found

    def _step(self, goals: np.ndarray, pending: list[int]) -> bool:
        """Moves one object home, or to where it can wait; whether one was moved."""
        if self._options.order == "lowest":
            k = lowest_first(self._scene.objects, pending)[0]
            return any(self._move(k, self._home(k, goals), care) for care in _CARE)
        relations = self._meetings.relations(self._sight.poses, goals)
        free = self._far_first(ready(relations, pending), goals)
        # Where all goes with room to spare, nothing brushes its neighbours.
        if any(self._move(k, self._home(k, goals), care) for care in _CARE for k in free):
            return True
        # Those whose waiting makes an order possible, then others, which may be taken in another way later.
        asked = [*(smallest_waiting(relations, pending) or ()), *free, *pending]
        for k in dict.fromkeys(asked):
            if relations.lies_on[:, k].any() or self._times[1, k] >= MAX_WAITS:
                continue
            places = self._waiting_places(k, goals, pending)
            if any(self._move(k, places, care, is_wait=True) for care in _CARE):
                return True
        return False

    def _far_first(self, numbers: Sequence[int], goals: np.ndarray) -> list[int]:
        """Those first whose goals are far from the arm: later ones are not in its way."""
        far = np.linalg.norm(goals[:, :2] - self._base[:2], axis=1)
        return sorted(numbers, key=lambda k: -far[k])

    def _home(self, k: int, goals: np.ndarray) -> np.ndarray:
        return equal_places(matrix_of(goals[k]), self._symmetry[k])

    def _waiting_places(self, k: int, goals: np.ndarray, pending: Sequence[int]) -> np.ndarray:
        """f64[M, 4, 4]: where an object can wait and covers no goal, those farthest from all else first."""
        others = [each for each in range(len(self._scene.names)) if each != k]
        numbers, poses = self._task.numbers, self._sight.poses
        seed = int(self._rng.integers(2**30))
        drawn = self._task.draw(seed, [numbers[k]], AREA, [numbers[each] for each in others], poses[others])
        drawn = drawn[:, 0]
        clear, coming = [], [each for each in pending if each != k]
        for place in drawn:
            poses[k] = place
            if not self._meetings.relations(poses, goals).blocks[k, coming].any():
                clear.append(place)
        if not clear:
            return np.zeros((0, 4, 4))
        near = np.concatenate([self._sight.poses[others, :2], goals[coming, :2]])
        room = np.linalg.norm(np.array(clear)[:, None, :2] - near, axis=-1).min(1)
        return matrix_of(np.array(clear)[np.argsort(-room)[:_PLACES]])

    def _move(self, k: int, places: np.ndarray, care: tuple[bool, bool], *, is_wait: bool = False) -> bool:
        """Brings an object to one of places f64[M, 4, 4]; False if there is no way: it is where it was.

        Raises:
          Failed: something went wrong that cannot be mended.
        """
        if not len(places):
            return False
        scene, stood = self._scene, matrix_of(self._sight.poses[k])
        world = PlanningWorld(scene.names, scene.objects, self._sight.poses, k, scene.support, self._base)
        seed = int(self._rng.integers(2**30))
        feels = not self._sight.sees_held
        is_apart, room = care
        mover = Mover(
            self._execution, world, self._kinematics, k, seed, self._sight, is_apart, (room,), feels
        )
        try:
            plan = mover.find_pick(self._grasps(k), places)
        except Failed as failure:
            self._why = Failed(failure.outcome, f"{scene.names[k]} {failure.detail}")
            return False
        self._count(k, is_wait)
        self._execution.aim_at(k)
        self._sight.take(k, plan.grip.T_tool_object)
        self._judge.begin_move()
        is_back = self._carry(mover, plan, np.concatenate([places, stood[None]])) == len(places)
        self._look(is_home=mover.go_home())
        self._judge.check_others(k)
        if is_back:
            # It counts as a pick, and as nothing else.
            self._times[int(is_wait), k] -= 1
            self.waits -= is_wait
            self.retries -= not is_wait and bool(self._times[0, k])
            self._backs += 1
            self._why = Failed(Outcome.NO_PATH, f"{scene.names[k]} from above where it was")
            if self._backs >= MAX_BACKS:
                raise self._why
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
        slipped, last = None, len(places) - 1
        for part, first in ((places[:last], 0), (places[last:], last)):
            try:
                return first + mover.place(part)
            except Failed as failure:
                if failure.outcome == Outcome.SLIP and slipped is None and not mover.has_lost(_IN_HAND):
                    slipped = failure
                elif failure.outcome != Outcome.NO_PATH:
                    raise
        if slipped is not None:
            # The hand is no longer where it took the object.
            raise slipped
        mover.put_back(plan)
        return last

    def _count(self, k: int, is_wait: bool) -> None:
        """Counts a pick.

        Raises:
          Failed: it is one too many.
        """
        is_retry = not is_wait and bool(self._times[0, k])
        if is_retry and self._times[0, k] > MAX_RETRIES:
            raise Failed(Cause.MISPLACED, f"{self._scene.names[k]} after {MAX_RETRIES} retries")
        self.picks += 1
        self.waits += is_wait
        self.retries += is_retry
        self._times[int(is_wait), k] += 1

    def _grasps(self, k: int) -> Grasps:
        grasps = self._task.grasps[k]
        return first_grasp(grasps) if self._options.one_grasp else grasps


@contextmanager
def _opened(
    task: RearrangeTask,
    options: RearrangeOptions,
    observer: Observer,
    trace: Trace | None = None,
    ask: Chooser | None = None,
) -> Iterator[tuple[Rearranger, Execution, Judge, ObjectTracker]]:
    """An episode before its first look."""
    execution = Execution(task.scene, 0, trace=trace, sleeps=True)
    judge = Judge(execution, task.scene, task.setting.num_objects, task.symmetry)
    with EpisodeView(execution, task.scene.names, task.seed) as view:
        sight = ObjectTracker(observer, view, options.relook, task.symmetry)
        yield Rearranger(task, options, execution, sight, judge, ask), execution, judge, sight


def draw_layouts(task: RearrangeTask, options: RearrangeOptions, observer: Observer) -> Layouts:
    """The layouts among which an episode has to choose; nothing is moved.

    Raises:
      Failed: none stands, or an object was never seen.
    """
    with _opened(task, options, observer) as (worker, *_):
        return worker.find_layouts()


def rearrange_episode(
    task: RearrangeTask,
    options: RearrangeOptions,
    observer: Observer,
    trace: Trace | None = None,
    ask: Chooser | None = None,
) -> RearrangeResult:
    """One rearrangement, judged.

    Args:
      observer: tells where things are.
      trace: see `robot.execute.Execution`.
      ask: a person, who chooses in place of the rule; what is chosen is the only layout that is tried.
    """
    begun, num_moved = time.process_time(), task.setting.num_objects
    with _opened(task, options, observer, trace, ask) as (worker, execution, judge, sight):
        outcome, detail = str(Outcome.SUCCESS), ""
        try:
            worker.run()
            judge.check_end(worker.goals)
        except Failed as failure:
            outcome, detail = str(failure.outcome), failure.detail
    # Where no layout was chosen nothing is where it should be.
    right = judge.is_right(worker.goals) & (worker.layout >= 0)
    errors = judge.errors(worker.goals)[right]
    error, turn_error = errors.max(0) if right.any() else (np.nan, np.nan)
    return RearrangeResult(
        outcome=outcome,
        detail=detail,
        setting=task.setting.name,
        objects=[asset.name for asset in task.scene.objects[:num_moved]],
        right=right.tolist(),
        picks=worker.picks,
        fewest=worker.fewest,
        waits=worker.waits,
        retries=worker.retries,
        looks=sight.num_looks,
        layouts=worker.layouts,
        error=float(error),
        turn_error=float(turn_error),
        path=execution.travel,
        seconds=execution.num_steps * execution.step_time,
        cpu=time.process_time() - begun,
        layout=worker.layout,
        chosen_by="person" if ask else options.choose if options.layout is None else "number",
    )
