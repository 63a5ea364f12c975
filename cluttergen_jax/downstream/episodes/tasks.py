"""Tasks of environments: where an episode begins, how it is run, and the judge that says how it ends.

The judges are those of `robot place` and `rearrange`; here they are asked after every step of control. An
episode runs in the model of a world: set-points of servos go in, and what the arm touches is watched.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from cluttergen_jax.downstream.episodes.layout_judge import RearrangementJudge
from cluttergen_jax.downstream.episodes.outcome import Failed, Outcome
from cluttergen_jax.downstream.episodes.progress import (
    LIFTED,
    grasp_progress,
    place_progress,
    rearrange_progress,
)
from cluttergen_jax.downstream.episodes.referee import EpisodeReferee, pose_on_stand
from cluttergen_jax.downstream.episodes.simulation import Kind, Phase, Simulation
from cluttergen_jax.downstream.episodes.starts import EpisodeStart
from cluttergen_jax.downstream.episodes.world import BankRows, SimulatedWorld
from cluttergen_jax.downstream.transforms import inverse, matrix_of, motion_between
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import rotate_in_plane, rotation_matrix


class WorldExecution(Simulation):
    """A `Simulation` in the model of a world.

    Args:
      world: the model. state: its beginning.
      scene: the objects that belong to it, by their names in the model; where they stand counts.
      target: the number of the object in it that the hand may touch at first.
    """

    def __init__(self, world: SimulatedWorld, state: Any, scene: Any, target: int) -> None:
        super().__init__(world.model, world.robot, world.gripper, scene.names, target)
        self.world = world
        world.put(self.data, state)
        self.put_home(scene.names, scene.poses, world.home)

    def advance(self, ctrl: np.ndarray, num_steps: int) -> None:
        """Brings the set-points evenly to f64[nu] in so many steps.

        The hand may touch the target, and that may touch anything.

        Raises:
          Failed: another contact of the arm pressed harder than `MAX_FORCE`.
        """
        start = self.data.ctrl.copy()
        for step in range(1, num_steps + 1):
            self.data.ctrl[:] = start + (ctrl - start) * (step / num_steps)
            self._step(Phase.TOUCH)

    @property
    def is_touching(self) -> bool:
        """The arm or its hand touches the object that it may touch."""
        if not self.data.ncon:
            return False
        kinds = self._kind[self.data.contact.geom]
        is_arm = np.isin(kinds, (Kind.ARM, Kind.HAND)).any(1)
        return bool((is_arm & (kinds == Kind.TARGET).any(1)).any())


LEFT = 0.025
"""Metres from where it last touched an object from which on the open hand has left it."""
FALLEN = 0.1
"""Metres below the support's top."""
_UPRIGHT = np.cos(np.radians(3.0))


class Judge(Protocol):
    """Says how an episode ends."""

    def check(self) -> bool:
        """Whether it has just ended in success. Raises Failed: in failure."""

    @property
    def progress(self) -> float:
        """0 to 1: how far an episode has come that goes on (`progress`)."""


class Task(Protocol):
    """What is to be done.

    Attributes:
      name: of it. seconds: that an episode may take, if nothing else is said; for each object.
      has_goals: objects are to come to poses. has_stand: the object stands beside the support at first.
    """

    name: str
    seconds: float
    has_goals: bool
    has_stand: bool

    def places(self, bank: BankRows) -> np.ndarray:
        """i[M]: the scenes that it can be done in, by their place in the bank. Raises ConfigError: none."""

    def begin(
        self, scene: Any, world: SimulatedWorld, place: int, rng: np.random.Generator
    ) -> EpisodeStart:
        """An episode in the scene at this place."""

    def judge(self, start: EpisodeStart, execution: WorldExecution) -> Judge:
        """Of an episode that has begun."""

    def sentence(self, labels: list[str]) -> str:
        """The task in words; labels: what people call the objects, the first one first."""


class _OneObject:
    """What tasks of one object have in common: it is the last of a scene, on which nothing lies."""

    has_goals = False
    has_stand = False

    def places(self, bank: BankRows) -> np.ndarray:
        """All scenes."""
        return np.arange(len(bank.index))


class GraspTask(_OneObject):
    """Lift the last object of the scene by 10 cm out of those around it (`robot place --task lift`)."""

    name = "grasp"
    seconds = 15.0

    def begin(
        self, scene: Any, world: SimulatedWorld, place: int, rng: np.random.Generator
    ) -> EpisodeStart:
        """The scene as it is."""
        return EpisodeStart(scene, len(scene.names) - 1, scene.poses.copy())

    def judge(self, start: EpisodeStart, execution: WorldExecution) -> Judge:
        """Of `robot place --task lift`."""
        return _GraspJudge(start, execution)

    def sentence(self, labels: list[str]) -> str:
        """In words."""
        return f"lift the {labels[0]}"


class PlaceTask(_OneObject):
    """Bring an object from the stand beside the support into the region, among the others."""

    name = "place"
    seconds = 40.0
    has_stand = True

    def places(self, bank: BankRows) -> np.ndarray:
        """The scenes whose last object stands upright."""
        index = np.asarray(bank.object_index)
        last = (index >= 0).sum(1) - 1
        quaternions = np.asarray(bank.poses)[np.arange(len(bank.index)), last, 3:]
        found = np.flatnonzero([rotation_matrix(each)[2, 2] > _UPRIGHT for each in quaternions])
        if not len(found):
            raise ConfigError(
                f"{bank!r}, in whose scenes the last object lies",
                "an upright last object",
                "task='grasp'",
            )
        return found

    def begin(
        self, scene: Any, world: SimulatedWorld, place: int, rng: np.random.Generator
    ) -> EpisodeStart:
        """The last object on the stand, somehow turned."""
        target = len(scene.names) - 1
        # A generator of its own, as recordings of earlier versions have it.
        yaw = np.random.default_rng(int(rng.integers(2**31))).uniform(-np.pi, np.pi)
        resting = scene.objects[target].resting[0]
        poses = scene.poses.copy()
        poses[target] = pose_on_stand(world.stand.center, scene.support.top, resting, yaw)
        return EpisodeStart(replace(scene, poses=poses), target, scene.poses.copy())

    def judge(self, start: EpisodeStart, execution: WorldExecution) -> Judge:
        """Of `robot place`."""
        return _PlaceJudge(start, execution)

    def sentence(self, labels: list[str]) -> str:
        """In words."""
        return f"put the {labels[0]} on the table, among the other objects"


class RearrangeTask:
    """Bring all objects of a scene to where they are in another scene of the bank that has the same ones."""

    name = "rearrange"
    seconds = 25.0
    has_goals = True
    has_stand = False

    def places(self, bank: BankRows) -> np.ndarray:
        """The scenes that another one has the objects of."""
        _, kind, number = np.unique(_sets(bank), axis=0, return_inverse=True, return_counts=True)
        found = np.flatnonzero(number[kind.ravel()] > 1)
        if not len(found):
            raise ConfigError(
                f"{bank!r}, in which no two scenes have the same objects",
                "a goal for each object: another scene of the same ones",
                "a bank of as many objects as its pool has, or with `objects`",
            )
        return found

    def begin(
        self, scene: Any, world: SimulatedWorld, place: int, rng: np.random.Generator
    ) -> EpisodeStart:
        """The scene as it is, and another one for its goals."""
        bank = world.bank
        sets = _sets(bank)
        others = np.flatnonzero((sets == sets[place]).all(1))
        other = int(rng.choice(others[others != place]))
        index = np.asarray(bank.object_index)
        poses = np.asarray(bank.poses, np.float64)
        slots = [
            int(np.flatnonzero(index[other] == k)[0]) for k in index[place][: len(scene.names)]
        ]
        goals = poses[other, slots]
        goals[:, 3:] /= np.linalg.norm(goals[:, 3:], axis=1, keepdims=True)
        return EpisodeStart(scene, 0, goals)

    def judge(self, start: EpisodeStart, execution: WorldExecution) -> Judge:
        """Of `rearrange`."""
        return _LayoutJudge(start, execution)

    def sentence(self, labels: list[str]) -> str:
        """In words."""
        return f"bring {', '.join(f'the {label}' for label in labels)} to their places"


TASKS: dict[str, Task] = {each.name: each for each in (PlaceTask(), RearrangeTask(), GraspTask())}


def _sets(bank: BankRows) -> np.ndarray:
    """i[S, N]: the objects of each scene, sorted."""
    return np.sort(np.asarray(bank.object_index), axis=1)


class _HandWatch:
    """Where the tool was when the hand last touched the object that it may touch."""

    def __init__(self, execution: WorldExecution) -> None:
        self._execution = execution
        self._touched: np.ndarray | None = None

    @property
    def is_idle(self) -> bool:
        """It has touched nothing since the beginning, or since it left."""
        return self._touched is None

    def has_left(self) -> bool:
        """It touched the object, is open, and went away."""
        run = self._execution
        if run.is_touching:
            self._touched = run.tool[:3, 3]
            return False
        if self._touched is None or run.is_closed:
            return False
        return float(np.linalg.norm(run.tool[:3, 3] - self._touched)) > LEFT

    def forget(self) -> None:
        """It has touched nothing yet."""
        self._touched = None


def _displacement(execution: WorldExecution, start: EpisodeStart) -> float:
    """Metres that another object is from where it stood, at most."""
    shift, _ = motion_between(execution.poses(), start.scene.poses)
    return float(np.delete(shift, start.target).max(initial=0.0))


def _distance(execution: WorldExecution, number: int) -> float:
    """Metres of the tool from an object's origin."""
    return float(np.linalg.norm(execution.pose(number)[:3, 3] - execution.tool[:3, 3]))


def _check_fallen(execution: WorldExecution, scene: Any) -> None:
    low = execution.poses()[:, 2] < scene.support.lowest - FALLEN
    if low.any():
        raise Failed(Outcome.OUTSIDE, f"{scene.names[int(low.argmax())]} fell")


@dataclass(eq=False)
class _GraspJudge:
    start: EpisodeStart
    execution: WorldExecution

    @cached_property
    def _referee(self) -> EpisodeReferee:
        return EpisodeReferee(self.start.scene, self.start.target, self.execution)

    def check(self) -> bool:
        scene = self.start.scene
        target = self.start.target
        _check_fallen(self.execution, scene)
        height = self.execution.pose(target)[2, 3] - scene.poses[target, 2]
        if height < LIFTED or not self.execution.is_touching:
            return False
        self._referee.check_others()
        return True

    @property
    def progress(self) -> float:
        run = self.execution
        target = self.start.target
        height = run.pose(target)[2, 3] - self.start.scene.poses[target, 2]
        known = (_distance(run, target), _displacement(run, self.start), run.is_touching, height)
        return float(grasp_progress(np, *known))


class _PlaceJudge:
    def __init__(self, start: EpisodeStart, execution: WorldExecution) -> None:
        self._start = start
        self._execution = execution
        self._scene = start.scene
        self._target = start.target
        self._referee = EpisodeReferee(start.scene, start.target, execution)
        self._stand = execution.world.stand
        self._hand = _HandWatch(execution)

    def check(self) -> bool:
        _check_fallen(self._execution, self._scene)
        if not self._hand.has_left() or self._is_on_stand():
            return False
        self._referee.check_others()
        self._referee.check_stands()
        self._referee.check_region()
        return True

    @property
    def progress(self) -> float:
        run = self._execution
        region = self._scene.support.region
        place = run.pose(self._target)[:2, 3] - np.asarray(region.center)
        side = np.abs(rotate_in_plane(place, -region.yaw)) - np.asarray(region.half_extents)
        away = float(np.linalg.norm(np.maximum(side, 0.0)))
        known = (
            _distance(run, self._target),
            _displacement(run, self._start),
            run.is_touching,
            away,
        )
        return float(place_progress(np, *known, False))

    def _is_on_stand(self) -> bool:
        place = self._execution.pose(self._target)[:2, 3] - np.asarray(self._stand.center[:2])
        side = np.abs(rotate_in_plane(place, -self._stand.yaw))
        return bool((side <= self._stand.half_extents[:2]).all())


class _LayoutJudge:
    def __init__(self, start: EpisodeStart, execution: WorldExecution) -> None:
        self._execution = execution
        self._start = start
        symmetry = execution.world.symmetries(start.scene)
        self._judge = RearrangementJudge(execution, start.scene, len(symmetry), symmetry)
        self._hand = _HandWatch(execution)
        self._target = start.target
        self._half_extents = [asset.half_extents for asset in start.scene.objects]

    def check(self) -> bool:
        run = self._execution
        _check_fallen(run, self._start.scene)
        if not self._hand.has_left():
            if self._hand.is_idle:
                self._aim()
            return False
        self._judge.check_others(self._target)
        self._hand.forget()
        if not self._judge.is_right(self._start.goals).all():
            self._aim()
            return False
        self._judge.check_end(self._start.goals)
        return True

    @property
    def progress(self) -> float:
        run = self._execution
        goals = self._start.goals
        right = self._judge.is_right(goals)
        away = [_distance(run, int(number)) for number in np.flatnonzero(~right)]
        errors = self._judge.errors(goals)[:, 0]
        return float(rearrange_progress(np, min(away, default=np.inf), run.is_touching, errors))

    def _aim(self) -> None:
        """The hand may touch the object whose box is nearest to it, none other."""
        run = self._execution
        away = [
            np.linalg.norm(
                np.maximum(np.abs(inverse(matrix_of(pose)) @ [*run.tool[:3, 3], 1])[:3] - half, 0)
            )
            for pose, half in zip(run.poses(), self._half_extents, strict=True)
        ]
        nearest = int(np.argmin(away))
        if nearest != self._target:
            run.aim_at(nearest)
            self._target = nearest
        self._judge.begin_move()
