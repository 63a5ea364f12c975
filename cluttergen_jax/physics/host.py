"""Engines of whole batches behind the interface of one scene; those on the host get NumPy arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.buffer_callback import buffer_callback

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.physics.report import empty_settling, empty_standing
from cluttergen_jax.progress import COMPILING
from cluttergen_jax.types import Array, Settling, Standing

HostFunction = Callable[..., Any]


class OneScenePhysics:
    """`protocol.Physics` on functions of one scene: arguments may be of whatever type fits.

    Args:
      config: when an object stands still.
      settle_one, stand_one: take arrays of the types that the interface names.
    """

    compiling = COMPILING
    """What to say before its programs are compiled."""

    def __init__(self, config: StabilityConfig, settle_one: HostFunction, stand_one: HostFunction) -> None:
        self.config = config
        self._settle_one, self._stand_one = settle_one, stand_one

    def settle(self, poses: Array, is_placed: Array, focus: Array, is_active: Array) -> Settling:
        """See `protocol.Physics.settle`."""
        return self._settle_one(
            jnp.asarray(poses, jnp.float32),
            jnp.asarray(is_placed, bool),
            jnp.asarray(focus, jnp.int32),
            jnp.asarray(is_active, bool),
        )

    def stand(self, poses: Array, is_placed: Array, is_active: Array) -> Standing:
        """See `protocol.Physics.stand`."""
        return self._stand_one(
            jnp.asarray(poses, jnp.float32), jnp.asarray(is_placed, bool), jnp.asarray(is_active, bool)
        )


class BatchEngine(Protocol):
    """An engine on the host: N scenes held in NumPy arrays with one leading axis."""

    config: StabilityConfig

    def settle_batch(
        self, poses: np.ndarray, is_placed: np.ndarray, focus: np.ndarray, is_active: np.ndarray
    ) -> Settling:
        """`protocol.Physics.settle` for each of them."""
        ...

    def stand_batch(self, poses: np.ndarray, is_placed: np.ndarray, is_active: np.ndarray) -> Standing:
        """`protocol.Physics.stand` for each of them."""
        ...

    def free(self) -> None:
        """Gives back what it holds for its next batches; they are only slower to begin."""
        ...


class HostPhysics(OneScenePhysics):
    """`protocol.Physics` by the methods of a `BatchEngine`, which subclasses have.

    Args:
      num_objects: K; config: when an object stands still.
    """

    settle_batch: HostFunction
    stand_batch: HostFunction

    def __init__(self, num_objects: int, config: StabilityConfig) -> None:
        settling = jax.eval_shape(lambda: empty_settling(jnp, (), num_objects, config))
        standing = jax.eval_shape(lambda: empty_standing(jnp, (), num_objects))
        super().__init__(
            config, host_function(self.settle_batch, settling), host_function(self.stand_batch, standing)
        )


class SwappablePhysics(HostPhysics):
    """`protocol.Physics` that asks whichever `engine` is set at the moment of the call.

    What is compiled around it stays compiled when the engine changes: K and config are the same for all.
    """

    engine: BatchEngine

    def settle_batch(self, *arrays: np.ndarray) -> Settling:
        """See `BatchEngine`."""
        return self.engine.settle_batch(*arrays)

    def stand_batch(self, *arrays: np.ndarray) -> Standing:
        """See `BatchEngine`."""
        return self.engine.stand_batch(*arrays)


def host_function(function: HostFunction, shapes: Any) -> HostFunction:
    """`function` as a pure JAX function of one scene that may be mapped any number of times.

    On a CPU it works on XLA's own buffers. `jax.pure_callback` would make JAX arrays of its arguments first,
    and the copy of a large one waits for a thread of XLA's pool, whose threads may all be waiting in
    callbacks: with two cores and a few independent callbacks that hung within seconds. From a GPU the
    arguments arrive as host memory, and no thread of that pool is held.

    Args:
      function: takes N scenes as NumPy arrays with one leading axis, which it may not keep, and returns
        `shapes` with that axis. Its last argument has no axes of its own.
      shapes: the result for one scene, a pytree of `jax.ShapeDtypeStruct`.
    """
    batched = _flattened(function)

    def write(context: Any, out: Any, *buffers: Any) -> None:
        del context
        results = batched(*(np.asarray(buffer) for buffer in buffers))
        for buffer, result in zip(jax.tree.leaves(out), jax.tree.leaves(results), strict=True):
            np.asarray(buffer)[...] = result

    on_buffers = buffer_callback(write, shapes, vmap_method="broadcast_all")

    def call(*args: Array) -> Any:
        if jax.default_backend() == "cpu":
            return on_buffers(*args)
        return jax.pure_callback(batched, shapes, *args, vmap_method="broadcast_all")

    return call


def _flattened(function: HostFunction) -> HostFunction:
    """`function` for any number of leading axes, none included."""

    def call(*args: Array) -> Any:
        arrays = [np.asarray(array) for array in args]
        batch = arrays[-1].shape
        num_scenes = int(np.prod(batch))
        result = function(*(array.reshape((num_scenes, *array.shape[len(batch) :])) for array in arrays))
        return jax.tree.map(lambda array: array.reshape((*batch, *array.shape[1:])), result)

    return call
