"""Order: which objects must leave before others can come, and the fewest that must wait meanwhile."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import combinations
from typing import NamedTuple

import mujoco
import networkx as nx
import numpy as np
from scipy.spatial.distance import cdist

from cluttergen_jax.assets import ObjectAsset, populated_spec
from cluttergen_jax.config import ContactConfig, StabilityConfig

GAP = 0.005
"""Metres; a goal nearer than this to where another object stands is covered by it."""
_RESTING = 0.003
_LEAST_UP = 0.5
MOST_EXACT = 10
"""Objects up to which the smallest set is sought exactly."""


class Relations(NamedTuple):
    """How N objects, where they stand and where they shall, are in each other's way.

    Attributes:
      blocks: bool[N, N], where i stands it covers the goal of j.
      lies_on: bool[N, N], i lies on j now.
      goal_on: bool[N, N], i will lie on j.
    """

    blocks: np.ndarray
    lies_on: np.ndarray
    goal_on: np.ndarray


class Meetings:
    """Finds how objects meet each other where they stand and where they shall; objects: N."""

    def __init__(self, objects: Sequence[ObjectAsset]) -> None:
        self._number = len(objects)
        names = [f"{kind}-{number}" for kind in ("now", "goal") for number in range(self._number)]
        contact = ContactConfig()
        spec = populated_spec(
            names, [*objects, *objects], None, StabilityConfig().timestep, contact
        )
        for geom in spec.geoms:
            geom.margin = GAP
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._owner = self._model.geom_bodyid - 1

    def relations(self, poses: np.ndarray, goals: np.ndarray) -> Relations:
        """Of objects at f64[N, 7] that shall go to f64[N, 7]."""
        near, on_top = self._contacts(poses, goals)
        first = slice(0, self._number)
        last = slice(self._number, None)
        # MuJoCo finds no contact between equal bodies at one place.
        blocks = near[first, last] | (cdist(poses[:, :3], goals[:, :3]) < GAP)
        np.fill_diagonal(blocks, False)
        return Relations(blocks, on_top[first, first], on_top[last, last])

    def _contacts(self, poses: np.ndarray, goals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """bool[2N, 2N]: pairs nearer than `GAP`; and those of which the first lies on the second."""
        data = self._data
        data.qpos[:] = np.concatenate([poses, goals]).ravel()
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)
        mujoco.mj_collision(self._model, data)
        near, on_top = np.zeros((2, 2 * self._number, 2 * self._number), bool)
        for geoms, distance, frame in zip(
            data.contact.geom, data.contact.dist, data.contact.frame, strict=True
        ):
            below, above = self._owner[geoms]
            if distance >= GAP:
                continue
            near[above, below] = near[below, above] = True
            # The normal points from the first geom to the second.
            up = frame[2]
            if distance < _RESTING and abs(up) > _LEAST_UP:
                pair = (above, below) if up > 0 else (below, above)
                on_top[pair] = True
        return near, on_top


def is_possible(relations: Relations, pending: Collection[int], waiting: Collection[int]) -> bool:
    """Whether there is an order in which all pending objects come home, those waiting by a place elsewhere.

    Each object leaves and comes home; without a place to wait at both are one. An object leaves after what
    lies on it, and comes home after what covers its goal has left and what it will lie on is home.
    """
    graph = nx.DiGraph()
    home = {k: ("home", k) for k in pending}
    away = {k: ("away", k) if k in waiting else home[k] for k in pending}
    graph.add_nodes_from(home.values())
    for k in waiting:
        graph.add_edge(away[k], home[k])
    for i in pending:
        for j in pending:
            if i == j:
                continue
            if relations.lies_on[i, j]:
                graph.add_edge(away[i], away[j])
            if relations.blocks[i, j]:
                graph.add_edge(away[i], home[j])
            if relations.goal_on[i, j]:
                graph.add_edge(home[j], home[i])
    return nx.is_directed_acyclic_graph(graph)


def smallest_waiting(relations: Relations, pending: Collection[int]) -> tuple[int, ...] | None:
    """The fewest pending objects that must wait elsewhere, all sets looked at up to `MOST_EXACT` objects.

    With more objects sets of up to three are looked at. None where no set does.
    """
    most = len(pending) if len(pending) <= MOST_EXACT else 3
    for size in range(most + 1):
        for chosen in combinations(sorted(pending), size):
            if is_possible(relations, pending, chosen):
                return chosen
    return None


def ready(relations: Relations, pending: Collection[int]) -> list[int]:
    """The pending objects that can go home now: nothing on them, their goal clear, what they lie on home."""
    others = sorted(pending)
    return [
        k
        for k in others
        if not relations.lies_on[:, k].any()
        and not relations.blocks[others, k].any()
        and not relations.goal_on[k, others].any()
    ]


def lowest_first(objects: Sequence[ObjectAsset], pending: Collection[int]) -> list[int]:
    """The paper's order: those of least height first, whatever is in the way."""
    return sorted(pending, key=lambda k: (float(objects[k].half_extents[2]), k))
