"""Placers by name: baselines that learn nothing, and full-state methods that show what is possible."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
from flax import struct

from cluttergen_jax.downstream.placer.map_search import best_apart, draw, search
from cluttergen_jax.downstream.placer.query import (
    NUM_PROPOSALS,
    PlacementQuery,
    Placer,
    PlainPlacer,
    Proposals,
    without_scores,
)
from cluttergen_jax.downstream.placer.scored import (
    embedded_placers,
    load_placer,
    placer_folder,
)
from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.geometry import Array
from cluttergen_jax.learning import checkpoint_of, proposer_of, with_history_of
from cluttergen_jax.placement import (
    CLEARANCE,
    Episode,
    Problem,
    Proposer,
    Rules,
    SearchConfig,
    pose_of_action,
)


class RandomPlacer(struct.PyTreeNode):
    """Uniform positions and turns at the object's own height on the bare top; it looks at nothing."""

    def __call__(self, key: Array, query: PlacementQuery) -> Proposals:
        drawn = draw(key, query, NUM_PROPOSALS)
        height = jnp.full(NUM_PROPOSALS, query.half_extents[2] + CLEARANCE)
        return without_scores(jnp.column_stack([drawn.xy, height, drawn.yaw]))


class GeometryPlacer(struct.PyTreeNode):
    """The baseline `drop` on what the camera saw: the cheapest poses, lowered onto one of the two maps.

    Attributes:
      unseen: what is hidden counts as "free" (the map `heights`), or as "occupied" (`ceilings`).
      config: how long to look.
    """

    unseen: Literal["free", "occupied"] = struct.field(pytree_node=False)
    config: SearchConfig = struct.field(pytree_node=False, default=SearchConfig())

    def __call__(self, key: Array, query: PlacementQuery) -> Proposals:
        heights = query.heights if self.unseen == "free" else query.ceilings
        found = search(key, query, heights, self.config)
        best = best_apart(found.cost, found.candidates.xy, NUM_PROPOSALS)
        return without_scores(found.pose[best])


@dataclass(frozen=True)
class FullState:
    """A method of `generate` that knows the whole scene: no placer, but what one can hope for.

    Attributes:
      method: its name; "policy" and its like are those trained for the pool.
    """

    method: str

    def in_world(self, problem: Problem) -> tuple[Rules, Proposer]:
        """The method in a world, and rules whose episodes look back on as much as it was trained with.

        Raises:
          PoolError: no checkpoint of it is embedded for the pool.
        """
        checkpoint = checkpoint_of(self.method, problem.config.pool)
        rules = replace(problem.rules, config=with_history_of(problem.rules.config, checkpoint))
        return rules, proposer_of(self.method, checkpoint, rules)


def proposals_of(propose: Proposer, key: Array, episode: Episode, rules: Rules) -> Proposals:
    """What a full-state method proposes in as many attempts, each as if those before had failed."""

    def one(key: Array, attempt: Array) -> Array:
        action = propose(key, episode.replace(attempt=attempt))
        T_region_world = episode.region.T_world_region.inverse()
        pose = pose_of_action(action, episode.region, rules.height_range(episode))
        return jnp.append(T_region_world.apply(pose[:3]), 2 * jnp.pi * action[3])

    attempts = jnp.arange(NUM_PROPOSALS, dtype=jnp.int32)
    return without_scores(jax.vmap(one)(jax.random.split(key, NUM_PROPOSALS), attempts))


BASELINES: dict[str, Callable[[], Placer]] = {
    "random": RandomPlacer,
    "geometry": lambda: GeometryPlacer("free"),
    "geometry-occupied": lambda: GeometryPlacer("occupied"),
}
FULL_STATE = ("drop", "guided", "policy")
"""Methods that see the scene itself; the row that a placer can be measured against."""


def find_placer(placer: str | Path | Placer | PlainPlacer) -> Placer | PlainPlacer | FullState:
    """The placer of that name, or in that folder; one of the user's own is what it is.

    Raises:
      ConfigError: there is none, or it cannot be called.
      PoolError: the folder holds no placer, or a damaged one.
    """
    if not isinstance(placer, str | Path):
        if callable(placer):
            return placer
        raise ConfigError(
            f"placer {placer!r}", "a name, a folder, or a `PlainPlacer` or `Placer` of your own"
        )
    name = str(placer)
    if name in BASELINES:
        return BASELINES[name]()
    if name in FULL_STATE:
        return FullState(name)
    if folder := placer_folder(placer):
        return load_placer(folder)
    known = (*BASELINES, *embedded_placers(), *FULL_STATE)
    raise ConfigError(
        f"placer {name!r}",
        f"{', '.join(known)}, or the folder of a trained one",
        "geometry, which learns nothing",
        closest(name, known),
    )
