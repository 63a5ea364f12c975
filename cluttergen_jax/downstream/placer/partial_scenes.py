"""Partial scenes of a bank, and what becomes of an object that is let go in one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np

from cluttergen_jax.downstream.bank_scenes import StableScenes
from cluttergen_jax.errors import BankError
from cluttergen_jax.generation import setup_of
from cluttergen_jax.geometry import Array
from cluttergen_jax.numerics import new_key
from cluttergen_jax.physics import Verdict
from cluttergen_jax.placement import (
    MIN_MARGIN,
    Episode,
    KeepOut,
    Problem,
    Region,
    Rules,
    Start,
    to_pose,
)
from cluttergen_jax.scene import Bank


class PartialScenes:
    """The scenes of a bank that stand, each to be looked at before any of its objects was placed.

    S scenes of N slots, in a world of K objects.

    Args:
      bank: its scenes are judged natively, by its own rules, but for the margin that it asked for.
      num_threads: simulation threads; 0 takes every core.

    Attributes:
      problem: the world; rules: those of a proposal (no support margin is asked for).
      number: i32[S], of the scenes in the bank.
      object_index: i32[S, N], the objects in the order of placement, -1 is padding.
      poses: f32[S, N, 7], T_world_object, metres, wxyz.

    Raises:
      BankError: no scene stands, or the bank does not say how it was made.
    """

    def __init__(self, bank: Bank, num_threads: int = 0) -> None:
        setup = setup_of(bank, engine="native", num_threads=num_threads)
        self.bank = bank
        self.problem = setup.problem
        self.keep_out = setup.keep_out
        self.rules = judging_rules(setup.problem)
        stable = StableScenes.read(bank)
        self.number = stable.number.astype(np.int32)
        self.object_index = stable.objects.astype(np.int32)
        self.poses = stable.poses.astype(np.float32)
        if names := bank.recipe.get("names") if bank.recipe.get("shelf") else None:
            number = {name: place for place, name in enumerate(setup.problem.world.names)}
            local = np.array([*(number.get(name, -1) for name in names), -1], np.int32)
            self.object_index = local[self.object_index]
        num_slots = self.object_index.shape[1]
        most = self.object_index.max()
        if num_slots != self.rules.num_slots or most >= self.rules.geometry.num_objects:
            raise BankError(f"{bank.path}: its scenes are not of the objects that its record names")
        self._episodes: Any = jax.jit(jax.vmap(episode_of, in_axes=(None, None, 0, 0, 0)))

    @property
    def num_queries(self) -> int:
        """Pairs of a scene and a slot."""
        return int((self.object_index >= 0).sum())

    def places(self) -> np.ndarray:
        """i64[num_queries, 2]: scene (its row here) and slot of each query, in the order of the bank."""
        return np.argwhere(self.object_index >= 0)

    def episodes(self, places: np.ndarray, rules: Rules | None = None) -> Episode:
        """The episodes before the objects at `places`, i64[Q, 2], were placed; leading axis Q.

        Args:
          rules: of the episodes; those of judging if not given.
        """
        scene = places[:, 0]
        slot = places[:, 1].astype(np.int32)
        rules = rules or self.rules
        return self._episodes(
            rules, self.keep_out, self.object_index[scene], self.poses[scene], slot
        )


def judging_rules(problem: Problem) -> Rules:
    """The rules by which a proposal is judged: the problem's own, without margin and history."""
    config = replace(problem.config.placement, min_margin=0.0, history_stride=0)
    return replace(problem.rules, config=config)


def episode_of(
    rules: Rules, keep_out: KeepOut, object_index: Array, poses: Array, slot: Array
) -> Episode:
    """An episode whose first `slot` objects stand.

    Args:
      object_index: i32[N], the order of placement, padded with -1.
      poses: f32[N, 7], T_world_object.
      slot: i32, of the current object.
    """
    episode = rules.begin(new_key(0), rules.region, keep_out)
    num_objects = rules.geometry.num_objects
    is_before = (jnp.arange(object_index.shape[0]) < slot) & (object_index >= 0)
    place = jnp.where(is_before, object_index, num_objects)
    return episode.replace(
        object_index=object_index,
        slot=slot,
        poses=Start.empty(num_objects).poses.at[place].set(poses, mode="drop"),
        is_placed=jnp.zeros(num_objects, bool).at[place].set(True, mode="drop"),
    )


_AT_ONCE = 2048
"""Attempts that are settled together; fewer are filled up, so that one program serves all."""


class JudgedProposals(NamedTuple):
    """What became of P proposals.

    Attributes:
      verdict: i32[P], a `Verdict` of the attempt, as docs/contract.md says, no support margin asked for.
      has_margin: bool[P], it is stable and has the support margin that scenes are made with.
      poses: f32[P, K, 7], T_world_object of all objects afterwards.
      is_placed: bool[P, K], the object included.
    """

    verdict: np.ndarray
    has_margin: np.ndarray
    poses: np.ndarray
    is_placed: np.ndarray


class ProposalJudge:
    """Lets objects go in partial scenes and says what becomes of them, many at once.

    Args:
      rules: of the world, their physics native (`partial_scenes.judging_rules`).
    """

    def __init__(self, rules: Rules) -> None:
        self.rules = rules
        self._release: Any = jax.jit(jax.vmap(_at_release, in_axes=(None, 0, 0)))
        self._verdict: Any = jax.jit(jax.vmap(_verdict, in_axes=(None, 0, 0)))

    def settle(self, episodes: Episode, scene: np.ndarray, pose: np.ndarray) -> JudgedProposals:
        """One attempt for each of P proposals.

        Args:
          episodes: partial scenes, leading axis S.
          scene: i[P], which of them each proposal is for.
          pose: f32[P, 4], x, y, z and yaw of T_region_object.
        """
        parts = []
        for first in range(0, len(scene), _AT_ONCE):
            rows = np.minimum(np.arange(first, first + _AT_ONCE), len(scene) - 1)
            num = min(_AT_ONCE, len(scene) - first)
            parts.append(self._settle(episodes, scene[rows], pose[rows], num))
        return JudgedProposals(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))

    def release(
        self, episodes: Episode, scene: np.ndarray, pose: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The scenes at the moment of release: f32[P, K, 7], world; bool[P, K]; i32[P], the object's index.

        Args: as those of `settle`.
        """
        chosen = jax.tree.map(lambda leaf: leaf[scene], episodes)
        poses, is_placed, focus = (
            np.asarray(each) for each in self._release(self.rules, chosen, pose)
        )
        return poses, is_placed, focus

    def _settle(
        self, episodes: Episode, scene: np.ndarray, pose: np.ndarray, num: int
    ) -> JudgedProposals:
        chosen = _take(episodes, scene)
        asked = [np.asarray(each) for each in self._release(self.rules, chosen, pose)]
        is_active = np.arange(len(scene)) < num
        physics: Any = self.rules.simulator
        settling = physics.settle_batch(*asked, is_active)
        verdict, has_margin = self._verdict(self.rules, chosen, settling.replace(trajectory=None))
        found = JudgedProposals(
            np.asarray(verdict), np.asarray(has_margin), settling.poses, asked[1]
        )
        return JudgedProposals(*(each[:num] for each in found))

    def stand(self, judged: JudgedProposals) -> np.ndarray:
        """bool[P]: stable proposals whose partial scene also stands as a whole, everything awake."""
        physics: Any = self.rules.simulator
        is_active = judged.verdict == int(Verdict.STABLE)
        standing = physics.stand_batch(judged.poses, judged.is_placed, is_active)
        return np.asarray(standing.verdict) == int(Verdict.STABLE)


_take: Any = jax.jit(lambda episodes, scene: jax.tree.map(lambda leaf: leaf[scene], episodes))
"""Some of the episodes: one program for all parts of one size."""


def world_pose(region: Region, pose: Array) -> Array:
    """f32[7], T_world_object of a proposal f32[4] in the region frame."""
    T_region_object = jaxlie.SE3.from_rotation_and_translation(
        jaxlie.SO3.from_z_radians(pose[3]), pose[:3]
    )
    return to_pose(region.T_world_region @ T_region_object)


def _at_release(rules: Rules, episode: Episode, pose: Array) -> tuple[Array, Array, Array]:
    """The first arguments of `Physics.settle`."""
    focus = rules.focus(episode)
    poses = episode.poses.at[focus].set(world_pose(episode.region, pose))
    return poses, episode.is_placed.at[focus].set(True), focus


def _verdict(rules: Rules, episode: Episode, settling: Any) -> tuple[Array, Array]:
    """i32, by the rules; bool, stable with the margin that `generate` asks for."""
    _, transition, _ = rules.judge(episode, jnp.zeros(4), settling)
    asking = replace(rules, config=replace(rules.config, min_margin=MIN_MARGIN))
    is_stable = transition.verdict == int(Verdict.STABLE)
    return transition.verdict, is_stable & asking.is_supported(
        episode, rules.focus(episode), settling
    )
