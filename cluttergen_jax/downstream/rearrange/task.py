"""What an episode of rearrangement is given, and what became of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from cluttergen_jax.assets import Rectangle
from cluttergen_jax.config import Method
from cluttergen_jax.downstream.rearrange.layouts import AREA, Layouts, SceneDraw
from cluttergen_jax.downstream.robot import (
    Ending,
    Grasps,
    PathPlanner,
    RobotDescription,
    find_robot,
)
from cluttergen_jax.downstream.words import LayoutRule, PickOrder
from cluttergen_jax.scene import Scene

_NEAR = Rectangle((0.0, -0.15), (0.225, 0.125))
_FAR = Rectangle((0.0, 0.15), (0.225, 0.125))
"""The paper's: 0.45 m x 0.25 m about y = +0.15 m."""


@dataclass(frozen=True)
class RearrangeSetting:
    """A kind of rearrangement; all on the usual table, in the world frame, region-centred.

    Attributes:
      name: of the setting.
      num_objects: that shall be moved; num_others: that stand in the target and shall stay.
      start, target: where objects stand at first, and where their layouts are drawn.
      method: how the starting scene is made.
      num_stacked: objects that lie on others at the start, at least; the arm gets at the topmost.
    """

    name: str
    num_objects: int = 5
    num_others: int = 0
    start: Rectangle = _NEAR
    target: Rectangle = _FAR
    method: Method = "clear"
    num_stacked: int = 0

    @property
    def num_slots(self) -> int:
        """Objects in all."""
        return self.num_objects + self.num_others


@dataclass(frozen=True)
class RearrangeOptions:
    """How a rearrangement is done.

    Attributes:
      choose: the rule by which a layout is chosen. layout: its number instead; None goes by the rule.
      num_layouts: from how many unlike ones.
      relook: look again after each move, and try again what went wrong.
      order: "graph", or "lowest" object first as in the paper, whatever is in the way.
      one_grasp: an object has a single grasp, at 0 and 180 degrees, as in the paper.
    """

    choose: LayoutRule = "clearance"
    layout: int | None = None
    num_layouts: int = 10
    relook: bool = True
    order: PickOrder = "graph"
    one_grasp: bool = False


SETTINGS = {
    each.name: each
    for each in (
        RearrangeSetting("paper"),
        RearrangeSetting("occupied", num_others=3),
        RearrangeSetting(
            "blocked",
            start=Rectangle((0.0, 0.0), (0.2, 0.15)),
            target=Rectangle((0.0, 0.0), (0.2, 0.15)),
        ),
        RearrangeSetting(
            "eight",
            num_objects=8,
            start=Rectangle((0.0, -0.16), (0.25, 0.15)),
            target=Rectangle((0.0, 0.16), (0.25, 0.15)),
        ),
        RearrangeSetting(
            "stacked",
            start=Rectangle((0.0, -0.15), (0.15, 0.1)),
            method="drop",
            num_stacked=1,
        ),
    )
}


@dataclass(frozen=True, eq=False)
class RearrangeProblem:
    """What is to be rearranged.

    Attributes:
      setting: of what kind.
      scene: N objects as they stand; the first `setting.num_objects` are to be moved.
      numbers: i[N], of these in the pool that `draw` knows.
      grasps: of each of the N. symmetry: of each (`assets.symmetry.turn_symmetry`).
      draw: draws layouts and places to wait.
      seed: of all that is drawn.
      planner: a user's own, for the paths between places.
      goals: draws layouts of what is moved, f64[L, n, 7], given how often it has drawn before and where the
        others stand, f64[m, 7]; None draws them in the setting's target.
      area: where an object may wait.
      robot: that does it.
    """

    setting: RearrangeSetting
    scene: Scene
    numbers: tuple[int, ...]
    grasps: tuple[Grasps, ...]
    symmetry: tuple[int, ...]
    draw: SceneDraw
    seed: int
    planner: PathPlanner | None = None
    goals: Callable[[int, np.ndarray], np.ndarray] | None = None
    area: Rectangle = AREA
    robot: RobotDescription = field(default_factory=find_robot)


Chooser = Callable[[RearrangeProblem, np.ndarray, Layouts], int]
"""Chooses a layout by number, shown where the N objects are f64[N, 7] and what layouts there are."""


@dataclass(frozen=True)
class RearrangeResult(Ending):
    """What became of an episode.

    Attributes:
      setting: its name. objects: that were to be moved; right: which of them are where they should be.
      picks: how often an object was picked up; fewest: the fewest that could do, for all layouts that were
        tried.
      waits: how often one was put down elsewhere; retries: picked up again because something went wrong.
      looks: how often all objects were looked for. layouts: how many were tried.
      error, turn_error: the largest of metres and radians from the layout among those that are right; nan if
        none is.
      path: metres that the tool moved. seconds: simulated time. cpu: seconds of this process.
      layout: the number of the layout that was tried last, -1 if none was. chosen_by: the rule that chose it,
        "number" or "person".
    """

    setting: str
    objects: list[str]
    right: list[bool]
    picks: int
    fewest: int
    waits: int
    retries: int
    looks: int
    layouts: int
    error: float
    turn_error: float
    path: float
    seconds: float
    cpu: float
    layout: int = -1
    chosen_by: str = ""
