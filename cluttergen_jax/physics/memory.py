"""How much memory an engine takes for a batch of scenes."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from cluttergen_jax.physics.log import silent_log
from cluttergen_jax.physics.native import MAX_BATCHES, NativePhysics

_HEAP = 0.25
"""Metres from the middle of the support within which the objects of the measured heap lie."""


def engine_bytes(physics: Any, num_scenes: int) -> int:
    """Bytes for attempts in `num_scenes` scenes at once; 0 for an engine that is not known."""
    if isinstance(physics, NativePhysics):
        return _native_bytes(physics, num_scenes)
    # MJX takes a second to import, and the native engine is the common one.
    from cluttergen_jax.physics.mjx import MjxPhysics

    return _mjx_bytes(physics, num_scenes) if isinstance(physics, MjxPhysics) else 0


def _native_bytes(physics: NativePhysics, num_scenes: int) -> int:
    """Simulations of all cached batch sizes, each with the room that a heap of all objects takes.

    MuJoCo's arena is larger, but memory that is never written to is never taken.
    """
    largest = min(physics.max_simulations, 1 << max(num_scenes - 1, 0).bit_length())
    sizes = [largest >> halvings for halvings in range(MAX_BATCHES)]
    layout = physics.layout
    data = mujoco.MjData(layout.model)
    poses = layout.parked
    spread = np.random.default_rng(0).uniform(-_HEAP, _HEAP, (layout.num_objects, 2))
    poses[:, :2] = layout.model.geom_pos[layout.geom_object == layout.num_objects, :2].mean(0) + spread
    poses[:, 2] = layout.top + 0.05
    data.qpos[:] = poses.ravel()
    with silent_log():
        mujoco.mj_forward(layout.model, data)
    trajectory = (physics.config.max_steps + 1) * 13 * 4
    return sum(sizes) * (data.nbuffer + 2 * data.maxuse_arena) + 2 * num_scenes * trajectory


def _mjx_bytes(physics: Any, num_scenes: int) -> int:
    """The state of all simulations, twice: a loop keeps the old one while it makes the new one."""
    start = jax.ShapeDtypeStruct((num_scenes, physics.layout.num_objects, 7), jnp.float32)
    data = jax.eval_shape(physics.scenes.release, start)
    return 2 * sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(data))
