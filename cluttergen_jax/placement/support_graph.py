"""What carries what among placed objects: kept from contacts at rest, asked when objects are taken away."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from cluttergen_jax.placement.config import MAX_MARGIN
from cluttergen_jax.placement.types import Geometry, SupportGraph
from cluttergen_jax.types import Array, Settling


def empty_graph(geometry: Geometry) -> SupportGraph:
    """Nothing leans on anything; all are trusted as they stand on a flat table."""
    number = geometry.num_objects
    return SupportGraph(
        leans_on=jnp.zeros((number, number), bool),
        level=jnp.zeros(number, jnp.int32),
        margin=jnp.asarray(geometry.own_margin, jnp.float32),
    )


def graph_after_settling(graph: SupportGraph, is_focus: Array, settling: Settling) -> SupportGraph:
    """What carries what once the focus object, bool[K], has come to rest."""
    highest = jnp.max(jnp.where(settling.bears, graph.level, -1), initial=-1)
    # Those that an attempt did not move have an infinite margin: nothing about them is new. A neighbour that
    # it moved may have come to lean on the new object.
    is_moved = ~jnp.isposinf(settling.margin) & ~is_focus
    leans_on = graph.leans_on | ((is_moved & settling.touches)[:, None] & is_focus)
    return SupportGraph(
        leans_on=jnp.where(is_focus[:, None], settling.touches, leans_on),
        level=jnp.where(is_focus, highest + 1, graph.level).astype(jnp.int32),
        margin=jnp.where(
            is_moved | is_focus, jnp.maximum(settling.margin, -MAX_MARGIN), graph.margin
        ),
    )


def graph_without(graph: SupportGraph, which: Array, geometry: Geometry) -> SupportGraph:
    """What carries what once the objects `which`, bool[K], are gone."""
    empty = empty_graph(geometry)
    return SupportGraph(
        leans_on=graph.leans_on & ~which[:, None] & ~which,
        level=jnp.where(which, empty.level, graph.level),
        margin=jnp.where(which, empty.margin, graph.margin),
    )


def supported_by(which: Array, leans_on: Array) -> Array:
    """These objects and all that leans on them, directly or by way of others: bool[K].

    Args:
      which: bool[K]; leans_on: bool[K, K], row k: what object k leans on.
    """

    def widen(state: tuple[Array, Array]) -> tuple[Array, Array]:
        now, _ = state
        return now | jnp.any(leans_on & now, axis=1), now

    return jax.lax.while_loop(
        lambda state: jnp.any(state[0] != state[1]), widen, (which, which & False)
    )[0]
