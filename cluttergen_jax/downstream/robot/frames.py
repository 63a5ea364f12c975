"""Poses f64[..., 7] (position, then quaternion wxyz) as matrices f64[..., 4, 4], and back."""

from __future__ import annotations

import mujoco
import numpy as np


def matrix_of(pose: np.ndarray) -> np.ndarray:
    """f64[..., 4, 4] of poses f[..., 7]."""
    pose = np.asarray(pose, np.float64)
    quaternion = pose[..., 3:].reshape(-1, 4)
    quaternion = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    turn = np.empty((len(quaternion), 9))
    for row, each in zip(turn, quaternion, strict=True):
        mujoco.mju_quat2Mat(row, each)
    return made(turn.reshape(*pose.shape[:-1], 3, 3), pose[..., :3])


def pose_of(matrix: np.ndarray) -> np.ndarray:
    """f64[..., 7] of rigid matrices f[..., 4, 4]."""
    turn = np.asarray(matrix[..., :3, :3], np.float64).reshape(-1, 9)
    quaternion = np.empty((len(turn), 4))
    for row, each in zip(quaternion, turn, strict=True):
        mujoco.mju_mat2Quat(row, each)
    return np.concatenate([matrix[..., :3, 3], quaternion.reshape(*matrix.shape[:-2], 4)], axis=-1)


def made(rotation: np.ndarray, position: np.ndarray) -> np.ndarray:
    """f64[..., 4, 4] of a rotation f[..., 3, 3] and a position f[..., 3]."""
    matrix = np.zeros((*rotation.shape[:-2], 4, 4))
    matrix[..., :3, :3], matrix[..., :3, 3], matrix[..., 3, 3] = rotation, position, 1.0
    return matrix


def inverse(matrix: np.ndarray) -> np.ndarray:
    """Of rigid matrices f64[..., 4, 4]."""
    rotation = matrix[..., :3, :3].swapaxes(-1, -2)
    return made(rotation, -(rotation @ matrix[..., :3, 3:])[..., 0])


def shifted(matrix: np.ndarray, along: np.ndarray | tuple[float, float, float]) -> np.ndarray:
    """A pose moved along its own axes by metres f[3]."""
    moved = np.array(matrix, np.float64)
    moved[..., :3, 3] += moved[..., :3, :3] @ np.asarray(along, np.float64)
    return moved


def raised(matrix: np.ndarray, height: float) -> np.ndarray:
    """A pose moved along the world's z by metres."""
    moved = matrix.copy()
    moved[..., 2, 3] += height
    return moved


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """f64[...]: radians between the turns of poses f64[..., 4, 4]."""
    trace = np.einsum("...ij,...ij->...", a[..., :3, :3], b[..., :3, :3])
    return np.arccos(np.clip((trace - 1) / 2, -1.0, 1.0))
