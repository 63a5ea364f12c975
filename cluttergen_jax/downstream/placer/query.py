"""What a placer is asked and answers, and what a head learns from."""

from __future__ import annotations

from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import Array
from cluttergen_jax.own_parts import array_of, part_name
from cluttergen_jax.placement import VOID, HeightMap, UnderSide

CELL = 0.01
"""Metres: the sides of a cell of a query's maps."""

NUM_PROPOSALS = 5
NUM_POINTS = 2048


class PlacementQuery(struct.PyTreeNode):
    """What a placer is given, and nothing else: no truth about the scene. Region frame, metres.

    Queries of one batch have maps of one size (`pad_map`).

    Attributes:
      heights: the highest surface that the camera saw over each cell; 0 where it saw nothing, VOID off the
        support.
      ceilings: above it everything is seen to be empty; where the top is hidden it lies above `heights`.
      under: the current object's under-side (its mesh is known, as in the paper).
      half_extents: f32[3], of the current object's box; center_of_mass: f32[3], object frame.
      own_margin: f32, the current object's support margin on a flat table.
      object_cloud: f32[1024, 3], its surface, object frame.
      cloud: f32[2048, 3], what the camera saw on and above the top, region frame; cloud_mask: bool[2048], the
        points that count, the others are zero.
      region_half_extents: f32[2].
      height_range: f32, the highest surface seen, plus the current object's height.
    """

    heights: HeightMap
    ceilings: HeightMap
    under: UnderSide
    half_extents: Array
    center_of_mass: Array
    own_margin: Array
    object_cloud: Array
    cloud: Array
    cloud_mask: Array
    region_half_extents: Array
    height_range: Array


class Proposals(struct.PyTreeNode):
    """Where an object could be let go, best first. M proposals.

    Attributes:
      pose: f32[M, 4], x, y, z and yaw of T_region_object, metres and radians.
      score: f32[M], the chance that it will stand there and disturb nothing; nan from placers that tell none.
    """

    pose: Array
    score: Array


class Placer(Protocol):
    """Answers one query at a time; a pytree (a `flax.struct.PyTreeNode`), pure, to be compiled and mapped."""

    def __call__(self, key: Array, query: PlacementQuery) -> Proposals:
        """`NUM_PROPOSALS` proposals, drawn with `key`."""


class PlainPlacer(Protocol):
    """A placer of NumPy, PyTorch or anything else that is no pytree: called as it is, outside of JAX.

    `placer=` of `robot.place` and `placers` of `placer.eval` take it. An attribute `name` is what rows call
    it; `own_parts.part_label` says how its rows are told from those of others.
    """

    def __call__(self, rng: np.random.Generator, query: PlacementQuery) -> Any:
        """Where the object could be let go, the best first.

        Args:
          rng: for all that is drawn. query: NumPy arrays; region frame, metres.

        Returns:
          f[M, 4], x, y, z and yaw of T_region_object, metres and radians; or `Proposals` with scores. M is 1
          to `NUM_PROPOSALS`, the same for all queries. A robot lowers each onto what was seen.
        """


def is_plain(placer: Any) -> bool:
    """Whether a placer is called as it is (`PlainPlacer`); else it is a pytree, and compiled."""
    return jax.tree_util.all_leaves([placer])


def ask_plain(placer: Any, key: Array, query: PlacementQuery) -> Proposals:
    """What a `PlainPlacer` answers to one query (`check_proposals`), NumPy arrays; `key` seeds its rng."""
    rng = np.random.default_rng(np.asarray(jax.random.key_data(key)).ravel())
    told = placer(rng, jax.tree.map(np.asarray, query))
    name = part_name(placer)
    if told is None:
        raise ConfigError(f"placer {name!r} returned None", _ALLOWED)
    try:
        if isinstance(told, Proposals):
            found = Proposals(
                *(array_of(each).astype(np.float32) for each in (told.pose, told.score))
            )
        else:
            pose = array_of(told).astype(np.float32)
            found = Proposals(pose, np.full(pose.shape[:-1], np.nan, np.float32))
    except (TypeError, ValueError) as error:
        raise ConfigError(f"placer {name!r} returned {told!r}", _ALLOWED) from error
    return check_proposals(found, name)


_ALLOWED = (
    f"f[M, 4], x, y, z and yaw, finite, with M of 1 to {NUM_PROPOSALS}; or `Proposals` of these with scores "
    "in [0, 1] or nan"
)


def check_proposals(found: Any, name: str) -> Proposals:
    """Proposals of a user's placer for one query, or for many.

    Raises:
      ConfigError: none, too many, another shape, or numbers that are not finite.
    """
    if not isinstance(found, Proposals):
        raise ConfigError(f"placer {name!r} returned a {type(found).__name__}", _ALLOWED)
    pose = np.asarray(found.pose)
    score = np.asarray(found.score)
    if pose.ndim < 2 or pose.shape[-1] != 4 or not 1 <= pose.shape[-2] <= NUM_PROPOSALS:
        raise ConfigError(f"placer {name!r} returned poses of shape {pose.shape}", _ALLOWED)
    if not np.isfinite(pose).all():
        raise ConfigError(f"placer {name!r} returned poses that are not finite", _ALLOWED)
    if score.shape != pose.shape[:-1] or ((score < 0) | (score > 1)).any():
        raise ConfigError(
            f"placer {name!r} returned scores of shape {score.shape}: {score}", _ALLOWED
        )
    return Proposals(pose, score)


def pad_map(heights: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """A map's heights f32[..., W, H] with cells off the support added at its far ends.

    The corner of the map stays where it is.
    """
    more = [max(wanted - side, 0) for wanted, side in zip(shape, heights.shape[-2:], strict=True)]
    ends = [(0, 0)] * (heights.ndim - 2) + [(0, side) for side in more]
    return np.pad(heights, ends, constant_values=VOID)


def without_scores(pose: Array) -> Proposals:
    """Proposals f32[M, 4] of a placer that tells no chances."""
    return Proposals(pose, jnp.full(pose.shape[:-1], jnp.nan, pose.dtype))


class Example(struct.PyTreeNode):
    """One pair: a query and what is known of its answers. L labelled poses, region frame.

    Attributes:
      query: what the placer is given.
      target: f32[4], where the object stands in the scene: x, y, z and yaw.
      candidate: f32[L, 4]; verdict: u8[L], what became of each (`types.Verdict`).
    """

    query: PlacementQuery
    target: Array
    candidate: Array
    verdict: Array
