"""What physics says of estimated poses: objects stay where they are for a moment, and none is in another."""

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
_ROUNDS = 8
_FARTHEST = 0.005
"""Metres that an object is pushed at most: more is not an error of a pose that is nearly right."""
_BESIDE = 0.5
"""Of a contact's normal, its level part from which on two objects stand beside each other."""


class SteadyCheck:
    """Asks physics about estimated scenes.

    Args:
      objects: K. support: what carries them.
    """

    def __init__(self, objects: Sequence[ObjectAsset], support: SupportAsset) -> None:
        names = [f"{index:02d}-{asset.name}" for index, asset in enumerate(objects)]
        spec = populated_spec(names, objects, support, StabilityConfig().timestep, ContactConfig())
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._bodies = np.array([self._model.body(name).id for name in names])

    def __call__(self, poses: np.ndarray, is_placed: np.ndarray) -> np.ndarray:
        """bool[K]: of the objects placed, bool[K], at f64[K, 7], those that moved by 3 mm or less."""
        data = self._data
        mujoco.mj_resetData(self._model, data)
        data.qpos.reshape(-1, 7)[is_placed] = poses[is_placed]
        start = data.qpos.reshape(-1, 7)[:, :3].copy()
        mujoco.mj_step(self._model, data, nstep=NUM_STEPS)
        shift = np.linalg.norm(data.qpos.reshape(-1, 7)[:, :3] - start, axis=1)
        return is_placed & (shift <= MOST_SHIFT)

    def apart(self, poses: np.ndarray, is_placed: np.ndarray) -> np.ndarray:
        """f64[K, 7]: poses of which those that overlap beside each other are pushed apart, each by half.

        Args:
          poses: f64[K, 7]; is_placed: bool[K].
        """
        data, found = self._data, poses.copy()
        number = np.full(self._model.nbody, -1)
        number[self._bodies[is_placed]] = np.flatnonzero(is_placed)
        for _ in range(_ROUNDS):
            mujoco.mj_resetData(self._model, data)
            data.qpos.reshape(-1, 7)[is_placed] = found[is_placed]
            mujoco.mj_kinematics(self._model, data)
            mujoco.mj_collision(self._model, data)
            a, b = number[self._model.geom_bodyid[data.contact.geom]].T
            push = np.zeros((len(poses), 2))
            for i, j, depth, normal in zip(a, b, -data.contact.dist, data.contact.frame[:, :2], strict=True):
                level = np.linalg.norm(normal)
                # Of several contacts of two objects the one that asks for the most counts.
                if min(i, j) >= 0 and depth > 0 and level > _BESIDE:
                    for each, way in ((i, -normal), (j, normal)):
                        asked = way * depth / (2 * level**2)
                        push[each] = (
                            asked if np.linalg.norm(asked) > np.linalg.norm(push[each]) else push[each]
                        )
            if not push.any():
                break
            moved = found[:, :2] + push - poses[:, :2]
            far = np.linalg.norm(moved, axis=1, keepdims=True)
            found[:, :2] = poses[:, :2] + moved * np.minimum(1.0, _FARTHEST / np.maximum(far, 1e-12))
        return found
