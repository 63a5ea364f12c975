"""Sharding of a run: its environments on one device (no mesh), or divided evenly over a mesh of devices.

The compiler divides what is between the steps of the environments, and its result is that of one device up
to rounding. The steps themselves may call the host, which no compiler can divide: they are mapped.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from cluttergen_jax.errors import ConfigError

AXIS = "envs"


def make_mesh(num_envs: int) -> Mesh | None:
    """All devices that JAX sees, those of other processes included; None if there is one only.

    Raises:
      ConfigError: the environments cannot be divided evenly among them.
    """
    devices = jax.devices()
    if len(devices) == 1:
        return None
    if num_envs % len(devices):
        near = max(num_envs // len(devices), 1) * len(devices)
        raise ConfigError(
            f"{num_envs} environments on {len(devices)} devices",
            f"a multiple of {len(devices)}",
            f"num_envs={near}, or fewer devices (CUDA_VISIBLE_DEVICES)",
        )
    return Mesh(np.array(devices), (AXIS,), axis_types=(AxisType.Auto,))


def env_sharding(mesh: Mesh) -> NamedSharding:
    """Of arrays whose leading axis is the environments'."""
    return NamedSharding(mesh, PartitionSpec(AXIS))


def whole_sharding(mesh: Mesh) -> NamedSharding:
    """Of arrays that every device holds whole."""
    return NamedSharding(mesh, PartitionSpec())


def state_sharding(mesh: Mesh, state: Any) -> Any:
    """The sharding of each leaf of a `TrainState`."""
    whole = jax.tree.map(lambda _: whole_sharding(mesh), state)
    return whole.replace(env=jax.tree.map(lambda _: env_sharding(mesh), state.env))


def each(function: Callable[..., Any], mesh: Mesh | None) -> Callable[..., Any]:
    """`function` of one environment for all of them, along the leading axis of its arguments."""
    if mesh is None:
        return jax.vmap(function)
    shared = PartitionSpec(AXIS)
    return jax.shard_map(
        jax.vmap(function), mesh=mesh, in_specs=shared, out_specs=shared, check_vma=False
    )


def spread(tree: Any, mesh: Mesh | None) -> Any:
    """The same values, divided among the devices along the leading axis."""
    return tree if mesh is None else jax.lax.with_sharding_constraint(tree, env_sharding(mesh))


def is_key(leaf: Any) -> bool:
    """Whether an array holds PRNG keys."""
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def without_keys(tree: Any) -> Any:
    """A tree with PRNG keys as plain arrays."""
    return jax.tree.map(lambda leaf: jax.random.key_data(leaf) if is_key(leaf) else leaf, tree)


def with_keys(tree: Any, like: Any) -> Any:
    """The inverse of `without_keys`; `like` has the keys' places."""

    def wrap(leaf: Any, other: Any) -> Any:
        if not is_key(other):
            return leaf
        return jax.random.wrap_key_data(jnp.asarray(leaf), impl=jax.random.key_impl(other))

    return jax.tree.map(wrap, tree, like)
