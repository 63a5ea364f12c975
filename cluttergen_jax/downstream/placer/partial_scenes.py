"""Partial scenes: the first objects of scenes of a bank stand, and the next one is to be placed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.errors import BankError
from cluttergen_jax.generation.sources.replay import setup_of
from cluttergen_jax.numerics import new_key
from cluttergen_jax.placement.problem import Problem
from cluttergen_jax.placement.region import KeepOut
from cluttergen_jax.placement.rules import Rules, empty_start
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.scene.bank.bank import Bank
from cluttergen_jax.types import Array

_COLUMNS = ("index", "is_success", "object_index", "poses")


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
        self.bank, self.problem, self.keep_out = bank, setup.problem, setup.keep_out
        self.rules = judging_rules(setup.problem)
        self.number, self.object_index, self.poses = _standing(bank, self.rules)
        self._episodes: Any = jax.jit(jax.vmap(episode_of, in_axes=(None, None, 0, 0, 0)))

    @property
    def num_queries(self) -> int:
        """Pairs of a scene and a slot."""
        return int((self.object_index >= 0).sum())

    def places(self) -> np.ndarray:
        """i64[num_queries, 2]: scene (its row here) and slot of each query, in the order of the bank."""
        return np.argwhere(self.object_index >= 0)

    def episodes(self, places: np.ndarray) -> Episode:
        """The episodes before the objects at `places`, i64[Q, 2], were placed; leading axis Q."""
        scene, slot = places[:, 0], places[:, 1].astype(np.int32)
        return self._episodes(self.rules, self.keep_out, self.object_index[scene], self.poses[scene], slot)


def judging_rules(problem: Problem) -> Rules:
    """The rules by which a proposal is judged: the problem's own, without margin and history."""
    config = replace(problem.config.placement, min_margin=0.0, history_stride=0)
    return replace(problem.rules, config=config)


def episode_of(rules: Rules, keep_out: KeepOut, object_index: Array, poses: Array, slot: Array) -> Episode:
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
        poses=empty_start(num_objects).poses.at[place].set(poses, mode="drop"),
        is_placed=jnp.zeros(num_objects, bool).at[place].set(True, mode="drop"),
    )


def _standing(bank: Bank, rules: Rules) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The numbers i32[S], objects i32[S, N] and poses f32[S, N, 7] of the scenes that stand."""
    number, object_index, poses = [], [], []
    for rows in bank.tables(_COLUMNS):
        rows = rows.filter(rows["is_success"])
        number += rows["index"].to_pylist()
        object_index += rows["object_index"].to_pylist()
        poses += rows["poses"].to_pylist()
    if not number:
        raise BankError(f"{bank.path}: none of its scenes stands", "one that does or more", "more scenes")
    index = np.array(object_index, np.int32)
    if index.shape[1] != rules.num_slots or index.max() >= rules.geometry.num_objects:
        raise BankError(f"{bank.path}: its scenes are not of the objects that its record names")
    return np.array(number, np.int32), index, np.array(poses, np.float32)
