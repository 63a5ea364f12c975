"""The paper's count of a placement: every object is quiet at some time, however far it was pushed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.geometry import rotate
from cluttergen_jax.physics import stability
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.log import silent_log
from cluttergen_jax.physics.simulations import Simulations, sleeping_model

MAX_ANGULAR_SPEED = math.radians(2)
_AT_ONCE = 128


class PaperCount:
    """Counts placements as the published code of the paper does when it evaluates its placement network.

    The object is put where it was proposed, everything awake; it counts if each object is quiet for 20 steps
    in a row within 60, at 2 deg/s where elsewhere 0.5 is asked for. Neighbours may be pushed any distance.

    Args:
      layout: the compiled world; config: the other limits; num_threads: 0 takes every core.
    """

    def __init__(self, layout: Layout, config: StabilityConfig, num_threads: int = 0) -> None:
        self._config = replace(config, max_angular_speed=MAX_ANGULAR_SPEED)
        self._sims = Simulations(sleeping_model(layout.model), layout, _AT_ONCE, num_threads)

    def __call__(self, poses: np.ndarray, is_placed: np.ndarray) -> np.ndarray:
        """bool[P]: whether each scene counts; poses: f[P, K, 7], world; is_placed: bool[P, K]."""
        parts = [slice(first, first + _AT_ONCE) for first in range(0, len(poses), _AT_ONCE)]
        with silent_log():
            return np.concatenate([self._count(poses[part], is_placed[part]) for part in parts])

    def _count(self, poses: np.ndarray, is_placed: np.ndarray) -> np.ndarray:
        config = self._config
        num_scenes = len(poses)
        self._sims.release(poses, is_placed, never_sleeps=is_placed)
        motion = self._sims.run(np.arange(num_scenes), config.decision_step)
        velocity = motion.velocities
        velocity[..., 3:] = rotate(np, motion.poses[..., 3:], velocity[..., 3:])
        before = np.concatenate([np.zeros_like(velocity[:, :1]), velocity[:, :-1]], axis=1)
        acceleration = (velocity - before) / config.timestep
        is_quiet = stability.is_quiet_step(np, velocity, acceleration, config)
        hold = np.zeros(is_placed.shape, int)
        was_quiet = ~is_placed
        for step in range(config.decision_step):
            hold = np.where(is_quiet[:, step], hold + 1, 0)
            was_quiet = was_quiet | (hold >= config.quiet_steps)
        return was_quiet.all(1) & motion.is_finite & ~motion.overflowed
