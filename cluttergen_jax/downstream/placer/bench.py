"""Proposals judged on the queries of one split, and tables that placers fill by themselves."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np

from cluttergen_jax.downstream.fitting import concatenate, in_parts
from cluttergen_jax.downstream.noise import NoiseConfig
from cluttergen_jax.downstream.placer.map_from_depth import QueryMaker, SceneCameras, check_cameras
from cluttergen_jax.downstream.placer.pairs import PairLabels, stack_queries
from cluttergen_jax.downstream.placer.partial_scenes import (
    PartialScenes,
    ProposalJudge,
    episode_of,
    judging_rules,
)
from cluttergen_jax.downstream.placer.proposers import FullState, proposals_of
from cluttergen_jax.downstream.placer.query import (
    PlacementQuery,
    Placer,
    PlainPlacer,
    Proposals,
    ask_plain,
    check_proposals,
    is_plain,
)
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import Array
from cluttergen_jax.numerics import new_key
from cluttergen_jax.own_parts import is_own, part_name
from cluttergen_jax.physics import PaperCount, Verdict
from cluttergen_jax.placement import (
    CLEARANCE,
    Candidates,
    Episode,
    HeightMapper,
    KeepOut,
    Rules,
    Setup,
    from_pose,
    lower_onto,
    to_pose,
    under_side,
)
from cluttergen_jax.progress import Progress, interruptible
from cluttergen_jax.statistics import proportion

_AT_ONCE = 250


class ProposalOutcomes(NamedTuple):
    """What became of the proposals for P queries, M each.

    Attributes:
      pose: f32[P, M, 4]; score: f32[P, M], see `Proposals`.
      verdict: i32[P, M], `types.Verdict` of the attempt, CREPT where it was stable and the scene did not
        stand; NONE of proposals that were not tried, since one before them was good.
      has_margin: bool[P], the first one is good and has the margin that scenes are made with.
      is_quiet: bool[P], the first one counts as in the paper.
      z_error: f32[P], metres, how much higher the first one is let go than it would be on the true map.
    """

    pose: np.ndarray
    score: np.ndarray
    verdict: np.ndarray
    has_margin: np.ndarray
    is_quiet: np.ndarray
    z_error: np.ndarray


class Bench:
    """The queries of one split in their world, ready to judge proposals.

    Args:
      setup: the world; labels: the truth about its P queries; num_threads: 0 takes every core.
    """

    def __init__(self, setup: Setup, labels: PairLabels, num_threads: int = 0) -> None:
        self.labels = labels
        self.problem = setup.problem
        self._keep_out = setup.keep_out
        self._rules = judging_rules(setup.problem)
        self._episodes = self._of(self._rules)
        self._judge = ProposalJudge(self._rules)
        self._count = PaperCount(
            setup.problem.world.layout, self._rules.physics.config, num_threads
        )
        self._above: Any = jax.jit(jax.vmap(_height_above, in_axes=(None, None, 0, 0)))
        self._mapper = HeightMapper.of(self._rules.geometry, self._rules.region)

    def _of(self, rules: Rules) -> Episode:
        made: Any = jax.jit(jax.vmap(_episode, in_axes=(None, None, 0, 0, 0)))
        labels = self.labels
        return made(rules, self._keep_out, labels.order, labels.poses, labels.num_standing)

    def proposals(
        self, placer: Placer | PlainPlacer | FullState, queries: PlacementQuery, seed: int
    ) -> Proposals:
        """Every query's proposals, NumPy arrays; its key is made of the seed and its pair's number.

        Raises:
          PoolError: a full-state method has no checkpoint for the pool.
        """
        keys = jax.vmap(lambda pair: jax.random.fold_in(new_key(seed), pair))(self.labels.pair)
        if not isinstance(placer, FullState):
            return answers(placer, keys, queries)
        rules, propose = placer.in_world(self.problem)
        answer: Any = jax.jit(jax.vmap(partial(proposals_of, rules=rules), in_axes=(None, 0, 0)))
        return interruptible(_in_parts, answer, propose, keys, self._of(rules))

    def judge(self, proposals: Proposals) -> ProposalOutcomes:
        """Tries each query's proposals, best first, until one is good."""
        num_queries, num_proposals = proposals.score.shape
        verdict = np.full((num_queries, num_proposals), int(Verdict.NONE), np.int32)
        has_margin = np.zeros(num_queries, bool)
        left = np.arange(num_queries)
        for place in range(num_proposals):
            if not len(left):
                break
            judged = self._judge.settle(self._episodes, left, proposals.pose[left, place])
            is_good = self._judge.stand(judged)
            falls = (judged.verdict == int(Verdict.STABLE)) & ~is_good
            verdict[left, place] = np.where(falls, int(Verdict.CREPT), judged.verdict)
            if place == 0:
                has_margin = is_good & judged.has_margin
            left = left[~is_good]
        first = proposals.pose[:, 0]
        z_error = np.asarray(self._above(self._mapper, self._rules, self._episodes, first))
        return ProposalOutcomes(
            *proposals_arrays(proposals), verdict, has_margin, self._is_quiet(first), z_error
        )

    def _is_quiet(self, pose: np.ndarray) -> np.ndarray:
        """bool[P]: whether one proposal for each query, f32[P, 4], counts as in the paper."""
        rows = np.arange(len(pose))
        return self._count(*self._judge.release(self._episodes, rows, pose)[:2])

    def is_own_quiet(self) -> np.ndarray:
        """bool[P]: whether the scene's own object, where it rests, counts as in the paper."""
        target = self.labels.target
        poses, is_placed, focus = self._judge.release(
            self._episodes, np.arange(len(target)), np.zeros((len(target), 4), np.float32)
        )
        own = jax.vmap(lambda region, pose: to_pose(region.T_world_region @ from_pose(pose)))
        poses = poses.copy()
        poses[np.arange(len(target)), focus] = own(self._episodes.region, target)
        return self._count(poses, is_placed)


def proposals_arrays(proposals: Proposals) -> tuple[np.ndarray, np.ndarray]:
    """Poses and scores as they are stored."""
    return np.asarray(proposals.pose, np.float32), np.asarray(proposals.score, np.float32)


def _episode(
    rules: Rules, keep_out: KeepOut, order: Array, poses: Array, num_standing: Array
) -> Episode:
    """The episode behind a query; poses are T_region_object."""
    world = jax.vmap(lambda pose: to_pose(rules.region.T_world_region @ from_pose(pose)))(poses)
    return episode_of(rules, keep_out, order, world, num_standing)


def _height_above(mapper: HeightMapper, rules: Rules, episode: Episode, pose: Array) -> Array:
    heights = mapper(episode.region, episode.poses, episode.is_placed)
    under = under_side(rules.body(episode))
    fit = lower_onto(under, heights, Candidates(pose[None, :2], pose[None, 3]))
    return pose[2] - fit.rest[0] - CLEARANCE


_answers: Any = jax.jit(
    jax.vmap(lambda placer, key, query: placer(key, query), in_axes=(None, 0, 0))
)
"""Placers are arguments: those of equal sizes share what is compiled."""


def answers(placer: Placer | PlainPlacer, keys: Array, queries: PlacementQuery) -> Proposals:
    """What a placer proposes for many queries, NumPy arrays; one key for each.

    Raises:
      ConfigError: a user's placer returned something else (`check_proposals`).
    """
    if not is_plain(placer):
        found = interruptible(_in_parts, _answers, placer, keys, queries)
        return check_proposals(found, part_name(placer)) if is_own(placer) else found
    queries = jax.tree.map(np.asarray, queries)
    told = [
        ask_plain(placer, key, jax.tree.map(lambda leaf, row=row: leaf[row], queries))
        for row, key in enumerate(keys)
    ]
    if len(numbers := {len(each.score) for each in told}) > 1:
        given = f"placer {part_name(placer)!r} returned {min(numbers)} to {max(numbers)} proposals"
        raise ConfigError(given, "as many for every query")
    return jax.tree.map(lambda *leaves: np.stack(leaves), *told)


def _in_parts(answer: Any, placer: Any, keys: Array, asked: Any) -> Proposals:
    """The answers to many queries, some at a time."""

    def call(part: Any) -> Any:
        return answer(placer, *part)

    return concatenate(list(in_parts(call, (keys, asked), min(_AT_ONCE, len(keys)))))


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
