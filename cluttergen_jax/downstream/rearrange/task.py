"""What an episode of rearrangement is given, and what became of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cluttergen_jax.downstream.rearrange.layouts import Layouts, SceneDraw
from cluttergen_jax.downstream.rearrange.settings import RearrangeSetting
from cluttergen_jax.downstream.robot.grasping.grasps import Grasps
from cluttergen_jax.downstream.robot.outcome import Outcome
from cluttergen_jax.scene import Scene


@dataclass(frozen=True, eq=False)
class RearrangeTask:
    """What is to be rearranged.

    Attributes:
      setting: of what kind.
      scene: N objects as they stand; the first `setting.num_objects` are to be moved.
      numbers: i[N], of these in the pool that `draw` knows.
      grasps: of each of the N. symmetry: of each (`symmetry.turn_symmetry`).
      draw: draws layouts and places to wait.
      seed: of all that is drawn.
    """

    setting: RearrangeSetting
    scene: Scene
    numbers: tuple[int, ...]
    grasps: tuple[Grasps, ...]
    symmetry: tuple[int, ...]
    draw: SceneDraw
    seed: int


Chooser = Callable[[RearrangeTask, np.ndarray, Layouts], int]
"""Chooses a layout by number, shown where the N objects are f64[N, 7] and what layouts there are."""


@dataclass(frozen=True)
class RearrangeResult:
    """What became of an episode.

    Attributes:
      outcome: "success", an `Outcome` or a `Cause`, as text; detail: of what, in words.
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

    outcome: str
    detail: str
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

    @property
    def is_success(self) -> bool:
        """Nothing went wrong."""
        return self.outcome == Outcome.SUCCESS
