"""How much room MJX's Warp engine needs for contacts and constraints: measured on crowded scenes."""

from __future__ import annotations

import mujoco
import numpy as np

from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.log import silent_log

_MARGIN = 2.0
_LEAST_CONTACTS = 32


def room_for(layout: Layout, num_scenes: int = 8, num_steps: int = 60) -> tuple[int, int]:
    """ContactRows and constraint rows that one scene may need at most, with a margin of two.

    All objects are dropped at once, close together, and the most that MuJoCo ever counts is taken.
    """
    rng = np.random.default_rng(0)
    most_contacts, most_rows = _LEAST_CONTACTS / _MARGIN, 0.0
    with silent_log():
        for _ in range(num_scenes):
            data = mujoco.MjData(layout.model)
            data.qpos[:] = _crowd(layout, rng).ravel()
            for _ in range(num_steps):
                mujoco.mj_step(layout.model, data)
                most_contacts, most_rows = max(most_contacts, data.ncon), max(most_rows, data.nefc)
    # A contact has at most six rows (pyramidal, condim 4), should the engines count contacts differently.
    return int(_MARGIN * most_contacts), int(_MARGIN * max(most_rows, 6 * most_contacts))


def _crowd(layout: Layout, rng: np.random.Generator) -> np.ndarray:
    """f64[K, 7]: upright objects, any yaw, in a heap over the middle of the support."""
    model, num_objects = layout.model, layout.num_objects
    support = layout.geom_object == num_objects
    center = model.geom_pos[support, :2].mean(0)
    reach = np.zeros(num_objects)
    np.maximum.at(
        reach,
        layout.geom_object[~support],
        model.geom_rbound[~support] + np.linalg.norm(model.geom_pos[~support], axis=1),
    )
    spread = np.sqrt(num_objects) * reach.mean()
    yaw = rng.uniform(0, np.pi, num_objects)
    poses = np.zeros((num_objects, 7))
    poses[:, :2] = center + rng.uniform(-spread, spread, (num_objects, 2)) / 2
    poses[:, 2] = layout.top + reach * rng.uniform(0.5, 1.5, num_objects)
    poses[:, 3], poses[:, 6] = np.cos(yaw), np.sin(yaw)
    return poses
