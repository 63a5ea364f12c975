"""Several processes that train one policy together: who writes, how they agree, how they share a state."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from cluttergen_jax.errors import ConfigError, range_text
from cluttergen_jax.learning.ppo.ppo import PPO, TrainState
from cluttergen_jax.learning.ppo.sharding import state_sharding, with_keys, without_keys


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


def fresh_state(ppo: PPO, key: Any, params: Any) -> TrainState:
    """`ppo.start`, compiled, each environment made where it belongs."""
    if ppo.mesh is None:
        return jax.jit(ppo.start)(key, params)
    data = np.asarray(jax.random.key_data(key))
    params = jax.device_get(params)
    implementation = jax.random.key_impl(key)

    def start(data: Any, params: Any) -> TrainState:
        return ppo.start(jax.random.wrap_key_data(data, impl=implementation), params)

    sharding = state_sharding(ppo.mesh, jax.eval_shape(start, data, params))
    return jax.jit(start, out_shardings=sharding)(data, params)


def put_state(ppo: PPO, state: TrainState) -> TrainState:
    """A state that every process holds whole, put where it belongs."""
    if ppo.mesh is None:
        return state
    data = jax.tree.map(np.asarray, without_keys(state))
    return jax.jit(
        lambda data: with_keys(data, state), out_shardings=state_sharding(ppo.mesh, state)
    )(data)
