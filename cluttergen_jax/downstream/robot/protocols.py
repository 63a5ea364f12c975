"""What parts of a user's own look like to the robot: planners of paths, and grasps.

Placers: `downstream.placer.query.PlainPlacer`. Observers: `downstream.rearrange.observe.Observer`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np


@dataclass(frozen=True, eq=False)
class PathQuery:
    """A way that the arm needs, from where it is to a goal, past all that it knows of.

    Straight lines to an object, up with it and away from it are not asked for.

    Attributes:
      start, goal: f64[J], joints, radians; both are free.
      low, high: f64[J], limits of the joints, radians.
      seed: of what is drawn; equal seeds must give equal paths.
      is_free: whether the arm, its hand and what it holds keep their distance from everything at joints
        f64[J]; a few tens of microseconds.
      tool: f64[4, 4], T_world_tool at joints f64[J], metres.
    """

    start: np.ndarray
    goal: np.ndarray
    low: np.ndarray
    high: np.ndarray
    seed: int
    is_free: Callable[[np.ndarray], bool]
    tool: Callable[[np.ndarray], np.ndarray]


class PathPlanner(Protocol):
    """Finds paths; `planner=` of `robot.place` and `rearrange` takes it.

    An attribute `name` is what messages call it; `own_parts.part_label` says how its rows are told
    from those of others.
    """

    def __call__(self, query: PathQuery) -> np.ndarray | None:
        """f[L, J], joints from `start` to `goal`, both included, L at least 2; None where there is no path.

        Between two points the arm goes straight in joint space, rounded by a spline, at a speed that its
        limits allow. What it hits ends the episode.
        """


OwnGrasps = Mapping[str, Any]
"""Of each object by name: `Grasps`; or a pair of poses f[G, 7] or f[G, 4, 4], T_object_tool (metres, wxyz; z
is the approach, y the direction in which the fingers close, the origin is between their pads), and widths
f[G], metres between the fingers."""
GraspSource = str | Path | OwnGrasps
"""Grasps of a user's own, or a Parquet file as `cluttergen robot grasps` writes with --out."""
