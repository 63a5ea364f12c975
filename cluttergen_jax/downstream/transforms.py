"""Rigid poses as f64[..., 7] (position, then quaternion wxyz) and f64[..., 4, 4]; how far two are apart."""

from __future__ import annotations

import mujoco
import numpy as np

from cluttergen_jax.geometry import ROUND, yaw_matrix


def matrix_of(pose: np.ndarray) -> np.ndarray:
    """f64[..., 4, 4] of poses f[..., 7]."""
    pose = np.asarray(pose, np.float64)
    quaternion = pose[..., 3:].reshape(-1, 4)
    quaternion = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    turn = np.empty((len(quaternion), 9))
    for row, each in zip(turn, quaternion, strict=True):
        mujoco.mju_quat2Mat(row, each)
    return rigid(turn.reshape(*pose.shape[:-1], 3, 3), pose[..., :3])


def pose_of(matrix: np.ndarray) -> np.ndarray:
    """f64[..., 7] of rigid matrices f[..., 4, 4]."""
    turn = np.asarray(matrix[..., :3, :3], np.float64).reshape(-1, 9)
    quaternion = np.empty((len(turn), 4))
    for row, each in zip(quaternion, turn, strict=True):
        mujoco.mju_mat2Quat(row, each)
    return np.concatenate([matrix[..., :3, 3], quaternion.reshape(*matrix.shape[:-2], 4)], axis=-1)


def rigid(rotation: np.ndarray, position: np.ndarray) -> np.ndarray:
    """f64[..., 4, 4] of a rotation f[..., 3, 3] and a position f[..., 3]."""
    matrix = np.zeros((*rotation.shape[:-2], 4, 4))
    matrix[..., :3, :3] = rotation
    matrix[..., :3, 3] = position
    matrix[..., 3, 3] = 1.0
    return matrix


def turn_matrix(angle: float) -> np.ndarray:
    """f64[4, 4]: a turn about z by radians."""
    return rigid(yaw_matrix(angle), np.zeros(3))


def inverse(matrix: np.ndarray) -> np.ndarray:
    """Of rigid matrices f64[..., 4, 4]."""
    rotation = matrix[..., :3, :3].swapaxes(-1, -2)
    return rigid(rotation, -(rotation @ matrix[..., :3, 3:])[..., 0])


def shift_along(matrix: np.ndarray, along: np.ndarray | tuple[float, float, float]) -> np.ndarray:
    """A pose moved along its own axes by metres f[3]."""
    moved = np.array(matrix, np.float64)
    moved[..., :3, 3] += moved[..., :3, :3] @ np.asarray(along, np.float64)
    return moved


def raise_by(matrix: np.ndarray, height: float) -> np.ndarray:
    """A pose moved along the world's z by metres."""
    moved = matrix.copy()
    moved[..., 2, 3] += height
    return moved


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """f64[...]: radians between the turns of poses f64[..., 4, 4]."""
    trace = np.einsum("...ij,...ij->...", a[..., :3, :3], b[..., :3, :3])
    return np.arccos(np.clip((trace - 1) / 2, -1.0, 1.0))


def motion_between(now: np.ndarray, then: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """f64[...], f64[...]: metres and radians from poses f64[..., 7] to others."""
    shift = np.linalg.norm(now[..., :3] - then[..., :3], axis=-1)
    return shift, angle_between(matrix_of(now), matrix_of(then))


def equal_places(place: np.ndarray, order: int) -> np.ndarray:
    """f64[n, 4, 4]: poses of an object of this symmetry that look like `place` f64[4, 4], itself first."""
    number = min(order, 8)
    angles = 2 * np.pi * np.arange(number) / number
    # Every order that is not round divides the turn without rest, or is taken whole.
    return np.stack([place @ turn_matrix(angle) for angle in angles])


def offset(pose: np.ndarray, goal: np.ndarray, order: int) -> tuple[float, float]:
    """Metres and radians between poses f64[4, 4] of an object, at the best of its equal turns."""
    shift = float(np.linalg.norm(pose[:3, 3] - goal[:3, 3]))
    if order >= ROUND:
        return shift, float(np.arccos(np.clip(pose[:3, 2] @ goal[:3, 2], -1, 1)))
    return shift, float(angle_between(pose, equal_places(goal, order)).min())
