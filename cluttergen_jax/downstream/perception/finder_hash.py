"""What the settings of segmentation and registration are, as one digest."""

from __future__ import annotations

from functools import cache

from cluttergen_jax.downstream.constants import constants_hash
from cluttergen_jax.downstream.perception import aligned, certainty, expected, finder
from cluttergen_jax.downstream.perception.pose import compare, free, models, registration, steady, upright
from cluttergen_jax.downstream.perception.segment import refine, trained

_POSES = (compare, free, models, registration, steady, upright)


@cache
def finder_hash() -> str:
    """Hex digest of how objects and their poses are found in pictures, but for the network's weights."""
    return constants_hash(aligned, certainty, expected, finder, refine, trained, *_POSES)
