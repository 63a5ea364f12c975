"""How an object would lie if it were lowered vertically to first contact at a candidate position and turn."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.placement.heightmap import VOID, HeightMap
from cluttergen_jax.types import Array

_CONTACT_GAP = 0.0015
_BASE = 0.003
_BARE = 0.003
_DEEP = -0.03
_DIRECTIONS = 12


class Candidates(struct.PyTreeNode):
    """Positions and turns in the region frame. N candidates.

    Attributes:
      xy: f32[N, 2], metres; yaw: f32[N], radians.
    """

    xy: Array
    yaw: Array

    def take(self, index: Array) -> Candidates:
        """The candidates at `index`, i32[M]."""
        return Candidates(self.xy[index], self.yaw[index])


class UnderSide(struct.PyTreeNode):
    """What of an object can touch what lies below: a sample of its columns, object frame, metres.

    Attributes:
      xy: f32[C, 2]; bottom: f32[C]; is_column: bool[C].
      center_of_mass: f32[2].
      lean: f32[2], of the region frame: how far the centre of mass is from there, down the slope, where a
        plumb line through it meets the base; None on a level surface.
    """

    xy: Array
    bottom: Array
    is_column: Array
    center_of_mass: Array
    lean: Array | None = None

    def first(self, number: int) -> UnderSide:
        """A coarser sample."""
        return self.replace(
            xy=self.xy[:number], bottom=self.bottom[:number], is_column=self.is_column[:number]
        )


class LoweredFit(struct.PyTreeNode):
    """How N candidates would lie.

    Attributes:
      rest: f32[N], height of the object's origin above the top when it first touches something, metres.
      blocked: f32[N], share of its columns over other objects.
      hanging: f32[N], share of its columns over nothing at all.
      gap: f32[N], mean distance from its base, the lowest of its columns, down to what lies below, metres.
      room: f32[N], the lowest height over its columns at which the support hangs over it; None where it does
        nowhere.
    """

    rest: Array
    blocked: Array
    hanging: Array
    gap: Array
    room: Array | None = None


def lower_onto(under: UnderSide, heights: HeightMap, candidates: Candidates) -> LoweredFit:
    """Lowers an object vertically to first contact with a height map, at each candidate."""
    cells = cells_under(under, heights, candidates)
    below = heights.at(cells)
    is_column = under.is_column
    lowest = jnp.min(jnp.where(is_column, under.bottom, jnp.inf))
    is_base = is_column & (under.bottom < lowest + _BASE)
    rest, blocked, hanging, base = _reduce(
        (jnp.where(is_column, below - under.bottom, VOID), jnp.maximum, VOID),
        (((below > _BARE) & is_column).astype(jnp.float32), jnp.add, 0.0),
        (((below <= VOID) & is_column).astype(jnp.float32), jnp.add, 0.0),
        (jnp.where(is_base, jnp.maximum(below, _DEEP), 0.0), jnp.add, 0.0),
    )
    total = jnp.maximum(is_column.sum(), 1)
    gap = rest + lowest - base / jnp.maximum(is_base.sum(), 1)
    room = None
    if heights.ceiling is not None:
        above = heights.ceiling.reshape(-1).at[cells].get(mode="clip")
        room = jnp.min(jnp.where(is_column, above, jnp.inf), axis=1)
    return LoweredFit(rest, blocked / total, hanging / total, gap, room)


def mean_under(under: UnderSide, field: HeightMap, candidates: Candidates) -> Array:
    """f32[N]: the mean of any map over the object's columns at each candidate."""
    values = jnp.where(under.is_column, field.at(cells_under(under, field, candidates)), 0.0)
    return values.sum(1) / jnp.maximum(under.is_column.sum(), 1)


def support_share(
    under: UnderSide, heights: HeightMap, candidates: Candidates, rest: Array
) -> Array:
    """f32[N]: how far inside what carries it the centre of mass is, over the same on flat ground.

    1 is as good as the bare top; below 0 it tips. Distances are the smallest over some directions.

    Args:
      rest: f32[N], from `lower_onto`.
    """
    touches = touching(under, heights, candidates, rest)
    lowest = jnp.min(jnp.where(under.is_column, under.bottom, jnp.inf))
    on_ground = (under.bottom < lowest + _CONTACT_GAP) & under.is_column
    yaw = None if under.lean is None else candidates.yaw
    return _margin(under, touches, yaw) / jnp.maximum(_margin(under, on_ground[None]), 1e-3)


def touching(under: UnderSide, heights: HeightMap, candidates: Candidates, rest: Array) -> Array:
    """bool[N, C]: the columns that would touch what lies below, at the heights `rest`, f32[N]."""
    below = heights.at(cells_under(under, heights, candidates))
    return (rest[:, None] + under.bottom - below < _CONTACT_GAP) & under.is_column


def base_share(under: UnderSide, touches: Array) -> Array:
    """f32[N]: the share of the base, the lowest of the columns, that touches; bool[N, C] from `touching`."""
    lowest = jnp.min(jnp.where(under.is_column, under.bottom, jnp.inf))
    is_base = under.is_column & (under.bottom < lowest + _BASE)
    return jnp.sum(touches & is_base, axis=1) / jnp.maximum(is_base.sum(), 1)


def _margin(under: UnderSide, touches: Array, yaw: Array | None = None) -> Array:
    """f32[N], metres: how far the centre of mass is inside the columns that touch, bool[N, C].

    Args:
      yaw: f32[N], of the candidates, where it leans down a slope.
    """
    angles = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    offset = under.xy - under.center_of_mass
    reach = [np.cos(angle) * offset[:, 0] + np.sin(angle) * offset[:, 1] for angle in angles]
    farthest = _reduce(*((jnp.where(touches, one, -1.0), jnp.maximum, -1.0) for one in reach))
    if yaw is not None and under.lean is not None:
        cos = jnp.cos(yaw)
        sin = jnp.sin(yaw)
        x = cos * under.lean[0] + sin * under.lean[1]
        y = cos * under.lean[1] - sin * under.lean[0]
        farthest = tuple(
            each - (np.cos(angle) * x + np.sin(angle) * y)
            for each, angle in zip(farthest, angles, strict=True)
        )
    return jnp.min(jnp.stack(farthest), axis=0)


def _reduce(*terms: tuple[Array, Callable[[Array, Array], Array], float]) -> tuple[Array, ...]:
    """Reduces several arrays along their last axis in one pass.

    Reduced one by one, each would look up the height map again: on a CPU that is most of the cost.

    Args:
      terms: f32[N, C], the function that joins two entries, and its neutral element.
    """
    joins = [join for _, join, _ in terms]
    return jax.lax.reduce(
        tuple(array for array, _, _ in terms),
        tuple(jnp.float32(start) for _, _, start in terms),
        lambda left, right: tuple(
            join(a, b) for join, a, b in zip(joins, left, right, strict=True)
        ),
        (1,),
    )


def cells_under(under: UnderSide, heights: HeightMap, candidates: Candidates) -> Array:
    """i32[N, C]: the cell under each column at each candidate."""
    cos = jnp.cos(candidates.yaw)[:, None]
    sin = jnp.sin(candidates.yaw)[:, None]
    x = cos * under.xy[:, 0] - sin * under.xy[:, 1] + candidates.xy[:, 0, None]
    y = sin * under.xy[:, 0] + cos * under.xy[:, 1] + candidates.xy[:, 1, None]
    return heights.index_of(x, y)
