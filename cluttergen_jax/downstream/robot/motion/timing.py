"""Time parameterization: how fast the joints may run along a path (toppra), and where they are at a step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cluttergen_jax.downstream.robot.motion.ik import need

MAX_SPEED = np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])
"""rad/s, Franka's limits for the Panda."""
MAX_ACCELERATION = np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0])
"""rad/s^2."""
SHARE = 0.5
"""Of these limits that is used."""
_STILL = 1e-6
_LEAST_STEP = 0.03
_LEAST_POINTS, _LEAST_GRID = 5, 100
"""Radians between two points of a path that its spline goes through, and how many there are at least."""


class Trajectory(NamedTuple):
    """T steps of a motion.

    Attributes:
      joints: f64[T, 7], radians; speed: f64[T, 7], rad/s.
    """

    joints: np.ndarray
    speed: np.ndarray


def timed(path: np.ndarray, step: float, share: float = SHARE) -> Trajectory:
    """The fastest motion along joints f64[L, 7] within a share of the limits, from rest to rest.

    Args:
      step: seconds between two points of the result.

    Raises:
      MissingExtraError: the extra `robot` is not installed.
    """
    toppra = need("toppra", "time laws of motions")
    algorithm = need("toppra.algorithm", "time laws of motions")
    constraint = need("toppra.constraint", "time laws of motions")
    toppra.setup_logging("ERROR")
    if np.abs(np.ptp(path, axis=0)).max() < _STILL:
        return Trajectory(np.asarray(path)[-1:], np.zeros((1, 7)))
    points = thinned(path)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    path = toppra.SplineInterpolator(length, points, bc_type="natural")
    limits = [
        constraint.JointVelocityConstraint(np.stack([-MAX_SPEED, MAX_SPEED], 1) * share),
        constraint.JointAccelerationConstraint(np.stack([-MAX_ACCELERATION, MAX_ACCELERATION], 1) * share),
    ]
    grid = np.linspace(0, length[-1], max(_LEAST_GRID, 8 * len(points)))
    law = algorithm.TOPPRA(limits, path, gridpoints=grid, parametrizer="ParametrizeConstAccel")
    motion = law.compute_trajectory(0, 0)
    times = np.append(np.arange(0, motion.duration, step), motion.duration)
    return Trajectory(motion(times), motion(times, 1))


def thinned(path: np.ndarray) -> np.ndarray:
    """Points of a path, the ends included, as far apart as a spline wants them; at least `_LEAST_POINTS`."""
    path = np.asarray(path, np.float64)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    kept = [0]
    for k in range(1, len(path) - 1):
        if min(length[k] - length[kept[-1]], length[-1] - length[k]) >= _LEAST_STEP:
            kept.append(k)
    at = length[[*kept, len(path) - 1]]
    if len(at) < _LEAST_POINTS:
        at = np.linspace(0, length[-1], _LEAST_POINTS)
    return np.stack([np.interp(at, length, joint) for joint in path.T], axis=1)
