"""Lowest fit: many random poses lowered to first contact; the lowest, best supported, least open is taken."""

from __future__ import annotations

import jax.numpy as jnp

from cluttergen_jax.placement.search.search import CandidateScores, Search
from cluttergen_jax.types import Array

_LIFTED = 0.002
_ENOUGH_ON_TOP = 0.5
_ENOUGH_ON_OBJECTS = 0.8
_TIPPING_COST = 2.0
_GAP_SCALE = 0.01
_CLOSED_IN = 0.05


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
