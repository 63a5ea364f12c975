"""Geometric placers that a learned policy has to beat: `random`, `clear`, `drop` and `spread`."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

from cluttergen_jax.placement.candidate_sampler import CandidateSampler, CandidateSet
from cluttergen_jax.placement.region import Region, action_of_pose, is_in_polygon
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.search import CLEARANCE, CandidateScores, Search
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.types import Array

_LIFTED = 0.002
_ENOUGH_ON_TOP = 0.5
_ENOUGH_ON_OBJECTS = 0.8
_TIPPING_COST = 2.0
_GAP_SCALE = 0.01
_CLOSED_IN = 0.05
_TRIED = 64


def cost_of_lying(scores: CandidateScores) -> Array:
    """f32[N], metres: how high a candidate would lie, and what speaks against its staying there.

    The base may float 1 mm above what lies below for 1 cm of height, 2 mm for 4 cm. The bare top may end
    half-way to the centre of mass; what stands on objects wants to be carried almost all around, since
    their height is less well known.
    """
    gap, tipping = costs_of_staying(scores)
    return scores.lift + gap + tipping


def costs_of_staying(scores: CandidateScores) -> tuple[Array, Array]:
    """f32[N] each: what speaks against a candidate's staying where it would lie (`cost_of_lying`)."""
    enough = jnp.where(scores.lift > _LIFTED, _ENOUGH_ON_OBJECTS, _ENOUGH_ON_TOP)
    tipping = _TIPPING_COST * jnp.maximum(enough - scores.support, 0.0)
    return (scores.fit.gap / _GAP_SCALE) ** 2, tipping


def cost_of_lowest_fit(scores: CandidateScores) -> Array:
    """f32[N], metres: what `LowestFit` keeps low.

    A place closed in on all sides, by objects or the support's end, counts as 5 cm lower than an open one:
    that keeps free space in one piece for the objects to come. After each failed attempt it counts half, so
    that an object does not get the same best candidate five times.
    """
    return cost_of_lying(scores) - _CLOSED_IN * scores.crowd * 0.5**scores.attempt


class LowestFit(Search, eq=False):
    """Lowers each candidate by the object's own under-side and takes the lowest that would not tip."""

    def cost(self, scores: CandidateScores) -> Array:
        """See `Search`."""
        return cost_of_lowest_fit(scores)


class Random(struct.PyTreeNode, eq=False):
    """A uniform position and turn on the support's surface (the paper's RRS, with its height mended).

    With `PlacementConfig.height` "free" the height is uniform in the region's range, too.
    """

    rules: Rules

    def __call__(self, key: Array, episode: Episode) -> Array:
        """See `placement.rules.Proposer`."""
        key_position, key_turn = jax.random.split(key)
        region = episode.region
        xy = jax.random.uniform(key_position, (2,), minval=-1.0) * region.half_extents
        if self.rules.polygon is not None:
            xy = self._in_polygon(key_position, region)
        yaw = jax.random.uniform(key_turn, maxval=2 * jnp.pi)
        height = self.rules.body(episode).height + CLEARANCE
        height_range = self.rules.height_range(episode)
        if self.rules.config.height == "free":
            # `fold_in` of 0 or 1 would be a key of the split again, and the height a copy of x.
            height = jax.random.uniform(jax.random.fold_in(key, 2), maxval=height_range)
        return action_of_pose(jnp.append(xy, height), yaw, region, height_range)

    def _in_polygon(self, key: Array, region: Region) -> Array:
        """f32[2]: the first of many uniform points of the region that is in the polygon."""
        assert self.rules.polygon is not None
        many = jax.random.uniform(key, (_TRIED, 2), minval=-1.0) * region.half_extents
        points = region.T_world_region.apply(jnp.pad(many, ((0, 0), (0, 1))))
        support_map = self.rules.geometry.support_map
        if support_map is not None and support_map.T_map_world is not None:
            points = support_map.T_map_world.apply(points)
        return many[jnp.argmax(is_in_polygon(points[:, :2], self.rules.polygon))]


_CLEAR = -10.0


class Clear(Search, eq=False):
    """Many cheap geometric tries per attempt; the first on bare, whole ground is taken.

    Candidates are uniform, so those that pass are uniform over the free poses. If none passes, the object is
    lowered to where it would lie lowest and best, as by `drop`.
    """

    def cost(self, scores: CandidateScores) -> Array:
        """See `Search`."""
        is_clear = (scores.fit.blocked == 0) & (scores.fit.hanging == 0)
        return jnp.where(is_clear, _CLEAR, cost_of_lying(scores))


class Spread(CandidateSampler, eq=False):
    """Trusts what rests with little gap and would not tip, by two of the costs of `drop`.

    A trust of 0.9 is a cost of 0.105: a gap of 3 mm under the base, or 0.05 less support than is enough.
    """

    @staticmethod
    def of(rules: Rules) -> Spread:
        """For one world, with `drop`'s finalists."""
        return Spread(LowestFit(rules))

    def trust(self, episode: Episode, candidates: CandidateSet) -> Array:
        """See `CandidateSampler`."""
        gap, tipping = costs_of_staying(candidates.found.scores)
        return jnp.exp(-(gap + tipping))
