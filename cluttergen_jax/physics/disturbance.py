"""A slight disturbance of what came to rest: gravity tilts and turns once around, contacts give way and slip.

What stands by a hair falls in the next simulator. It is found by one short simulation: the tilt's direction
turns through all directions, so that whatever would tip over an edge is leant over that edge for a while. In
firm contact, heaps pass that fall as soon as contacts give way a little, as they do in most simulators.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.physics.simulations import Simulations
from cluttergen_jax.physics.standing import displacement
from cluttergen_jax.types import Verdict

_DOWN = np.array([0.0, 0.0, -1.0])

_OTHER_SHARE = 3
"""The second detector is asked in a third of the steps: it finds one fragile attempt in a hundred more, and
with all steps a robust scene would cost a third more."""


def disturb(
    sims: Simulations,
    poses: np.ndarray,
    is_placed: np.ndarray,
    focus: np.ndarray,
    config: StabilityConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """Which scenes at rest would not stand under a slight tilt, less friction and softer contacts.

    Args:
      sims: whose first n simulations are used; gravity, contacts and detector are as they were afterwards.
      poses: f[n, K, 7]; is_placed: bool[n, K]; focus: i[n].
      config: with `both_detectors` what stands with one of MuJoCo's detectors is asked with the other, too.

    Returns:
      i32[n], STABLE, FRAGILE or OVERFLOW; and i32[n], steps simulated.
    """
    verdict, num_steps = _disturb(sims, poses, is_placed, focus, config)
    left = np.flatnonzero(verdict == int(Verdict.STABLE))
    if config.both_detectors and left.size:
        with sims.detected_by("libccd", config.file_margin):
            faster = replace(config, robust_steps=max(1, config.robust_steps // _OTHER_SHARE))
            verdict[left], more = _disturb(sims, poses[left], is_placed[left], focus[left], faster)
        num_steps[left] += more
    return verdict, num_steps


def _disturb(
    sims: Simulations,
    poses: np.ndarray,
    is_placed: np.ndarray,
    focus: np.ndarray,
    config: StabilityConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """`disturb` with the detector that is chosen.

    All but the focus object sleep until they are touched, so that only what stands together with it is
    simulated. A scene is fragile as soon as any object is farther from where it came to rest than
    `config.robust_shift`, or has turned by more than `config.robust_turn`.
    """
    verdict = np.full(len(poses), int(Verdict.STABLE), np.int32)
    num_steps = np.zeros(len(poses), np.int32)
    is_focus = np.arange(poses.shape[1]) == focus[:, None]
    start = sims.release(poses, is_placed, never_sleeps=is_focus & is_placed)
    sims.loosen_contacts(config.robust_friction)
    try:
        for down in _directions(config.robust_tilt, config.robust_steps):
            running = np.flatnonzero(verdict == int(Verdict.STABLE))
            if not running.size:
                break
            sims.turn_gravity(down)
            sims.step(running)
            num_steps[running] += 1
            overflowed, is_finite = sims.failures(running)
            poses_now = sims.poses(running)
            _, turn = displacement(np, poses_now, start[running])
            # In soft contact everything sinks a little, which is no fall.
            shift = np.linalg.norm(poses_now[..., :2] - start[running, :, :2], axis=-1)
            is_off = (shift > config.robust_shift) | (turn > config.robust_turn)
            is_fragile = (is_placed[running] & is_off).any(1) | ~is_finite
            verdict[running[is_fragile]] = Verdict.FRAGILE
            verdict[running[overflowed]] = Verdict.OVERFLOW
    finally:
        sims.restore_contacts()
        sims.turn_gravity(_DOWN)
    return verdict, num_steps


def _directions(tilt: float, num_steps: int) -> np.ndarray:
    """f64[T, 3]: unit vectors of gravity, tilted by `tilt` radians, once around."""
    turn = 2 * np.pi * np.arange(num_steps) / num_steps
    sideways = np.sin(tilt) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return np.concatenate([sideways, np.full((num_steps, 1), -np.cos(tilt))], axis=1)
