"""Queried regions changed at random, an episode at a time (paper, zero-shot changes of the region)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.placement.region import Region, make_region
from cluttergen_jax.types import Array

SMALLEST_HALF = 0.05
"""Metres: no half extent is made smaller than this, but to fit a turned region onto its table."""
_TRIED = 256
"""First sides that are tried when a turned region has to be shrunk."""
_TINY = 1e-9


@dataclass(frozen=True)
class RegionChange:
    """How much a region is changed at most; every draw is uniform.

    Attributes:
      translation: metres to either side, in x and in y.
      rotation: radians to either side.
      shrinkage, expansion: metres by which each half extent, by itself, becomes smaller or larger.
    """

    translation: float = 0.0
    rotation: float = 0.0
    shrinkage: float = 0.0
    expansion: float = 0.0


REGION_CHANGES = {
    "none": RegionChange(),
    "translation": RegionChange(translation=0.15),
    "rotation": RegionChange(rotation=math.pi),
    "shrinkage": RegionChange(shrinkage=0.10),
    "expansion": RegionChange(expansion=0.10),
    "all": RegionChange(translation=0.15, rotation=math.pi, shrinkage=0.10, expansion=0.10),
}
"""The paper's changes, with its ranges."""


def find_change(name: str) -> RegionChange:
    """The change called `name`.

    Raises:
      ConfigError: there is none.
    """
    if name not in REGION_CHANGES:
        raise ConfigError(
            f"region change {name!r}", ", ".join(REGION_CHANGES), meant=closest(name, REGION_CHANGES)
        )
    return REGION_CHANGES[name]


@dataclass(frozen=True)
class ChangedRegion:
    """Draws a changed region for each episode; see `draw_region`."""

    change: RegionChange
    base: Rectangle
    bounds: Rectangle
    top: float

    def __call__(self, key: Array) -> Region:
        """See `placement.rules.RegionDraw`."""
        return draw_region(key, self.change, self.base, self.bounds, self.top)


def draw_region(key: Array, change: RegionChange, base: Rectangle, bounds: Rectangle, top: float) -> Region:
    """A region drawn around `base`, wholly inside `bounds`.

    What is too large for the bounds once turned is shrunk, one side or both, so that the most area is left,
    then moved inwards by as little as it takes: a region stays on its table.

    Args:
      key: consumed.
      base: the region to change; bounds: the part of the top that may be used; both world, metres.
      top: height of the top, metres.
    """
    key_shift, key_turn, key_size = jax.random.split(key, 3)
    shift = jax.random.uniform(key_shift, (2,), minval=-1.0) * change.translation
    turn = jax.random.uniform(key_turn, (), minval=-1.0) * change.rotation
    growth = jax.random.uniform(key_size, (2,), minval=-change.shrinkage, maxval=change.expansion)
    half = jnp.maximum(
        jnp.array(base.half_extents) + growth, jnp.minimum(SMALLEST_HALF, min(base.half_extents))
    )
    yaw = base.yaw + turn
    cos, sin = jnp.abs(jnp.cos(yaw - bounds.yaw)), jnp.abs(jnp.sin(yaw - bounds.yaw))
    room = jnp.array(bounds.half_extents)
    half = _fitted(half, cos, sin, room)
    reach = jnp.stack([cos * half[0] + sin * half[1], sin * half[0] + cos * half[1]])
    to_world = jnp.array(
        [[math.cos(bounds.yaw), -math.sin(bounds.yaw)], [math.sin(bounds.yaw), math.cos(bounds.yaw)]]
    )
    offset = to_world.T @ (jnp.array(base.center) + shift - jnp.array(bounds.center))
    slack = jnp.maximum(room - reach, 0.0)
    center = jnp.array(bounds.center) + to_world @ jnp.clip(offset, -slack, slack)
    return make_region(center, half, yaw, jnp.float32(top))


def _fitted(half: Array, cos: Array, sin: Array, room: Array) -> Array:
    """The largest half extents f32[2], none above `half`, of a turned rectangle that fits into `room`."""
    first = half[0] * jnp.linspace(1 / _TRIED, 1.0, _TRIED)
    second = jnp.minimum(
        (room[0] - cos * first) / jnp.maximum(sin, _TINY), (room[1] - sin * first) / jnp.maximum(cos, _TINY)
    )
    second = jnp.minimum(second, half[1])
    best = jnp.argmax(first * second)
    return jnp.stack([first[best], second[best]])
