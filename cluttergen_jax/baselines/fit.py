"""How an object would lie if it were let down onto the scene at a candidate position and turn."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

from cluttergen_jax.placement.heightmap import VOID, HeightMap, columns_at, heights_under
from cluttergen_jax.placement.region import Region
from cluttergen_jax.placement.types import Geometry
from cluttergen_jax.types import Array

_CONTACT_GAP = 0.004
_BARE = 0.003
_DIRECTIONS = 8


@struct.dataclass
class Candidates:
    """Positions and turns in the region frame. N candidates.

    Attributes:
      xy: f32[N, 2], metres; yaw: f32[N], radians.
    """

    xy: Array
    yaw: Array

    def take(self, index: Array) -> Candidates:
        """The candidates at `index`, i32[M]."""
        return Candidates(self.xy[index], self.yaw[index])


@struct.dataclass
class Fit:
    """How one candidate would lie; leading axis N for many.

    Attributes:
      rest: f32, height of the object's origin above the top when it first touches something, metres.
      blocked: f32, share of its columns over other objects.
      hanging: f32, share of its columns over nothing at all.
      support: f32, metres: how far inside what carries it the centre of mass is; negative if it would tip.
    """

    rest: Array
    blocked: Array
    hanging: Array
    support: Array


def draw_candidates(key: Array, region: Region, number: int) -> Candidates:
    """Uniform over the region and over one turn."""
    key_xy, key_yaw = jax.random.split(key)
    xy = jax.random.uniform(key_xy, (number, 2), minval=-1.0) * region.half_extents
    return Candidates(xy, jax.random.uniform(key_yaw, (number,), maxval=2 * jnp.pi))


def fit_candidates(
    geometry: Geometry, heights: HeightMap, focus: Array, candidates: Candidates, num_columns: int
) -> Fit:
    """Lets the first `num_columns` columns of object `focus` down onto the height map, at each candidate."""
    bottom = geometry.column_bottom[focus, :num_columns]
    is_column = geometry.is_column[focus, :num_columns]
    total = jnp.maximum(is_column.sum(), 1)
    angles = 2 * jnp.pi * jnp.arange(_DIRECTIONS) / _DIRECTIONS
    directions = jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=-1)

    def fit(xy: Array, yaw: Array) -> Fit:
        points = columns_at(geometry.column_xy[focus, :num_columns], xy, yaw)
        below = heights_under(heights, points)
        carries = is_column & (below > VOID)
        rest = jnp.max(jnp.where(carries, below - bottom, VOID))
        touches = carries & (rest + bottom - below < _CONTACT_GAP)
        center = columns_at(geometry.center_of_mass[focus, None, :2], xy, yaw)[0]
        reach = jnp.where(touches[:, None], (points - center) @ directions.T, -1.0)
        return Fit(
            rest=rest,
            blocked=jnp.sum(carries & (below > _BARE)) / total,
            hanging=jnp.sum(is_column & (below <= VOID)) / total,
            support=jnp.min(jnp.max(reach, axis=0)),
        )

    return jax.vmap(fit)(candidates.xy, candidates.yaw)


def widened(heights: HeightMap, cells: int) -> HeightMap:
    """The map with every surface grown sideways by some cells; what is void stays void."""
    window = (2 * cells + 1, 2 * cells + 1)
    grown = jax.lax.reduce_window(heights.height, -jnp.inf, jax.lax.max, window, (1, 1), "SAME")
    return heights.replace(height=jnp.where(heights.height > VOID, grown, VOID))
