"""Places that a placer proposes by what the robot's cameras saw, and what the arm is planned around."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.downstream.placer.judge import world_pose
from cluttergen_jax.downstream.placer.query import PlacementQuery, Placer
from cluttergen_jax.downstream.placer.sight import QueryMaker
from cluttergen_jax.downstream.robot.cameras import above
from cluttergen_jax.downstream.robot.frames import matrix_of
from cluttergen_jax.downstream.robot.motion.columns import CELL, Columns, columns_of
from cluttergen_jax.generation.sources.replay import setup_of
from cluttergen_jax.numerics import new_key
from cluttergen_jax.placement.search.fit import Candidates, lower_onto
from cluttergen_jax.scene.bank.bank import Bank
from cluttergen_jax.sensing.camera import Camera
from cluttergen_jax.sensing.noise import REALSENSE
from cluttergen_jax.sensing.partial import merged
from cluttergen_jax.types import Array

View = tuple[np.ndarray, Camera]
"""A depth image f32[H, W] as it was measured, and the camera where it is believed to stand."""


class CameraPlacer:
    """A placer that is asked by pictures of the robot's cameras.

    Args:
      bank: whose scenes; of it the support, the region and the object that is to be placed are known.
      placer: is asked. name: as rows have it.
      noise: of the depth cameras, so many times that of a usual one; 0 for none.

    Attributes:
      overhead: the camera over the table, which sees all of it that objects in the region can reach.
    """

    def __init__(self, bank: Bank, placer: Placer, name: str | Path, noise: float) -> None:
        problem = setup_of(bank, engine="native", num_threads=1).problem
        support, region = problem.world.support, problem.region
        self.name, self._noise = str(name), REALSENSE.scaled(noise)
        self._names = problem.world.names
        self._maker = QueryMaker(problem)
        self._grid = self._maker.grid_of(CELL)
        half_x, half_y = np.abs(self._maker.grid.corner).tolist()
        seen = Rectangle(region.center, (half_x, half_y), region.yaw)
        self.overhead = above(replace(support, region=seen))
        self._ask: Any = jax.jit(lambda key, query: placer(key, query).pose)
        self._lower: Any = jax.jit(_lowered)
        self._world: Any = jax.jit(jax.vmap(world_pose, in_axes=(None, 0)))
        self._region = problem.rules.region

    def measured(self, depth: np.ndarray, camera: Camera, rng: np.random.Generator) -> View:
        """A picture f32[H, W] with noise, its stated pose corrected by the table's top."""
        return self._maker.measured(depth, camera, self._noise, rng)

    def columns(self, views: Sequence[View]) -> Columns:
        """What the arm has to avoid."""
        return columns_of(merged([self._maker.partial(*view, self._noise, self._grid) for view in views]))

    def propose(
        self, views: Sequence[View], name: str, seed: int, last: np.ndarray | None = None
    ) -> np.ndarray:
        """f32[M, 4]: x, y, z and yaw of T_region_object, best first, each lowered onto what was seen.

        Those with their middle outside the region are left out.

        Args:
          name: the object's.
          last: f32[4], a proposal of before that takes the place of the last one.
        """
        sight = self._maker.fused(views, self._noise, np.random.default_rng(seed))
        query = self._maker.query(sight, self._names.index(name))
        pose = np.array(self._ask(new_key(seed), query))
        if last is not None:
            pose[-1] = last
        pose = np.asarray(self._lower(pose, query))
        is_inside = (np.abs(pose[:, :2]) <= np.asarray(query.region_half_extents)).all(1)
        return pose[is_inside & np.isfinite(pose).all(1)]

    def in_world(self, pose: np.ndarray) -> np.ndarray:
        """f64[M, 4, 4]: T_world_object of proposals f32[M, 4]."""
        if not len(pose):
            return np.zeros((0, 4, 4))
        return matrix_of(np.asarray(self._world(self._region, pose)))


def _lowered(pose: Array, query: PlacementQuery) -> Array:
    """Proposals f32[M, 4] lowered to first contact with the map of what was seen."""
    fit = lower_onto(query.under, query.heights, Candidates(pose[:, :2], pose[:, 3]))
    return pose.at[:, 2].set(fit.rest)
