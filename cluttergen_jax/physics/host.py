"""Host functions behind JAX: called once for a whole batch, with NumPy arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.experimental.buffer_callback import buffer_callback

from cluttergen_jax.types import Array

HostFunction = Callable[..., Any]


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
