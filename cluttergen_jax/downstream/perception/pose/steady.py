"""The nudge check: do estimated objects stay where they are said to be, if physics runs for a moment?"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from cluttergen_jax.assets.mjcf import populated_spec
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.config import ContactConfig, StabilityConfig

NUM_STEPS = 20
MOST_SHIFT = 0.003
"""Metres that a steady object moves at most."""


class SteadyCheck:
    """Simulates estimated scenes for a moment.

    Args:
      objects: K. support: what carries them.
    """

    def __init__(self, objects: Sequence[ObjectAsset], support: SupportAsset) -> None:
        names = [f"{index:02d}-{asset.name}" for index, asset in enumerate(objects)]
        spec = populated_spec(names, objects, support, StabilityConfig().timestep, ContactConfig())
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)

    def __call__(self, poses: np.ndarray, is_placed: np.ndarray) -> np.ndarray:
        """bool[K]: of the objects placed, bool[K], at f64[K, 7], those that moved by 3 mm or less."""
        data = self._data
        mujoco.mj_resetData(self._model, data)
        data.qpos.reshape(-1, 7)[is_placed] = poses[is_placed]
        start = data.qpos.reshape(-1, 7)[:, :3].copy()
        mujoco.mj_step(self._model, data, nstep=NUM_STEPS)
        shift = np.linalg.norm(data.qpos.reshape(-1, 7)[:, :3] - start, axis=1)
        return is_placed & (shift <= MOST_SHIFT)
