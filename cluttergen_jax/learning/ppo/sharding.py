"""What several devices and several processes share: environments over a mesh, one state, one writer.

The compiler divides what is between the steps of the environments, and its result is that of one device up
to rounding. The steps themselves may call the host, which no compiler can divide: they are mapped."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from cluttergen_jax.errors import ConfigError, range_text

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


def join(coordinator: str | None, num_processes: int | None, process_id: int | None) -> None:
    """Makes this process one of several; nothing to do if no coordinator is given.

    Call it before anything is computed.

    Args:
      coordinator: HOST:PORT of process 0; num_processes: how many there are; process_id: which one this is.

    Raises:
      ConfigError: one of them is missing or out of range, or the others do not answer.
    """
    given = (coordinator, num_processes, process_id)
    if all(value is None for value in given):
        return
    if coordinator is None or num_processes is None or process_id is None:
        raise ConfigError(
            "some of `coordinator`, `num_processes` and `process_id`",
            "all three or none",
            "coordinator='HOST:PORT', num_processes=2, process_id=0, and the same with process_id=1",
        )
    if not 0 <= process_id < num_processes:
        raise ConfigError(
            f"process_id = {process_id} of {num_processes}",
            range_text(0, num_processes - 1, "num_processes of 1 or more"),
        )
    jax.config.update("jax_cpu_collectives_implementation", "gloo")
    try:
        jax.distributed.initialize(coordinator, num_processes, process_id)
    except (RuntimeError, ValueError) as error:
        raise ConfigError(
            f"no connection by way of {coordinator}: {error}",
            "a HOST:PORT of process 0 that all can reach",
            "the same coordinator and number everywhere, started within five minutes of each other",
        ) from error
    # Processes on CPUs get to know each other in their first collective, for which they wait half a minute
    # only: it is made here, where all of them have just arrived.
    agree(0)


def is_writer() -> bool:
    """Whether this process shows figures and writes files: the first one does."""
    return jax.process_index() == 0


def agree(*values: float) -> np.ndarray:
    """The values of each process, f64[num processes, num values], the same on all of them."""
    mine = np.array(values, np.float64)
    if jax.process_count() == 1:
        return mine[None]
    from jax.experimental.multihost_utils import process_allgather

    return np.asarray(process_allgather(mine.astype(np.float32))).astype(np.float64)


def gather(tree: Any) -> Any:
    """The whole of arrays that are divided among processes, on each of them. With one process, as it is."""
    if jax.process_count() == 1:
        return tree
    from jax.experimental.multihost_utils import process_allgather

    return with_keys(process_allgather(without_keys(tree), tiled=True), tree)


def broadcast(tree: Any) -> Any:
    """The first process's tree of arrays, on all of them."""
    if jax.process_count() == 1:
        return tree
    from jax.experimental.multihost_utils import broadcast_one_to_all

    return with_keys(broadcast_one_to_all(jax.tree.map(np.asarray, without_keys(tree))), tree)
