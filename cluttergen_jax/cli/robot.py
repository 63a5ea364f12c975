"""`cluttergen robot`: grasps of a pool's objects, and objects picked up and put down."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from cluttergen_jax.cli.options import Options, options_from
from cluttergen_jax.downstream.robot.api import grasp_dataset, robot_grasps, robot_place


@options_from(robot_grasps, pool=Annotated[str, tyro.conf.Positional], robot=str)
class RobotGrasps(Options):
    """Find grasps of a pool's objects for the hand of a robot, each tested in MuJoCo (extra `robot`).

    Example: `cluttergen robot grasps household --num-grasps 64`
    """

    def run(self) -> int:
        print(self.call(robot_grasps))
        return 0


@options_from(
    robot_place,
    bank=Annotated[str | None, tyro.conf.Positional],
    robot=str,
    placer=str,
    grasps=str | None,
)
class RobotPlace(Options):
    """Let a simulated robot arm put objects into scenes, or lift them out of them (extra `robot`).

    Example: `cluttergen robot place --pool household --num-episodes 40`
    """

    def run(self) -> int:
        print(self.call(robot_place))
        return 0


@options_from(grasp_dataset, bank=Annotated[str, tyro.conf.Positional], robot=str)
class RobotDataset(Options):
    """Make a dataset of labelled grasps in the scenes of a bank, failures kept (extra `robot`).

    Example: `cluttergen robot dataset bank --out grasps`
    """

    def run(self) -> int:
        print(self.call(grasp_dataset))
        return 0


@dataclass(frozen=True)
class Robot:
    """A robot arm in simulation: `robot grasps`, `robot place` and `robot dataset`.

    Example: `cluttergen robot grasps household`

    Attributes:
      action: what to do.
    """

    action: (
        Annotated[RobotGrasps, tyro.conf.subcommand("grasps")]
        | Annotated[RobotPlace, tyro.conf.subcommand("place")]
        | Annotated[RobotDataset, tyro.conf.subcommand("dataset")]
    )

    def run(self) -> int:
        return self.action.run()
