"""Chains of placements: a table filled object after object by what the camera sees after each of them."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from cluttergen_jax.downstream.noise import NoiseConfig
from cluttergen_jax.downstream.placer.evaluation.bench import answers
from cluttergen_jax.downstream.placer.map_from_depth import QueryMaker
from cluttergen_jax.downstream.placer.pairs.store import stack_queries
from cluttergen_jax.downstream.placer.partial_scenes import PartialScenes, ProposalJudge
from cluttergen_jax.downstream.placer.query import PlacementQuery, Placer, PlainPlacer
from cluttergen_jax.downstream.placer.scene_cameras import SceneCameras, check_cameras
from cluttergen_jax.numerics import new_key
from cluttergen_jax.placement import Episode
from cluttergen_jax.progress import Progress
from cluttergen_jax.statistics import proportion
from cluttergen_jax.types import Verdict


class Chains:
    """Fills tables with the objects of a bank's scenes, in their order, from nothing, by one placer.

    Each scene has cameras of its own. An object's proposals are tried in turn; the first that is stable
    stays, as it settled, and the camera looks again. Where none is, the chain has failed.

    Args:
      scenes: whose objects and order; at most `num_chains` of them.
      camera: a preset's name; num_cameras: of each scene, their maps fused.
      noise: of the depth camera; seed: of cameras, noise and proposals.
    """

    def __init__(
        self,
        scenes: PartialScenes,
        num_chains: int,
        camera: str,
        noise: NoiseConfig,
        seed: int,
        num_threads: int = 0,
        num_cameras: int = 1,
    ) -> None:
        check_cameras(num_cameras, camera)
        self._scenes = scenes
        self._noise = noise
        self._seed = seed
        self.num_chains = min(num_chains, len(scenes.number))
        self._looks = SceneCameras(scenes.problem, camera)
        self._cameras = [
            self._looks.draw_cameras((seed, row, 3), num_cameras) for row in range(self.num_chains)
        ]
        self._maker = QueryMaker(scenes.problem)
        self._judge = ProposalJudge(scenes.rules)
        self._pool = ThreadPoolExecutor(num_threads or os.cpu_count())

    def run(self, placer: Placer | PlainPlacer) -> dict[str, Any]:
        """How far the placer gets: `success`, whole tables that stand; `placed`, objects; `by_slot`."""
        order = self._scenes.object_index[: self.num_chains]
        num_slots = int((order >= 0).sum(1).max())
        episodes = self._scenes.episodes(
            np.column_stack([np.arange(self.num_chains), np.zeros(len(order), int)])
        )
        alive = np.ones(self.num_chains, bool)
        placed = np.zeros(self.num_chains, int)
        by_slot = []
        with Progress("filling tables", self.num_chains * num_slots, "placement") as progress:
            for slot in range(num_slots):
                rows = np.flatnonzero(alive & (order[:, slot] >= 0))
                if not len(rows):
                    break
                episodes, is_good = self._place(placer, episodes, rows, slot)
                by_slot.append(
                    {"standing": slot, "chains": len(rows), "share": float(is_good.mean())}
                )
                placed[rows] += is_good
                alive[rows] = is_good
                progress.update(self.num_chains)
        is_whole = placed == (order >= 0).sum(1)
        physics: Any = self._scenes.rules.simulator
        state = np.asarray(episodes.poses), np.asarray(episodes.is_placed)
        stands = physics.stand_batch(*state, is_whole).verdict == int(Verdict.STABLE)
        return {"success": proportion(stands), "placed": float(placed.mean()), "by_slot": by_slot}

    def _place(
        self, placer: Placer | PlainPlacer, episodes: Episode, rows: np.ndarray, slot: int
    ) -> tuple[Episode, np.ndarray]:
        """The episodes after one object more in some of them, and in which of these it stands."""
        state = np.asarray(episodes.poses), np.asarray(episodes.is_placed)
        queries = stack_queries(
            list(self._pool.map(lambda row: self._query(row, slot, *state), rows))
        )
        key = jax.random.fold_in(new_key(self._seed), slot)
        keys = jax.vmap(lambda row: jax.random.fold_in(key, row))(rows)
        proposals = answers(placer, keys, queries)
        poses, is_placed = (each.copy() for each in state)
        is_good = np.zeros(len(rows), bool)
        left = np.arange(len(rows))
        for place in range(proposals.score.shape[1]):
            if not len(left):
                break
            judged = self._judge.settle(episodes, rows[left], proposals.pose[left, place])
            good = judged.verdict == int(Verdict.STABLE)
            at = rows[left[good]]
            poses[at] = judged.poses[good]
            is_placed[at] = judged.is_placed[good]
            is_good[left[good]] = True
            left = left[~good]
        slots = np.asarray(episodes.slot).copy()
        slots[rows[is_good]] += 1
        poses = np.where(is_placed[..., None], poses, state[0])
        return episodes.replace(poses=poses, is_placed=is_placed, slot=slots), is_good

    def _query(
        self, row: int, slot: int, poses: np.ndarray, is_placed: np.ndarray
    ) -> PlacementQuery:
        rng = np.random.default_rng((self._seed, row, slot, 4))
        views = self._looks.views(poses[row], is_placed[row], self._cameras[row])
        sight = self._maker.see_all(views, self._noise, rng)
        return self._maker.query(sight, int(self._scenes.object_index[row, slot]))
