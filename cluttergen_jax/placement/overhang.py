"""How far objects reach beyond the support's edge, seen from above."""

from __future__ import annotations

import jax.numpy as jnp

from cluttergen_jax.placement.heightmap import Ground
from cluttergen_jax.placement.region import from_pose
from cluttergen_jax.placement.types import Geometry
from cluttergen_jax.types import Array

_HALF = 0.25


def most_beyond(overhang: str) -> float:
    """The share of an object's footprint that may be beyond the edge.

    With "half" it is a quarter: an even body tips where half of it is beyond.
    """
    return {"any": 1.0, "half": _HALF, "none": 0.0}[overhang]


def share_beyond(ground: Ground, xy: Array, is_point: Array) -> Array:
    """f32[...]: the share of some points, world f32[..., P, 2], that the support is not below.

    Args:
      is_point: bool[..., P], those that count.
    """
    is_beyond = is_point & ~ground.is_under(xy)
    return is_beyond.sum(-1) / jnp.maximum(is_point.sum(-1), 1)


def shares_beyond(ground: Ground, geometry: Geometry, poses: Array) -> Array:
    """f32[K]: the share of each object's footprint beyond the edge, at world poses f32[K, 7].

    The footprint is a sample: its columns, twice as dense along its outline, as in the object's own frame.
    The edge is known to half a cell of `Ground`.
    """
    points = jnp.concatenate([geometry.column_xy, geometry.column_bottom[..., None]], axis=-1)
    T_world_object = from_pose(poses)
    turn, shift = T_world_object.rotation().as_matrix()[:, :2], T_world_object.translation()[:, None, :2]
    xy = jnp.einsum("kab,kpb->kpa", turn, points) + shift
    return share_beyond(ground, xy, geometry.is_column)
