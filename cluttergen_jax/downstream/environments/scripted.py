"""A scripted policy: the motion of `robot place`, made in a copy of the simulation and played back."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np

from cluttergen_jax.assets import turn_symmetry
from cluttergen_jax.downstream.episodes.env import RobotEnv
from cluttergen_jax.downstream.episodes.layout_judge import RearrangementJudge
from cluttergen_jax.downstream.episodes.outcome import Failed
from cluttergen_jax.downstream.episodes.simulation import Phase
from cluttergen_jax.downstream.episodes.starts import EpisodeStart
from cluttergen_jax.downstream.episodes.tasks import PlaceTask
from cluttergen_jax.downstream.rearrange.episode import Rearranger
from cluttergen_jax.downstream.rearrange.layouts import SceneDraw
from cluttergen_jax.downstream.rearrange.observe import EpisodeView, ObjectTracker, TrueObserver
from cluttergen_jax.downstream.rearrange.task import (
    RearrangeOptions,
    RearrangeProblem,
    RearrangeSetting,
)
from cluttergen_jax.downstream.robot.episode import stand_beside
from cluttergen_jax.downstream.robot.grasping.grasps import grasps_of
from cluttergen_jax.downstream.robot.motion.collision import PlanningWorld
from cluttergen_jax.downstream.robot.motion.execute import Execution
from cluttergen_jax.downstream.robot.motion.ik import ArmKinematics
from cluttergen_jax.downstream.robot.motion.mover import Mover
from cluttergen_jax.downstream.transforms import matrix_of
from cluttergen_jax.errors import ConfigError

WAIT = 10
"""Steps of control after the last motion."""


class RecordedExecution(Execution):
    """A copy of a running episode that a planner moves (`fork_episode`).

    Attributes:
      every: steps. commands: f64[nu] each, the set-points every so many steps.
    """

    every: int
    commands: list[np.ndarray]

    def _step(self, phase: Phase) -> None:
        super()._step(phase)
        if self.num_steps % self.every == 0:
            self.commands.append(self.data.ctrl.copy())


def fork_episode(env: RobotEnv) -> RecordedExecution:
    """A copy of the environment's episode that goes on from here by itself."""
    episode = env.execution
    assert episode is not None
    forked = RecordedExecution.__new__(RecordedExecution)
    forked.__dict__.update(episode.__dict__)
    forked.robot = env.world.description
    forked._trace = None
    forked.data = copy.copy(episode.data)
    forked.num_steps = 0
    forked.every = env.substeps
    forked.commands = []
    return forked


def plan_actions(env: RobotEnv, seed: int) -> Iterator[np.ndarray]:
    """See `scripted_actions`."""
    if not isinstance(env, RobotEnv):
        raise ConfigError(
            f"scripted_actions({env!r})", "an environment of make_robot_env, just reset"
        )
    if env.execution is None or env.start is None:
        raise ConfigError("a scripted policy of no episode", "an environment that was just reset")
    fork = fork_episode(env)
    env.action_of(fork.data.ctrl)
    # Where the planner fails the episode does, too: it goes on as far as that came.
    with suppress(Failed):
        if env.task_kind.has_goals:
            _rearrange(env, env.start, fork, seed)
        else:
            _move_target(env, env.start, fork, seed)
    return _actions_of_episode(env, [*fork.commands, *[fork.data.ctrl.copy()] * WAIT])


def _actions_of_episode(env: RobotEnv, commands: list[np.ndarray]) -> Iterator[np.ndarray]:
    """The actions that bring about these set-points, until the episode that they are of is over."""
    episode = env.execution
    for ctrl in commands:
        if env.execution is not episode:
            return
        yield env.action_of(ctrl)


def _move_target(env: RobotEnv, start: EpisodeStart, fork: RecordedExecution, seed: int) -> None:
    """Lifts the target, and brings it to its goal if the task is to place it."""
    scene = start.scene
    target = start.target
    base = env.world.base
    robot = env.world.description
    is_placed = env.task == PlaceTask.name
    stands = (stand_beside(scene.support),) if is_placed else ()
    known = (scene.names, scene.objects, scene.poses, target, scene.support, base, robot)
    mover = Mover(fork, PlanningWorld(*known, stands), ArmKinematics(base, robot), target, seed)
    grasps = next(iter(grasps_of([scene.objects[target]], robot=robot)))
    goal = matrix_of(start.goals[target : target + 1]) if is_placed else None
    mover.pick(mover.find_pick(grasps, goal))
    if goal is not None:
        mover.place(goal)


def _rearrange(env: RobotEnv, start: EpisodeStart, fork: RecordedExecution, seed: int) -> None:
    """Brings all objects to their goals, those that are in the way aside first."""
    scene = start.scene
    robot = env.world.description
    number = len(start.goals)
    draw = SceneDraw(env.world.bank.bank, "clear", number)
    task = RearrangeProblem(
        RearrangeSetting(env.task, num_objects=number, start=draw.area, target=draw.area),
        replace(scene, support=draw.support),
        tuple(draw.names.index(name) for name in scene.names),
        tuple(grasps_of(scene.objects, robot=robot)),
        tuple(map(turn_symmetry, scene.objects)),
        draw,
        seed,
        goals=lambda _, others: start.goals[None],
        area=draw.area,
        robot=robot,
    )
    judge = RearrangementJudge(fork, scene, number, task.symmetry)
    with EpisodeView(fork, scene.names, seed) as view:
        sight = ObjectTracker(TrueObserver(), view, True, task.symmetry)
        Rearranger(task, RearrangeOptions(), fork, sight, judge).run()
