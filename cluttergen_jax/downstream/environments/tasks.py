"""Tasks of environments: where an episode begins, how it is run, and the judge that says how it ends.

The judges are those of `robot place` and `rearrange`; here they are asked after every step of control. An
episode runs in the model of a world: set-points of servos go in, and what the arm touches is watched.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import mujoco
import numpy as np

from cluttergen_jax.assets import Box, SupportAsset, turn_symmetry
from cluttergen_jax.downstream.environments.progress import (
    LIFTED,
    grasp_progress,
    place_progress,
    rearrange_progress,
)
from cluttergen_jax.downstream.environments.world import RobotWorld
from cluttergen_jax.downstream.rearrange.judge import RearrangementJudge
from cluttergen_jax.downstream.robot.episode import Referee, set_on_stand, stand_beside
from cluttergen_jax.downstream.robot.motion.collision import Kind
from cluttergen_jax.downstream.robot.motion.execute import Execution, Phase
from cluttergen_jax.downstream.robot.outcome import Failed, Outcome
from cluttergen_jax.downstream.transforms import inverse, matrix_of, motion_between
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.generation import BankArrays, WorldState
from cluttergen_jax.geometry import rotate_in_plane, rotation_matrix
from cluttergen_jax.scene import Scene


class WorldExecution(Execution):
    """An `Execution` in a model that is compiled already.

    Args:
      world: the model. state: its beginning.
      scene: the objects that belong to it, by their names in the model; where they stand counts.
      target: the number of the object in it that the hand may touch at first.
    """

    def __init__(self, world: RobotWorld, state: WorldState, scene: Scene, target: int) -> None:
        self._world = world
        self._state = state
        super().__init__(scene, target, robot=world.description)

    def _compile(self, scene: Scene, stands: Sequence[Box]) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
        return self._world.spec, self._world.model

    def _start(self, scene: Scene) -> None:
        self._world.put(self.data, self._state)
        super()._start(scene)

    def advance(self, ctrl: np.ndarray, num_steps: int) -> None:
        """Brings the set-points evenly to f64[nu] in so many steps.

        The hand may touch the target, and that may touch anything.

        Raises:
          Failed: another contact of the arm pressed harder than `execute.MAX_FORCE`.
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

    def fork(self, num_steps: int) -> RecordedExecution:
        """A copy that goes on from here by itself; its set-points are kept every so many steps."""
        forked = copy.copy(self)
        forked.__class__ = RecordedExecution
        assert isinstance(forked, RecordedExecution)
        forked.data = copy.copy(self.data)
        forked.num_steps = 0
        forked.every = num_steps
        forked.commands = []
        return forked


class RecordedExecution(WorldExecution):
    """See `WorldExecution.fork`. every: steps; commands: f64[nu] each, the set-points every so many steps."""

    every: int
    commands: list[np.ndarray]

    def _step(self, phase: Phase) -> None:
        super()._step(phase)
        if self.num_steps % self.every == 0:
            self.commands.append(self.data.ctrl.copy())


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
      has_goals: objects are to come to poses.
    """

    name: str
    seconds: float
    has_goals: bool

    def stands(self, support: SupportAsset) -> tuple[Box, ...]:
        """Boxes that it needs beside the support."""

    def places(self, bank: BankArrays) -> np.ndarray:
        """i[M]: the scenes that it can be done in, by their place in the bank. Raises ConfigError: none."""

    def begin(
        self, scene: Scene, bank: BankArrays, place: int, rng: np.random.Generator
    ) -> EpisodeStart:
        """An episode in the scene at this place."""

    def judge(self, start: EpisodeStart, execution: WorldExecution) -> Judge:
        """Of an episode that has begun."""

    def sentence(self, labels: list[str]) -> str:
        """The task in words; labels: what people call the objects, the first one first."""


@dataclass(frozen=True, eq=False)
class EpisodeStart:
    """How an episode begins.

    Attributes:
      scene: objects where they stand. target: the number of the one that is to be moved (first).
      goals: f64[N, 7], T_world_object where they shall go; of the target alone one that is known to do.
    """

    scene: Scene
    target: int
    goals: np.ndarray


class _OneObject:
    """What tasks of one object have in common: it is the last of a scene, on which nothing lies."""

    has_goals = False

    def places(self, bank: BankArrays) -> np.ndarray:
        """All scenes."""
        return np.arange(len(bank))


class GraspTask(_OneObject):
    """Lift the last object of the scene by 10 cm out of those around it (`robot place --task lift`)."""

    name = "grasp"
    seconds = 15.0

    def stands(self, support: SupportAsset) -> tuple[Box, ...]:
        """None."""
        return ()

    def begin(
        self, scene: Scene, bank: BankArrays, place: int, rng: np.random.Generator
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

    def stands(self, support: SupportAsset) -> tuple[Box, ...]:
        """The one that the object stands on."""
        return (stand_beside(support),)

    def places(self, bank: BankArrays) -> np.ndarray:
        """The scenes whose last object stands upright."""
        index = np.asarray(bank.object_index)
        last = (index >= 0).sum(1) - 1
        quaternions = np.asarray(bank.poses)[np.arange(len(bank)), last, 3:]
        found = np.flatnonzero([rotation_matrix(each)[2, 2] > _UPRIGHT for each in quaternions])
        if not len(found):
            raise ConfigError(
                f"{bank!r}, in whose scenes the last object lies",
                "an upright last object",
                "task='grasp'",
            )
        return found

    def begin(
        self, scene: Scene, bank: BankArrays, place: int, rng: np.random.Generator
    ) -> EpisodeStart:
        """The last object on the stand, somehow turned."""
        target = len(scene.names) - 1
        moved, _ = set_on_stand(scene, target, int(rng.integers(2**31)))
        return EpisodeStart(moved, target, scene.poses.copy())

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

    def stands(self, support: SupportAsset) -> tuple[Box, ...]:
        """None."""
        return ()

    def places(self, bank: BankArrays) -> np.ndarray:
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
        self, scene: Scene, bank: BankArrays, place: int, rng: np.random.Generator
    ) -> EpisodeStart:
        """The scene as it is, and another one for its goals."""
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


def _sets(bank: BankArrays) -> np.ndarray:
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


def _displaced(execution: WorldExecution, start: EpisodeStart) -> float:
    """Metres that another object is from where it stood, at most."""
    shift, _ = motion_between(execution.poses(), start.scene.poses)
    return float(np.delete(shift, start.target).max(initial=0.0))


def _distance(execution: WorldExecution, number: int) -> float:
    """Metres of the tool from an object's origin."""
    return float(np.linalg.norm(execution.pose(number)[:3, 3] - execution.tool[:3, 3]))


def _check_fallen(execution: WorldExecution, scene: Scene) -> None:
    low = execution.poses()[:, 2] < scene.support.lowest - FALLEN
    if low.any():
        raise Failed(Outcome.OUTSIDE, f"{scene.names[int(low.argmax())]} fell")


@dataclass(eq=False)
class _GraspJudge:
    start: EpisodeStart
    execution: WorldExecution

    @cached_property
    def _referee(self) -> Referee:
        return Referee(self.start.scene, self.start.target, (), execution=self.execution)

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
        known = (_distance(run, target), _displaced(run, self.start), run.is_touching, height)
        return float(grasp_progress(np, *known))


class _PlaceJudge:
    def __init__(self, start: EpisodeStart, execution: WorldExecution) -> None:
        self._start = start
        self._execution = execution
        self._scene = start.scene
        self._target = start.target
        self._referee = Referee(start.scene, start.target, (), execution=execution)
        self._stand = stand_beside(start.scene.support)
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
        known = (_distance(run, self._target), _displaced(run, self._start), run.is_touching, away)
        return float(place_progress(np, *known, False))

    def _is_on_stand(self) -> bool:
        place = self._execution.pose(self._target)[:2, 3] - np.asarray(self._stand.center[:2])
        side = np.abs(rotate_in_plane(place, -self._stand.yaw))
        return bool((side <= self._stand.half_extents[:2]).all())


class _LayoutJudge:
    def __init__(self, start: EpisodeStart, execution: WorldExecution) -> None:
        self._execution = execution
        self._start = start
        symmetry = [turn_symmetry(asset) for asset in start.scene.objects]
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
        away = [_distance(run, number) for number in np.flatnonzero(~right)]
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
