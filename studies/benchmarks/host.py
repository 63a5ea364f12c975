"""A physics whose engine can be changed between calls: one compiled program measures many engines."""

from __future__ import annotations

import time

import numpy as np

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.physics.host import BatchEngine, HostPhysics
from cluttergen_jax.types import Settling, Standing


class TimedPhysics(HostPhysics):
    """`HostPhysics` that asks whichever engine is in use at the moment of the call, with a clock.

    Attributes:
      settle_seconds, stand_seconds: CPU time of this process, all threads, spent in the engine since `use`.
    """

    def __init__(self, num_objects: int, config: StabilityConfig) -> None:
        super().__init__(num_objects, config)
        self.settle_seconds = 0.0
        self.stand_seconds = 0.0

    def use(self, engine: BatchEngine) -> None:
        """The engine of all calls from now on."""
        self.engine = engine
        self.settle_seconds = 0.0
        self.stand_seconds = 0.0

    def settle_batch(self, *arrays: np.ndarray) -> Settling:
        """See `BatchEngine`."""
        started = time.process_time()
        result = self.engine.settle_batch(*arrays)
        self.settle_seconds += time.process_time() - started
        return result

    def stand_batch(self, *arrays: np.ndarray) -> Standing:
        """See `BatchEngine`."""
        started = time.process_time()
        result = self.engine.stand_batch(*arrays)
        self.stand_seconds += time.process_time() - started
        return result
