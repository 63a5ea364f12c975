"""Physics checks of estimated poses: objects that move when simulated, and objects that overlap."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from cluttergen_jax.assets import ObjectAsset, SupportAsset, populated_spec
from cluttergen_jax.config import ContactConfig, StabilityConfig

NUM_STEPS = 20
MOST_SHIFT = 0.003
"""Metres that a steady object moves at most."""
MOST_MOVED = 0.01
"""Metres that an object is moved at most, so that it overlaps with nothing."""
# Metres of penetration from which on two objects are moved apart, and of the gap that is then left.
_OVERLAP = 0.0002
_GAP = 0.0005

_LEVEL = 0.5
"""Vertical part of a contact normal up to which objects are side by side, and not one on the other."""
_ROUNDS = 30


class PosePhysicsCheck:
    """Simulates estimated scenes for a moment, and moves overlapping objects apart.

    Args:
      objects: K. support: what carries them.
    """

    def __init__(self, objects: Sequence[ObjectAsset], support: SupportAsset) -> None:
        names = [f"{index:02d}-{asset.name}" for index, asset in enumerate(objects)]
        spec = populated_spec(names, objects, support, StabilityConfig().timestep, ContactConfig())
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        # Of each body the number of the object; -1 of the support and of the world.
        self._number = np.full(self._model.nbody, -1)
        for index, name in enumerate(names):
            self._number[self._model.body(name).id] = index

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
        """The poses f64[K, 7], those of objects that overlap side by side moved apart along the table.

        Estimates are millimetres wrong, and no layout stands around objects that overlap. Each of two gives
        way by half; all poses are as they were where one would move by more than a centimetre.

        Args:
          is_placed: bool[K], the objects that are there.
        """
        data = self._data
        moved = poses.copy()
        mujoco.mj_resetData(self._model, data)
        for _ in range(_ROUNDS):
            data.qpos.reshape(-1, 7)[is_placed] = moved[is_placed]
            mujoco.mj_kinematics(self._model, data)
            mujoco.mj_collision(self._model, data)
            push = self._pushes()
            if not push.any():
                break
            moved[:, :2] += push
        too_far = np.linalg.norm(moved[:, :2] - poses[:, :2], axis=1).max(initial=0.0) > MOST_MOVED
        return poses.copy() if too_far else moved

    def _pushes(self) -> np.ndarray:
        """f64[K, 2]: by how much each object has to move, for the deepest contact of each pair."""
        contact = self._data.contact
        deepest = dict[tuple[int, int], int]()
        pairs = self._number[self._model.geom_bodyid[contact.geom]]
        is_beside = (
            (contact.dist < -_OVERLAP)
            & (np.abs(contact.frame[:, 2]) < _LEVEL)
            & (pairs >= 0).all(1)
        )
        for k in np.flatnonzero(is_beside)[np.argsort(-contact.dist[is_beside], kind="stable")]:
            deepest[tuple(pairs[k].tolist())] = k
        push = np.zeros((self._model.nq // 7, 2))
        for (first, second), k in deepest.items():
            normal = contact.frame[k, :2] / np.linalg.norm(contact.frame[k, :2])
            shift = (_GAP - contact.dist[k]) / 2 * normal
            push[first] -= shift
            push[second] += shift
        return push
