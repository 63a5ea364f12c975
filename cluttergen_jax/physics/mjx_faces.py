"""A correction of pure-JAX MJX's mesh contacts: a face that touches flat keeps all four points.

MJX compares the best face and the best pair of edges of two convex meshes and takes the edges wherever they
are as deep to within a micrometre. Where two faces touch flat they always are, so rounding decides: a box at
rest on a table lost three of its four contacts about every fifteenth step and never came to rest by the rule.
Its box-box function prefers the face if both normals agree, and here the same is done for meshes.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import jax
import jax.numpy as jnp
from mujoco.mjx._src import collision_convex

from cluttergen_jax.types import Array

_SAME_NORMAL = 0.99
_lock = threading.RLock()


@contextmanager
def faces_first() -> Iterator[None]:
    """MJX's separating-axis test is replaced while a step is traced, and put back."""
    with _lock:
        original = collision_convex._sat_gaussmap
        collision_convex._sat_gaussmap = _preferring_faces(original)
        try:
            yield
        finally:
            collision_convex._sat_gaussmap = original


def _preferring_faces(original: Callable[..., Any]) -> Callable[..., tuple[Array, Array, Array]]:
    def test(*args: Array) -> tuple[Array, Array, Array]:
        shape, (edges_a, *rest) = args[:-4], args[-4:]
        # Edges without length are never taken: what the faces alone say. Both in one go compile as one.
        both = jnp.stack([edges_a, jnp.repeat(edges_a[:, :1], 2, axis=1)])
        found = jax.vmap(lambda edges: original(*shape, edges, *rest))(both)
        normal = found[2][:, 0]
        is_flat = jnp.abs(normal[0] @ normal[1]) > _SAME_NORMAL
        dist, pos, normal = (jnp.where(is_flat, each[1], each[0]) for each in found)
        return dist, pos, normal

    return test
