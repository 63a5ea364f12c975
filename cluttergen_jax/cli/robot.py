"""`cluttergen robot`: grasps of a pool's objects, and objects picked up and put down."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from cluttergen_jax.cli.options import Options, options_from
from cluttergen_jax.downstream.robot.api import robot_grasps, robot_place


@options_from(robot_grasps, pool=Annotated[str, tyro.conf.Positional])
class RobotGrasps(Options):
    """Find grasps of a pool's objects for the hand of a Franka Panda, each tested in MuJoCo (extra `robot`).

    Example: `cluttergen robot grasps household --num-grasps 64`
    """

    def run(self) -> int:
        print(self.call(robot_grasps))
        return 0


@options_from(robot_place, bank=Annotated[str | None, tyro.conf.Positional], placer=str, grasps=str | None)
class RobotPlace(Options):
    """Let a simulated Franka Panda put objects into scenes, or lift them out of them (extra `robot`).

    Example: `cluttergen robot place --pool household --num-episodes 40`
    """

    def run(self) -> int:
        print(self.call(robot_place))
        return 0


@dataclass(frozen=True)
class Robot:
    """A robot arm in simulation: `robot grasps` and `robot place`.

    Example: `cluttergen robot grasps household`

    Attributes:
      action: what to do.
    """

    action: (
        Annotated[RobotGrasps, tyro.conf.subcommand("grasps")]
        | Annotated[RobotPlace, tyro.conf.subcommand("place")]
    )

    def run(self) -> int:
        return self.action.run()
