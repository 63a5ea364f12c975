"""Where an object may be put: proposals of a method that knows the scene, and of a placer that sees it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from cluttergen_jax.assets import Rectangle
from cluttergen_jax.downstream.bank_scenes import check_one_level
from cluttergen_jax.downstream.noise import REALSENSE
from cluttergen_jax.downstream.placer.map_from_depth import DepthView, QueryMaker
from cluttergen_jax.downstream.placer.partial_scenes import PartialScenes, ProposalJudge, world_pose
from cluttergen_jax.downstream.placer.proposers import FullState, proposals_of
from cluttergen_jax.downstream.placer.query import (
    PlacementQuery,
    Placer,
    PlainPlacer,
    ask_plain,
    check_proposals,
    is_plain,
)
from cluttergen_jax.downstream.robot.cameras import above
from cluttergen_jax.downstream.robot.motion.collision import (
    CELL,
    OccupancyBoxes,
    occupancy_boxes,
)
from cluttergen_jax.downstream.transforms import matrix_of
from cluttergen_jax.generation import setup_of
from cluttergen_jax.geometry import Array
from cluttergen_jax.numerics import new_key
from cluttergen_jax.own_parts import is_own
from cluttergen_jax.physics import Verdict
from cluttergen_jax.placement import Candidates, Rules, lower_onto
from cluttergen_jax.scene import Bank, Scene
from cluttergen_jax.sensing import Camera, merge_maps


class SearchPlaces:
    """Places that a method of `generate` finds for the last object of scenes, knowing the others.

    The first is where the scene itself has it; then come proposals that stand, as attempts are judged, where
    they came to rest.

    Args:
      bank: whose scenes.
      method: "drop", "guided" or "policy".
      seed: of proposals.
      num_threads: simulation threads; 0 takes every core.

    Attributes:
      name: the method's.
    """

    def __init__(self, bank: Bank, method: str, seed: int, num_threads: int = 0) -> None:
        self.name = method
        self._scenes = PartialScenes(bank, num_threads)
        self._judge = ProposalJudge(self._scenes.rules)
        rules, propose = FullState(method).in_world(self._scenes.problem)
        # A policy reads episodes with the history of attempts that it was trained with.
        self._rules: Rules = rules
        self._propose: Any = jax.jit(
            lambda key, episode: proposals_of(propose, key, episode, rules).pose
        )
        self._key = new_key(seed)

    def __call__(self, index: int, scene: Scene) -> np.ndarray:
        """f64[M, 7]: T_world_object for the last object of a scene of the bank, best first."""
        row = int(np.flatnonzero(self._scenes.number == scene.origin.index)[0])
        slot = len(scene.names) - 1
        episodes = self._scenes.episodes(np.array([[row, slot]]))
        if episodes.orientation is not None:
            # Of scenes in which others lie: what the arm holds is upright.
            episodes = episodes.replace(orientation=jax.numpy.zeros_like(episodes.orientation))
        own = self._scenes.episodes(np.array([[row, slot]]), self._rules)
        own = own.replace(orientation=episodes.orientation)
        episode = jax.tree.map(lambda leaf: leaf[0], own)
        pose = np.asarray(self._propose(jax.random.fold_in(self._key, index), episode))
        judged = self._judge.settle(episodes, np.zeros(len(pose), np.int64), pose)
        focus = int(self._scenes.object_index[row, slot])
        stands = judged.poses[judged.verdict == int(Verdict.STABLE), focus]
        return np.concatenate([scene.poses[-1:], np.asarray(stands, np.float64)])


class CameraPlacer:
    """A placer that is asked by pictures of the robot's cameras.

    Args:
      bank: whose scenes; of it the support, the region and the object that is to be placed are known.
      placer: is asked. name: as rows have it.
      noise: of the depth cameras, so many times that of a usual one; 0 for none.

    Attributes:
      overhead: the camera over the table, which sees all of it that objects in the region can reach.
    """

    def __init__(self, bank: Bank, placer: Placer | PlainPlacer, name: str, noise: float) -> None:
        check_one_level(bank.support, "a placer")
        problem = setup_of(bank, engine="native", num_threads=1).problem
        support = problem.world.support
        region = problem.region
        self.name = name
        self._noise = REALSENSE.scale(noise)
        self._names = problem.world.names
        self._maker = QueryMaker(problem)
        self._grid = self._maker.grid_of(CELL)
        half_x, half_y = np.abs(self._maker.grid.corner).tolist()
        seen = Rectangle(region.center, (half_x, half_y), region.yaw)
        self.overhead = above(replace(support, region=seen))
        self._placer = placer
        self._compiled = jax.jit(lambda key, query: placer(key, query))
        self._lower: Any = jax.jit(_lower_poses)
        self._world: Any = jax.jit(jax.vmap(world_pose, in_axes=(None, 0)))
        self._region = problem.rules.region

    def measure(self, depth: np.ndarray, camera: Camera, rng: np.random.Generator) -> DepthView:
        """A picture f32[H, W] with noise, its stated pose corrected by the table's top."""
        return self._maker.measure(depth, camera, self._noise, rng)

    def columns(self, views: Sequence[DepthView]) -> OccupancyBoxes:
        """What the arm has to avoid."""
        return occupancy_boxes(
            merge_maps([self._maker.partial(*view, self._noise, self._grid) for view in views])
        )

    def propose(
        self, views: Sequence[DepthView], name: str, seed: int, last: np.ndarray | None = None
    ) -> np.ndarray:
        """f32[M, 4]: x, y, z and yaw of T_region_object, best first, each lowered onto what was seen.

        Those with their middle outside the region are left out.

        Args:
          name: the object's.
          last: f32[4], a proposal of before that takes the place of the last one.
        """
        sight = self._maker.fuse(views, self._noise, np.random.default_rng(seed))
        query = self._maker.query(sight, self._names.index(name))
        pose = self._ask(new_key(seed), query)
        if last is not None:
            pose = np.concatenate([pose[: max(1, len(pose) - 1)], last[None]])
        pose = np.asarray(self._lower(pose, query))
        is_inside = (np.abs(pose[:, :2]) <= np.asarray(query.region_half_extents)).all(1)
        return pose[is_inside & np.isfinite(pose).all(1)]

    def _ask(self, key: Array, query: PlacementQuery) -> np.ndarray:
        """f32[M, 4]. Raises ConfigError: a user's placer returned something else."""
        if is_plain(self._placer):
            return np.array(ask_plain(self._placer, key, query).pose)
        found: Any = self._compiled(key, query)
        return np.array((check_proposals(found, self.name) if is_own(self._placer) else found).pose)

    def in_world(self, pose: np.ndarray) -> np.ndarray:
        """f64[M, 4, 4]: T_world_object of proposals f32[M, 4]."""
        if not len(pose):
            return np.zeros((0, 4, 4))
        return matrix_of(np.asarray(self._world(self._region, pose)))


def _lower_poses(pose: Array, query: PlacementQuery) -> Array:
    """Proposals f32[M, 4] lowered to first contact with the map of what was seen."""
    fit = lower_onto(query.under, query.heights, Candidates(pose[:, :2], pose[:, 3]))
    return pose.at[:, 2].set(fit.rest)
