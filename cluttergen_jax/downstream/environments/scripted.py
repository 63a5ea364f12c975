"""A scripted policy: the motion of `robot place`, made in a copy of the simulation and played back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from cluttergen_jax.downstream.environments import arm as robots
from cluttergen_jax.downstream.robot.episode import stand_beside
from cluttergen_jax.downstream.robot.grasping.grasps import grasps_of
from cluttergen_jax.downstream.robot.motion.collision import PlanningWorld
from cluttergen_jax.downstream.robot.motion.mover import Mover
from cluttergen_jax.downstream.robot.outcome import Failed
from cluttergen_jax.downstream.transforms import matrix_of
from cluttergen_jax.errors import ConfigError

if TYPE_CHECKING:
    from cluttergen_jax.downstream.environments.env import RobotEnv

_WAIT = 10
"""Steps of control after the last motion."""


def plan_actions(env: RobotEnv, seed: int) -> Iterator[np.ndarray]:
    """See `scripted_actions`."""
    if env.task not in ("place", "grasp"):
        raise ConfigError(
            f"a scripted policy for {env.task!r}", "place, grasp", "cg.rearrange, which plans it"
        )
    if env.execution is None or env.start is None:
        raise ConfigError("a scripted policy of no episode", "an environment that was just reset")
    start, base = env.start, env.world.base
    scene, target = start.scene, start.target
    copy = env.execution.fork(env.substeps)
    env.action_of(copy.data.ctrl)
    stands = (stand_beside(scene.support),) if env.task == "place" else ()
    planning = PlanningWorld(scene.names, scene.objects, scene.poses, target, scene.support, base, stands)
    mover = Mover(copy, planning, robots.kinematics_of(base), target, seed)
    grasps = next(iter(grasps_of([scene.objects[target]])))
    goal = matrix_of(start.goals[target : target + 1]) if env.task == "place" else None
    # Where the planner fails the episode does, too: it goes on as far as that came.
    with suppress(Failed):
        mover.pick(mover.find_pick(grasps, goal))
        if goal is not None:
            mover.place(goal)
    commands = [*copy.commands, *[copy.data.ctrl.copy()] * _WAIT]
    return (env.action_of(ctrl) for ctrl in commands)
