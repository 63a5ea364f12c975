"""Scenes as a pytree of arrays: what finished episodes leave, without what was only needed on the way."""

from __future__ import annotations

import jax.numpy as jnp
import jaxlie
from flax import struct

from cluttergen_jax.placement.region import Region, from_pose, safe_poses
from cluttergen_jax.placement.types import Counts, DoorRecord, Episode
from cluttergen_jax.types import Array

BLOCK_SIZE = 256
"""Scenes of a full block, sampled and stored as one; block b begins with scene 256 b (docs/contract.md)."""


class SceneBatch(struct.PyTreeNode):
    """Finished scenes, failures included: look at `is_success`. S slots, N points, any leading axes.

    Runs that are continued store these arrays by their place: new ones come last, and None is stored nowhere.

    Attributes:
      object_index: i32[S], the compiled world's object in each slot, -1 where there is none.
      is_placed: bool[S], the slot holds an object that stands; those of failed scenes may be fewer.
      poses: f32[S, 7], world pose of each slot's object, metres, wxyz; the identity where not placed.
      is_success: bool, every slot is filled and the finished scene stands.
      is_filled: bool, every slot is filled.
      verdict: i32, a `types.Verdict`: the last check's, or that of the attempt with which the scene failed.
      drift: f32, metres, the largest movement in the last check.
      counts: figures of this draw (attempts, steps, verdicts).
      region: the queried region. This and the rest come from a `Sampler` alone.
      num_draws: i32, how often the scene was drawn until it passed, at most `max_retries` + 1.
      cloud: f32[N, 3], world frame, metres: points of the region and of the placed objects; None unless asked
        for. cloud_mask: bool[N], the points that count; the others are the region's origin.
      level: i32[S], how many objects are below each slot's, one upon the other; -1 where not placed. This and
        the next are None where the episode does not keep what carries what.
      num_touching: i32, pairs of objects that touch.
      num_beside: i32, pairs of objects that touch from the side, and num_leaning: i32, objects that lean;
        None where neither was counted.
      shelf: i32, the number of the sampler's shelf that `object_index` is about; None where there is none.
      doors: what closing them came to; None where none are closed.
    """

    object_index: Array
    is_placed: Array
    poses: Array
    is_success: Array
    is_filled: Array
    verdict: Array
    drift: Array
    counts: Counts
    region: Region | None = None
    num_draws: Array | None = None
    cloud: Array | None = None
    cloud_mask: Array | None = None
    level: Array | None = None
    num_touching: Array | None = None
    shelf: Array | None = None
    num_beside: Array | None = None
    num_leaning: Array | None = None
    doors: DoorRecord | None = None

    def __repr__(self) -> str:
        # Arrays may be traced, or hold anything while a pytree is taken apart.
        shape = getattr(self.object_index, "shape", ())
        num_slots = f"{shape[-1]} slots" if shape else "slots"
        return f"SceneBatch(scenes {list(shape[:-1])} of {num_slots}: object_index, poses, is_success ...)"

    @property
    def T_world_object(self) -> jaxlie.SE3:
        """SE3[S]: `poses`."""
        return from_pose(self.poses)

    @property
    def T_world_support(self) -> jaxlie.SE3:
        """SE3: the identity, as the world's origin is on the floor below the support's centre."""
        return jaxlie.SE3.identity(jnp.shape(self.is_success))


def scene_of(episode: Episode) -> SceneBatch:
    """The scene of one finished episode, without leading axes."""
    index = episode.object_index
    is_placed = (jnp.arange(index.shape[0]) < episode.slot) & (index >= 0)
    poses = safe_poses(episode.poses[jnp.maximum(index, 0)], is_placed)
    support_graph = episode.support_graph
    return SceneBatch(
        object_index=index,
        is_placed=is_placed,
        poses=poses,
        is_success=episode.is_success,
        is_filled=episode.slot >= episode.num_slots,
        verdict=episode.verdict,
        drift=episode.drift,
        counts=episode.counts,
        level=jnp.where(is_placed, support_graph.level[jnp.maximum(index, 0)], -1),
        num_touching=support_graph.num_touching(episode.is_placed),
        num_beside=episode.num_beside,
        num_leaning=episode.num_leaning,
        doors=episode.doors,
    )
