"""What physics says of estimated poses: do objects stay there for a moment, and does one fill another?"""

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
MOST_MOVED = 0.01
"""Metres that an object is moved at most, so that it overlaps with nothing."""
_OVERLAP, _GAP = 0.0002, 0.0005
"""Metres from which on two objects overlap, and that are then left between them."""
_LEVEL = 0.5
"""Height of a unit normal up to which objects stand beside each other, and not on each other."""
_ROUNDS = 30


class SteadyCheck:
    """Looks at estimated scenes as physics has them.

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
        data, moved = self._data, poses.copy()
        mujoco.mj_resetData(self._model, data)
        for _ in range(_ROUNDS):
            data.qpos.reshape(-1, 7)[is_placed] = moved[is_placed]
            mujoco.mj_kinematics(self._model, data)
            mujoco.mj_collision(self._model, data)
            push = self._pushes(is_placed)
            if not push.any():
                break
            moved[:, :2] += push
        too_far = np.linalg.norm(moved[:, :2] - poses[:, :2], axis=1).max(initial=0.0) > MOST_MOVED
        return poses.copy() if too_far else moved

    def _pushes(self, is_placed: np.ndarray) -> np.ndarray:
        """f64[K, 2]: by how much each object has to move for its deepest overlap with each other one."""
        data, deepest = self._data, dict[tuple[int, int], tuple[float, np.ndarray]]()
        for contact in data.contact[: data.ncon]:
            first, second = (int(self._number[self._model.geom_bodyid[geom]]) for geom in contact.geom)
            if min(first, second) < 0 or not (is_placed[first] and is_placed[second]):
                continue
            if contact.dist > -_OVERLAP or abs(contact.frame[2]) > _LEVEL:
                continue
            depth, pair = -float(contact.dist), (first, second)
            if depth > deepest.get(pair, (0.0, None))[0]:
                deepest[pair] = depth, contact.frame[:2] / np.linalg.norm(contact.frame[:2])
        push = np.zeros((len(is_placed), 2))
        for (first, second), (depth, normal) in deepest.items():
            push[first] -= (depth + _GAP) / 2 * normal
            push[second] += (depth + _GAP) / 2 * normal
        return push
