"""Support margins of a batch of bodies in JAX: `margin.support_margin`, from a list of contacts."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.geometry import norm
from cluttergen_jax.types import Array

MAX_POINTS = 64
"""Contacts of a body that are looked at. More are left out, which makes its support smaller, never larger."""

_BLOCK = 1024
_SAME_POINT = 1e-7
_FIRST, _SECOND = np.triu_indices(MAX_POINTS, 1)


def support_margins(position: Array, body: Array, center: Array) -> Array:
    """The signed distance of each body's centre of mass to the edge of its contacts' convex hull, in plan.

    Args:
      position: f32[C, 2], metres, contacts of all bodies in any order.
      body: i32[C], whom each carries; B or more for one that carries nobody.
      center: f32[B, 2], metres, centres of mass.

    Returns:
      f32[B], metres: positive within, negative outside; -inf for what nothing carries.
    """
    order = jnp.argsort(body)
    body = body[order]
    rank = jnp.arange(len(body)) - jnp.searchsorted(body, body)
    # The last row takes what carries nobody; a rank beyond the last column is dropped.
    row = jnp.minimum(body, len(center))
    shape = (len(center) + 1, MAX_POINTS)
    points = jnp.zeros((*shape, 2)).at[row, rank].set(position[order], mode="drop")[:-1]
    is_there = jnp.zeros(shape, bool).at[row, rank].set(True, mode="drop")[:-1]
    points = jnp.where(is_there[..., None], points - center[:, None], 0.0)
    return jax.lax.map(lambda each: support_margin(*each), (points, is_there), batch_size=_BLOCK)


def support_margin(points: Array, is_there: Array) -> Array:
    """`margin.support_margin` of the points f32[64, 2] that are there, bool[64].

    The distance is the least value, over all unit directions d, of the largest d.p. It is taken at a normal
    of one of the hull's sides or, where the origin is outside, towards it from a corner: those of all pairs
    of points and of all points are tried.
    """
    side = points[_SECOND] - points[_FIRST]
    length = norm(jnp, side)
    is_side = is_there[_FIRST] & is_there[_SECOND] & (length > _SAME_POINT)
    side = side / jnp.where(is_side, length, 1.0)[:, None]
    lowest, highest = _extent(jnp.stack([-side[:, 1], side[:, 0]], axis=-1), points, is_there)
    by_side = jnp.where(is_side, jnp.minimum(highest, -lowest), jnp.inf)
    distance = norm(jnp, points)
    inwards = -points / jnp.where(distance > 0, distance, 1.0)[:, None]
    by_corner = jnp.where(is_there, _extent(inwards, points, is_there)[1], jnp.inf)
    least = jnp.minimum(by_side.min(), by_corner.min())
    return jnp.where(is_there.any(), least, -jnp.inf)


def _extent(direction: Array, points: Array, is_there: Array) -> tuple[Array, Array]:
    """The least and the largest d.p over the points, for each of the directions f32[D, 2]: f32[D] each."""
    along = direction[:, None, 0] * points[:, 0] + direction[:, None, 1] * points[:, 1]
    return (
        jnp.where(is_there, along, jnp.inf).min(axis=1),
        jnp.where(is_there, along, -jnp.inf).max(axis=1),
    )
