"""Episodes of rearrangement: see, uncover, choose a layout, find an order, move one object after another."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from cluttergen_jax.downstream.episodes.layout_judge import MAX_ERROR, RearrangementJudge
from cluttergen_jax.downstream.episodes.outcome import Cause
from cluttergen_jax.downstream.rearrange.layouts import (
    ROOM,
    Layouts,
    ReachCheck,
    choose_unlike,
    clearance_of,
    prefer,
)
from cluttergen_jax.downstream.rearrange.observe import EpisodeView, ObjectTracker, Observer
from cluttergen_jax.downstream.rearrange.order import (
    Meetings,
    lowest_first,
    ready,
    smallest_waiting,
)
from cluttergen_jax.downstream.rearrange.task import (
    Chooser,
    RearrangeOptions,
    RearrangeProblem,
    RearrangeResult,
)
from cluttergen_jax.downstream.robot import (
    FIRM,
    ROOMS,
    ArmKinematics,
    Execution,
    Failed,
    Grasps,
    Mover,
    Outcome,
    PathPlanner,
    Phase,
    PickPlan,
    PlanningWorld,
    Trace,
    base_pose,
    first_grasp,
    run_to_end,
)
from cluttergen_jax.downstream.transforms import equal_places, matrix_of, offset
from cluttergen_jax.scene import Scene

MAX_RETRIES = 2
"""Times an object is picked up again because it was lost, or is not where it was put."""
MAX_BACKS = 6
"""Times in an episode that what was picked up and finds no place is brought back to where it was."""
_CARE = (*((True, room) for room in ROOMS), (False, 0.0))
"""How a move is planned, the most careful way first: `is_apart` of `Mover`, and its room."""
_IN_HAND = 0.06
"""Metres that an object may have slipped and still be carried on."""


@dataclass(eq=False)
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

    scene: Scene
    grasps: Sequence[Grasps]
    execution: Execution
    sight: ObjectTracker
    judge: RearrangementJudge
    rng: np.random.Generator
    planner: PathPlanner | None

    def __post_init__(self) -> None:
        self.base = base_pose(self.scene.support, self.execution.robot)
        self.kinematics = ArmKinematics(self.base, self.execution.robot)
        self.picks = self.waits = self.retries = self._backs = 0
        self.why = Failed(Cause.NO_ORDER)
        self.forget()

    def forget(self) -> None:
        """What is counted for each object is counted anew."""
        self.homed, self.waited = np.zeros((2, len(self.scene.names)), int)

    def look(self, is_home: bool = True) -> None:
        """Looks for all: with the hand over the table, then drawn back out of the other camera's way."""
        if is_home:
            self.sight.glance()
            run = self.execution
            drawn_back = np.array(run.robot.arm.drawn_back)
            run.follow(np.linspace(run.set_point, drawn_back, 8), Phase.FREE)
            run.wait(0.2, Phase.FREE)
        self.sight()

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
        scene = self.scene
        stood = matrix_of(self.sight.poses[k])
        known = (scene.names, scene.objects, self.sight.poses)
        world = PlanningWorld(*known, k, scene.support, self.base, self.execution.robot)
        seed = int(self.rng.integers(2**30))
        feels = not self.sight.sees_held
        is_apart, room = care
        ways = (self.sight, is_apart, (room,), feels, self.planner)
        mover = Mover(self.execution, world, self.kinematics, k, seed, *ways)
        try:
            plan = mover.find_pick(self.grasps[k], places)
        except Failed as failure:
            self.why = Failed(failure.outcome, f"{scene.names[k]} {failure.detail}")
            return False
        self._count(k, is_wait)
        self.execution.aim_at(k)
        self.sight.take(k, plan.grip.T_tool_object)
        self.judge.begin_move()
        is_back = self._carry(mover, plan, np.concatenate([places, stood[None]])) == len(places)
        self.look(is_home=mover.go_home())
        self.judge.check_others(k)
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
            raise Failed(Cause.MISPLACED, f"{self.scene.names[k]} after {MAX_RETRIES} retries")
        self.picks += 1
        self.waits += is_wait
        self.retries += is_retry
        (self.waited if is_wait else self.homed)[k] += 1


# Metres and radians from its place within which an object counts as brought there.
NEAR_GOAL = 0.01
NEAR_GOAL_TURN = float(np.radians(10))

MAX_WAITS = 2
"""Times an object is put down somewhere else on its way."""
MAX_LAYOUTS = 3
"""Layouts that are tried one after another where there is no way to the one before."""
_DRAWS = 4
"""Times that layouts are drawn at most: until enough are reached, with room or without."""
_PLACES = 12


@dataclass(eq=False)
class Rearranger:
    """Brings objects into a layout, by what is seen of them and the arm's motors alone.

    Args:
      task: what; options: how.
      execution: the simulation; sight: what is known of it; judge: is told before and after each move.
      ask: chooses in place of the rule.

    Attributes:
      moves: that were made. fewest, layouts, layout: of `RearrangeResult`.
      goals: f64[N, 7], the layout that was tried last.
    """

    task: RearrangeProblem
    options: RearrangeOptions
    execution: Execution
    sight: ObjectTracker
    judge: RearrangementJudge
    ask: Chooser | None = None

    def __post_init__(self) -> None:
        task = self.task
        self._scene = task.scene
        self._symmetry = task.symmetry
        self._meetings = Meetings(task.scene.objects)
        self._num_moved = task.setting.num_objects
        self._rng = np.random.default_rng(task.seed)
        is_single = self.options.one_grasp
        grasps = [first_grasp(each) for each in task.grasps] if is_single else task.grasps
        run = (self.execution, self.sight, self.judge, self._rng, task.planner)
        self.moves = Moves(task.scene, grasps, *run)
        self.fewest = self.layouts = 0
        self.goals = task.scene.poses
        self.layout = -1

    def run(self) -> None:
        """Until all objects are in one of the layouts.

        Raises:
          Failed: no layout could be reached, or something went wrong.
        """
        self.look_around()
        found = self.find_layouts()
        for number in self._choose(found)[:MAX_LAYOUTS]:
            self.layouts += 1
            self.moves.forget()
            self.goals = found.poses[number]
            self.layout = number
            if self._reach_layout(self.goals):
                return
        raise self.moves.why

    def look_around(self) -> None:
        """Looks for all objects; while one is hidden, what may lie on it is put aside, each object once.

        Raises:
          Failed: one was never seen, or something went wrong.
        """
        self.moves.look()
        aside: set[int] = set()
        while self.sight.unseen:
            # After a single look nothing more will be seen.
            for k in self._highest_first() if self.options.relook else ():
                if k in aside:
                    continue
                aside.add(k)
                if self.moves.first([k], [self._waiting_places(k)], is_wait=True):
                    break
            else:
                self.sight.guess()
                if hidden := self.sight.unseen:
                    raise Failed(Cause.NOT_SEEN, self._scene.names[hidden[0]])

    def _highest_first(self) -> list[int]:
        """The seen objects that may be moved and on which nothing is seen to lie.

        Those come first whose centres are highest above where they would be, did they stand on the table.
        """
        poses = self.sight.poses
        hidden = self.sight.unseen
        lies_on = self._meetings.relations(poses, poses).lies_on
        rest = [asset.half_extents[2] for asset in self._scene.objects]
        raised = poses[:, 2] - rest
        seen = (k for k in range(self._num_moved) if k not in hidden and not lies_on[:, k].any())
        return sorted(seen, key=lambda k: -raised[k])

    def find_layouts(self) -> Layouts:
        """Draws unlike layouts around the objects that stay, as they are seen. Raises Failed: none stands."""
        task = self.task
        num_moved = self._num_moved
        poses = self.sight.poses
        moved = task.numbers[:num_moved]
        stay = task.numbers[num_moved:]
        objects = self._scene.objects
        region = task.setting.target
        number = self.options.num_layouts
        reach_of = ReachCheck(
            objects, task.grasps, range(num_moved), self._scene.support, task.robot, FIRM
        )
        full = np.zeros((0, len(poses), 7))
        gap = np.zeros(0)
        reach = np.zeros(0)
        for draw in range(_DRAWS):
            if task.goals is None:
                drawn = task.draw(task.seed + draw, moved, region, stay, poses[num_moved:])
            else:
                drawn = task.goals(draw, poses[num_moved:])
            others = np.broadcast_to(poses[num_moved:], (len(drawn), len(stay), 7))
            more = np.concatenate([drawn, others], axis=1)
            full = np.concatenate([full, more])
            gap = np.append(gap, [clearance_of(objects, each, num_moved) for each in more])
            reach = np.append(reach, [reach_of(each) for each in more])
            is_whole = reach == 1
            if (is_whole & (gap >= ROOM)).sum() >= MAX_LAYOUTS or is_whole.sum() >= 2 * number:
                break
        if not len(full):
            raise Failed(Cause.NO_LAYOUT)
        kept = prefer(reach, gap, 2 * number)
        kept = kept[choose_unlike(objects[:num_moved], full[kept, :num_moved], region, number)]
        way = np.linalg.norm(full[kept, :num_moved, :2] - poses[:num_moved, :2], axis=-1)
        return Layouts(poses=full[kept], clearance=gap[kept], reach=reach[kept], travel=way.mean(1))

    def _choose(self, found: Layouts) -> list[int]:
        if self.ask is not None:
            return [self.ask(self.task, self.sight.poses, found)]
        if self.options.layout is not None:
            if self.options.layout >= len(found):
                raise Failed(Cause.NO_LAYOUT, f"number {self.options.layout} of {len(found)}")
            return [self.options.layout]
        return found.rank(self.options.choose).tolist()

    def _reach_layout(self, goals: np.ndarray) -> bool:
        """Moves objects until all are at their goals f64[N, 7]; False where nothing more can be done."""
        relations = self._meetings.relations(self.sight.poses, goals)
        pending = self._pending(goals)
        waiting = smallest_waiting(relations, pending)
        if waiting is None:
            self.moves.why = Failed(Cause.NO_ORDER)
            return False
        self.fewest += len(pending) + len(waiting)
        while pending:
            if not self._step(goals, pending):
                return False
            pending = self._pending(goals)
        return True

    def _pending(self, goals: np.ndarray) -> list[int]:
        """The objects that are not seen where they should be."""
        now = matrix_of(self.sight.poses)
        goal = matrix_of(goals)
        found = []
        for k in range(self._num_moved):
            shift, turn = offset(now[k], goal[k], self._symmetry[k])
            # After the last try what would do is left.
            near = NEAR_GOAL if self.moves.homed[k] <= MAX_RETRIES else MAX_ERROR
            if shift > near or turn > NEAR_GOAL_TURN:
                found.append(k)
        return found

    def _step(self, goals: np.ndarray, pending: list[int]) -> bool:
        """Moves one object home, or to where it can wait; whether one was moved."""
        if self.options.order == "lowest":
            free = lowest_first(self._scene.objects, pending)[:1]
            return self.moves.first(free, [self._home(k, goals) for k in free])
        relations = self._meetings.relations(self.sight.poses, goals)
        free = self._far_first(ready(relations, pending), goals)
        if self.moves.first(free, [self._home(k, goals) for k in free]):
            return True
        # Those whose waiting makes an order possible, then others, which may be taken in another way later.
        asked = [*(smallest_waiting(relations, pending) or ()), *free, *pending]
        for k in dict.fromkeys(asked):
            if relations.lies_on[:, k].any() or self.moves.waited[k] >= MAX_WAITS:
                continue
            if self.moves.first([k], [self._waiting_places(k, goals, pending)], is_wait=True):
                return True
        return False

    def _far_first(self, numbers: Sequence[int], goals: np.ndarray) -> list[int]:
        """Those first whose goals are far from the arm: later ones are not in its way."""
        far = np.linalg.norm(goals[:, :2] - self.moves.base[:2], axis=1)
        return sorted(numbers, key=lambda k: -far[k])

    def _home(self, k: int, goals: np.ndarray) -> np.ndarray:
        return equal_places(matrix_of(goals[k]), self._symmetry[k])

    def _waiting_places(
        self, k: int, goals: np.ndarray | None = None, pending: Sequence[int] = ()
    ) -> np.ndarray:
        """f64[M, 4, 4]: where an object can wait and covers no goal, those farthest from all else first.

        Args:
          goals: f64[N, 7], of the `pending` objects.
        """
        hidden = self.sight.unseen
        others = [
            each for each in range(len(self._scene.names)) if each != k and each not in hidden
        ]
        numbers = self.task.numbers
        poses = self.sight.poses
        seed = int(self._rng.integers(2**30))
        drawn = self.task.draw(
            seed, [numbers[k]], self.task.area, [numbers[each] for each in others], poses[others]
        )
        clear = drawn[:, 0]
        coming = [each for each in pending if each != k]
        # What is hidden is where the object is now, or near it.
        near = poses[others + [k] * bool(hidden), :2]
        if goals is not None and coming:
            covers = []
            for place in clear:
                poses[k] = place
                covers.append(self._meetings.relations(poses, goals).blocks[k, coming].any())
            clear = clear[~np.array(covers, bool)]
            near = np.concatenate([near, goals[coming, :2]])
        if not len(clear):
            return np.zeros((0, 4, 4))
        room = np.linalg.norm(clear[:, None, :2] - near, axis=-1).min(1)
        return matrix_of(clear[np.argsort(-room)[:_PLACES]])


@contextmanager
def _open_episode(
    task: RearrangeProblem,
    options: RearrangeOptions,
    observer: Observer,
    trace: Trace | None = None,
    ask: Chooser | None = None,
) -> Iterator[tuple[Rearranger, Execution, RearrangementJudge, ObjectTracker]]:
    """An episode before its first look."""
    execution = Execution(task.scene, 0, trace=trace, sleeps=True, robot=task.robot)
    judge = RearrangementJudge(execution, task.scene, task.setting.num_objects, task.symmetry)
    with EpisodeView(execution, task.scene.names, task.seed) as view:
        sight = ObjectTracker(observer, view, options.relook, task.symmetry)
        yield Rearranger(task, options, execution, sight, judge, ask), execution, judge, sight


def draw_layouts(task: RearrangeProblem, options: RearrangeOptions, observer: Observer) -> Layouts:
    """The layouts among which an episode has to choose; nothing is moved but what hides an object.

    Raises:
      Failed: none stands, or an object was never seen.
    """
    with _open_episode(task, options, observer) as (worker, *_):
        worker.look_around()
        return worker.find_layouts()


def rearrange_episode(
    task: RearrangeProblem,
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
    begun = time.process_time()
    num_moved = task.setting.num_objects
    with _open_episode(task, options, observer, trace, ask) as (worker, execution, judge, sight):

        def run() -> None:
            worker.run()
            judge.check_end(worker.goals)

        outcome, detail = run_to_end(run)
    if trace is not None:
        trace.goals = np.array(worker.goals, np.float64)
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
        picks=worker.moves.picks,
        fewest=worker.fewest,
        waits=worker.moves.waits,
        retries=worker.moves.retries,
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
