"""A recording made by hand, with known answers: a red and a green cube on a small table."""

from __future__ import annotations

import numpy as np

from cluttergen_jax.assets.support import Rectangle, cuboid_table
from cluttergen_jax.placement.replay import Attempt, Replay
from cluttergen_jax.types import Verdict
from tests.helpers.drawing import GREEN, RED

TOP = 0.4


def pose(x: float, y: float, z: float) -> np.ndarray:
    """f32[7], upright."""
    return np.array([x, y, z, 1, 0, 0, 0], np.float32)


RED_AT = pose(-0.08, 0.0, TOP + 0.05)
GREEN_AT = pose(0.08, 0.02, TOP + 0.04)


def _attempt(
    index: int, ordinal: int, verdict: Verdict, path: np.ndarray, placed: list[int]
) -> Attempt:
    trajectory = np.zeros((len(path), 13), np.float32)
    trajectory[:, :3] = path
    trajectory[:, 3] = 1.0
    poses = np.zeros((2, 7), np.float32)
    poses[:, 3] = 1.0
    if 0 in placed:
        poses[0] = RED_AT
    settled = poses.copy()
    settled[index] = trajectory[-1, :7]
    is_placed = np.isin([0, 1], placed)
    return Attempt(
        index, ordinal, np.full(4, 0.5, np.float32), verdict, trajectory, poses, is_placed, settled
    )


def _path(start: np.ndarray, end: np.ndarray, num_steps: int) -> np.ndarray:
    share = np.linspace(0, 1, num_steps + 1)[:, None]
    return (1 - share) * start[:3] + share * end[:3]


def cubes() -> Replay:
    """Red stands at once; green fails twice (displaced, fell off the near edge) and then stands."""
    attempts = (
        _attempt(0, 1, Verdict.STABLE, _path(RED_AT + pose(0, 0, 0.02), RED_AT, 24), []),
        _attempt(
            1, 1, Verdict.DISPLACED, _path(pose(-0.05, 0, 0.55), pose(0.0, -0.06, 0.46), 60), [0]
        ),
        _attempt(1, 2, Verdict.FELL, _path(pose(0.14, 0, 0.5), pose(0.18, -0.02, 0.3), 60), [0]),
        _attempt(1, 3, Verdict.STABLE, _path(GREEN_AT + pose(0, 0, 0.03), GREEN_AT, 24), [0]),
    )
    return Replay(
        title="cubes",
        objects=(RED, GREEN),
        names=("red", "green"),
        support=cuboid_table(0.32, 0.24, TOP),
        region=Rectangle((0.0, 0.0), (0.16, 0.12), 0.0),
        attempts=attempts,
        poses=np.stack([RED_AT, GREEN_AT]),
        is_placed=np.ones(2, bool),
        is_success=True,
        verdict="stable",
        drift=0.00002,
    )
