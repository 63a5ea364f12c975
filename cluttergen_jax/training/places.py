"""Where a learner's state lies: on one device, or divided among those of all processes."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.agent.devices import Devices, ManyDevices, OneDevice
from cluttergen_jax.agent.ppo import PPO, TrainState
from cluttergen_jax.errors import ConfigError


def devices_for(num_envs: int) -> Devices:
    """All devices that JAX sees, those of other processes included.

    Raises:
      ConfigError: the environments cannot be divided evenly among them.
    """
    devices = jax.devices()
    if len(devices) == 1:
        return OneDevice()
    if num_envs % len(devices):
        near = max(num_envs // len(devices), 1) * len(devices)
        raise ConfigError(
            f"{num_envs} environments on {len(devices)} devices",
            f"a multiple of {len(devices)}",
            f"num_envs={near}, or fewer devices (CUDA_VISIBLE_DEVICES)",
        )
    return ManyDevices.of(devices)


def places_of(ppo: PPO, state: TrainState) -> Any:
    """The sharding of each leaf of a state, for a learner on many devices."""
    devices = ppo.devices
    assert isinstance(devices, ManyDevices)
    places = jax.tree.map(lambda _: devices.everywhere, state)
    return places.replace(env=jax.tree.map(lambda _: devices.divided, state.env))


def fresh_state(ppo: PPO, key: Any, params: Any) -> TrainState:
    """`ppo.start`, compiled, each environment made where it belongs."""
    if isinstance(ppo.devices, OneDevice):
        return jax.jit(ppo.start)(key, params)
    data, params = np.asarray(jax.random.key_data(key)), jax.device_get(params)

    def start(data: Any, params: Any) -> TrainState:
        return ppo.start(jax.random.wrap_key_data(data), params)

    places = places_of(ppo, jax.eval_shape(start, data, params))
    return jax.jit(start, out_shardings=places)(data, params)


def placed(ppo: PPO, state: TrainState) -> TrainState:
    """A state that every process holds whole, put where it belongs."""
    if isinstance(ppo.devices, OneDevice):
        return state
    is_key = jax.tree.map(_is_key, state)
    data = jax.tree.map(lambda leaf: np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf), state)

    def wrapped(data: Any) -> Any:
        return jax.tree.map(lambda leaf, key: jax.random.wrap_key_data(leaf) if key else leaf, data, is_key)

    return jax.jit(wrapped, out_shardings=places_of(ppo, state))(data)


def shared(tree: Any) -> Any:
    """The first process's tree of arrays, on all of them."""
    if jax.process_count() == 1:
        return tree
    from jax.experimental.multihost_utils import broadcast_one_to_all

    def first(leaf: Any) -> Any:
        data = np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf)
        data = np.asarray(broadcast_one_to_all(data))
        return jax.random.wrap_key_data(jnp.asarray(data)) if _is_key(leaf) else data

    return jax.tree.map(first, tree)


def _is_key(leaf: Any) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
