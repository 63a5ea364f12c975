"""A physics whose engine can be changed between calls: one compiled program measures many engines."""

from __future__ import annotations

import time
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.physics.host import host_function
from cluttergen_jax.physics.report import empty_settling, empty_standing
from cluttergen_jax.types import Array, Settling, Standing


class BatchEngine(Protocol):
    """An engine that runs on the host: N scenes held in NumPy arrays with one leading axis."""

    config: StabilityConfig

    def settle_batch(
        self, poses: np.ndarray, is_placed: np.ndarray, focus: np.ndarray, is_active: np.ndarray
    ) -> Settling:
        """`protocol.Physics.settle` for each of them."""
        ...

    def stand_batch(self, poses: np.ndarray, is_placed: np.ndarray, is_active: np.ndarray) -> Standing:
        """`protocol.Physics.stand` for each of them."""
        ...


class HostPhysics:
    """`protocol.Physics` that asks whatever `engine` is at the moment of the call.

    What is compiled around it (the rules and the method) stays compiled when the engine changes.

    Attributes:
      settle_seconds, stand_seconds: CPU time of this process, all threads, spent in the engine since `use`.
    """

    def __init__(self, num_objects: int, config: StabilityConfig) -> None:
        self.config = config
        self.settle_seconds, self.stand_seconds = 0.0, 0.0
        settling = jax.eval_shape(lambda: empty_settling(jnp, (), num_objects, config))
        standing = jax.eval_shape(lambda: empty_standing(jnp, (), num_objects))
        self._settle_one = host_function(self._settle, settling)
        self._stand_one = host_function(self._stand, standing)

    def use(self, engine: BatchEngine) -> None:
        """The engine of all calls from now on."""
        self._engine = engine
        self.settle_seconds, self.stand_seconds = 0.0, 0.0

    def settle(self, poses: Array, is_placed: Array, focus: Array, is_active: Array) -> Settling:
        """See `protocol.Physics.settle`."""
        return self._settle_one(*map(jnp.asarray, (poses, is_placed, focus, is_active)))

    def stand(self, poses: Array, is_placed: Array, is_active: Array) -> Standing:
        """See `protocol.Physics.stand`."""
        return self._stand_one(*map(jnp.asarray, (poses, is_placed, is_active)))

    def _settle(self, *arrays: np.ndarray) -> Settling:
        started = time.process_time()
        result = self._engine.settle_batch(*map(np.asarray, arrays))
        self.settle_seconds += time.process_time() - started
        return result

    def _stand(self, *arrays: np.ndarray) -> Standing:
        started = time.process_time()
        result = self._engine.stand_batch(*map(np.asarray, arrays))
        self.stand_seconds += time.process_time() - started
        return result
