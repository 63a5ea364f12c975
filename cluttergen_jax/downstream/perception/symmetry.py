"""How far a pose is from a goal, up to turns about the object's own z after which it looks the same."""

from __future__ import annotations

import numpy as np

from cluttergen_jax.assets.symmetry import ROUND, TOLERANCE, turn_matrix, turn_symmetry
from cluttergen_jax.downstream.robot.frames import angle_between

__all__ = ["ROUND", "TOLERANCE", "equal_places", "offset", "turn_matrix", "turn_symmetry"]


def equal_places(place: np.ndarray, order: int, most: int = 8) -> np.ndarray:
    """f64[n, 4, 4]: poses of an object of this symmetry that look like `place` f64[4, 4], itself first."""
    number = min(order, most)
    angles = 2 * np.pi * np.arange(number) / number
    # With most = 8 every order that is not round divides the turn without rest, or is taken whole.
    return np.stack([place @ turn_matrix(angle) for angle in angles])


def offset(pose: np.ndarray, goal: np.ndarray, order: int) -> tuple[float, float]:
    """Metres and radians between poses f64[4, 4] of an object, at the best of its equal turns."""
    shift = float(np.linalg.norm(pose[:3, 3] - goal[:3, 3]))
    if order >= ROUND:
        return shift, float(np.arccos(np.clip(pose[:3, 2] @ goal[:3, 2], -1, 1)))
    return shift, float(angle_between(pose, equal_places(goal, order)).min())
