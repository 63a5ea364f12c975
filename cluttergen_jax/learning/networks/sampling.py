"""Choosing points of a padded cloud: centroids far apart, and the points around each of them."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from cluttergen_jax.types import Array

_SEARCHED_AT_ONCE = 1 << 20
"""Distances held at one time per cloud: four megabytes, whatever the size of the cloud."""


def farthest_points(cloud: Array, mask: Array, number: int) -> tuple[Array, Array]:
    """Farthest-point sampling, as `assets.cloud.farthest_first` orders a cloud.

    Starts with the point farthest from the mean, so that the order of the points does not matter. One step
    per point chosen: for small numbers, or where no order was computed before.

    Args:
      cloud: f32[P, 3]; mask: bool[P], the points that count, at least one.

    Returns:
      i32[number], and bool[number]: False once every point that counts was chosen.
    """
    count = jnp.sum(mask)
    mean = jnp.sum(jnp.where(mask[:, None], cloud, 0.0), axis=0) / jnp.maximum(count, 1)
    from_mean = jnp.where(mask, jnp.sum((cloud - mean) ** 2, axis=1), -1.0)

    def choose(carry: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], Array]:
        distance, current = carry
        to_current = jnp.sum((cloud - cloud[current]) ** 2, axis=1)
        distance = jnp.minimum(distance, jnp.where(mask, to_current, -1.0))
        return (distance, jnp.argmax(distance).astype(jnp.int32)), current

    start = (jnp.full(cloud.shape[0], jnp.inf), jnp.argmax(from_mean).astype(jnp.int32))
    _, index = jax.lax.scan(choose, start, length=number)
    return index, jnp.arange(number) < count


def ball_query(centres: Array, cloud: Array, mask: Array, radius: float, number: int) -> tuple[Array, Array]:
    """The nearest points within a radius of each centre.

    PointNet++ takes the first points that it finds; the nearest do not depend on the order of the points.

    Args:
      centres: f32[S, 3]; cloud: f32[P, 3]; mask: bool[P], the points that count.
      radius: in the unit of the cloud; number: G, at most P are given.

    Returns:
      i32[S, G] by distance, and bool[S, G]: whether there is such a point.
    """
    number = min(number, cloud.shape[0])
    along = cloud.T

    def around(centre: Array) -> tuple[Array, Array]:
        # Differences, not the expanded square: that one cancels, and runs at low precision on a GPU.
        distance = jnp.where(mask, sum((along[i] - centre[i]) ** 2 for i in range(3)), jnp.inf)
        nearest, index = jax.lax.top_k(-distance, number)
        return index, -nearest <= radius**2

    block = max(_SEARCHED_AT_ONCE // cloud.shape[0], 1)
    if block >= centres.shape[0]:
        return jax.vmap(around)(centres)
    return jax.lax.map(around, centres, batch_size=block)
