"""What contacts tell of a scene at rest: how deep bodies overlap, and how well each is carried."""

from __future__ import annotations

import mujoco
import numpy as np

from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.margin import bearers_of, margins_of


class OverlapProbe:
    """Collides one scene at a time, without dynamics, everything awake."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._data = mujoco.MjData(layout.model)
        self._parked = layout.parked

    def depths(self, poses: np.ndarray, is_placed: np.ndarray) -> np.ndarray | None:
        """Overlap of every pair of bodies.

        Args:
          poses: f[K, 7]; is_placed: bool[K].

        Returns:
          f64[K + 1, K + 1], metres, symmetric, index K for the support, zero where apart; None if there was
          no room for all contacts.
        """
        model, data, num_objects = self._layout.model, self._data, self._layout.num_objects
        mujoco.mj_resetData(model, data)
        data.qpos[:] = np.where(is_placed[:, None], poses, self._parked).ravel()
        try:
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_collision(model, data)
        except mujoco.FatalError:
            return None
        if data.warning[mujoco.mjtWarning.mjWARN_CONTACTFULL].number:
            return None
        depths = np.zeros((num_objects + 1, num_objects + 1))
        pair = self._layout.geom_object[data.contact.geom]
        depth = np.maximum(-data.contact.dist, 0.0)
        np.maximum.at(depths, (pair[:, 0], pair[:, 1]), depth)
        return np.maximum(depths, depths.T)

    def margins(self, objects: np.ndarray) -> np.ndarray:
        """Support margins of these objects, i[n], in the scene whose depths were asked for last: f64[n]."""
        return margins_of(self._layout, self._data, objects)

    def bearers(self, index: int) -> np.ndarray:
        """The objects that press object `index` upwards in that scene: bool[K]."""
        return bearers_of(self._layout, self._data, index)
