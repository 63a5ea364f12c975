"""What looks natural: wide, flat things carry, and what lies on them is well supported."""

from __future__ import annotations

import jax.numpy as jnp

from cluttergen_jax.placement.ruin import footprint_area
from cluttergen_jax.placement.search.bearers import Bearers
from cluttergen_jax.placement.types import Geometry
from cluttergen_jax.types import Array

_AREA_POWER = 2.0
_BASE_POWER = 1.0
_LEAST_BASE = 0.02


def natural_logits(geometry: Geometry, focus: Array, bearers: Bearers) -> Array:
    """f32[N]: log weights of candidates, 0 on the support alone and at most 0 elsewhere.

    The weight of what lies on objects is min(1, A / a)^2 s, with a the footprint of the current object's box,
    A that of the largest object that would carry it, and s the share of its base that would touch.
    """
    area = footprint_area(geometry)
    widest = jnp.max(jnp.where(bearers.touched, area, 0.0), axis=1)
    width = jnp.minimum(jnp.log(jnp.maximum(widest, 1e-8) / area[focus]), 0.0)
    base = jnp.log(jnp.clip(bearers.base, _LEAST_BASE, 1.0))
    return jnp.where(bearers.is_on, _AREA_POWER * width + _BASE_POWER * base, 0.0)
