"""What a placer is asked and answers, and what a head learns from."""

from __future__ import annotations

from typing import Protocol

import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.placement.heightmap import VOID, HeightMap
from cluttergen_jax.placement.search import UnderSide
from cluttergen_jax.types import Array

CELL = 0.01
"""Metres: the sides of a cell of a query's maps."""

NUM_PROPOSALS = 5
NUM_OBJECT_POINTS = 1024
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
    """Answers one query at a time; a pytree and pure, to be compiled and mapped."""

    def __call__(self, key: Array, query: PlacementQuery) -> Proposals:
        """`NUM_PROPOSALS` proposals, drawn with `key`."""


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
