"""How an object comes to rest by itself: plain MuJoCo, alone on a wide table."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco.batch import Batch

from cluttergen_jax.assets.mjcf import add_object, new_spec
from cluttergen_jax.assets.object import ObjectAsset, RestingPose
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.geometry import rotation_matrix

_SETTLE_STEPS = 960
_RELEASES = 64
_RELEASE_STEPS = 720
_SAME_POSE = np.radians(12)
_MIN_LIKELIHOOD = 0.04


def solo_model(asset: ObjectAsset) -> mujoco.MjModel:
    """The object over a fixed box whose top is at height zero."""
    spec = new_spec(StabilityConfig().timestep, ContactConfig())
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[2, 2, 0.5], pos=[0, 0, -0.5])
    add_object(spec, asset, "object")
    return spec.compile()


def settled_turn(asset: ObjectAsset) -> np.ndarray:
    """f64[3, 3]: the turn, without yaw, by which the object tilts when it is set down in its frame."""
    model = solo_model(asset)
    data = mujoco.MjData(model)
    data.qpos[:] = [0, 0, 0.0005 - _lowest(asset, np.eye(3)), 1, 0, 0, 0]
    quiet = 0
    for _ in range(_SETTLE_STEPS):
        mujoco.mj_step(model, data)
        quiet = quiet + 1 if np.linalg.norm(data.qvel[3:]) < 0.005 else 0
        if quiet == 60:
            break
    return upright_turn(rotation_matrix(data.qpos[3:7])[2])


def upright_turn(up: np.ndarray) -> np.ndarray:
    """f64[3, 3]: the smallest rotation that takes the direction `up`, f64[3], to the z axis."""
    axis = np.array([up[1], -up[0], 0.0])
    sine, cosine = np.linalg.norm(axis), up[2]
    if sine < 1e-12:
        return np.eye(3) if cosine > 0 else np.diag([1.0, -1.0, -1.0])
    quaternion = np.zeros(4)
    mujoco.mju_axisAngle2Quat(quaternion, axis / sine, np.arctan2(sine, cosine))
    return rotation_matrix(quaternion)


def tilt_of(rotation: np.ndarray) -> float:
    """Radians between the z axis and where a rotation takes it."""
    return float(np.arccos(np.clip(rotation[2, 2], -1, 1)))


def resting_poses(asset: ObjectAsset, seed: int = 0) -> tuple[RestingPose, ...]:
    """The poses in which the object comes to rest from random releases; its own frame comes first.

    Poses that differ by a turn about the vertical, or by less than 12 degrees, are one. A pose that
    fewer than one release in 25 ends in is left out. The others follow by likelihood.
    """
    ups = _random_rests(asset, seed)
    groups: list[list[np.ndarray]] = [[np.array([0.0, 0.0, 1.0])]]
    for up in ups:
        near = [group for group in groups if np.arccos(np.clip(group[0] @ up, -1, 1)) < _SAME_POSE]
        near[0].append(up) if near else groups.append([up])
    first, *others = groups
    kept = sorted((g for g in others if len(g) >= _MIN_LIKELIHOOD * _RELEASES), key=len, reverse=True)
    poses = [_pose(asset, np.eye(3), (len(first) - 1) / _RELEASES)]
    return (*poses, *(_pose(asset, upright_turn(group[0]), len(group) / _RELEASES) for group in kept))


def _random_rests(asset: ObjectAsset, seed: int) -> list[np.ndarray]:
    """World up in the object frame, f64[3], for each release that came to rest."""
    model = solo_model(asset)
    batch = Batch(model, _RELEASES, nthread=1, persistent=True)
    qpos, qvel = batch.bind("qpos"), batch.bind("qvel")
    quaternions = np.random.default_rng(seed).normal(size=(_RELEASES, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    for row, quaternion in enumerate(quaternions):
        qpos[row] = [0, 0, 0.002 - _lowest(asset, rotation_matrix(quaternion)), *quaternion]
    batch.step(nstep=_RELEASE_STEPS)
    is_still = np.isfinite(qpos).all(1) & (np.linalg.norm(qvel[:, 3:], axis=1) < 0.05)
    return [rotation_matrix(row[3:7])[2] for row in qpos[is_still & (qpos[:, 2] > 0)]]


def _pose(asset: ObjectAsset, rotation: np.ndarray, likelihood: float) -> RestingPose:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    w, x, y, z = (round(float(value), 7) + 0.0 for value in quaternion)
    return RestingPose((w, x, y, z), round(-_lowest(asset, rotation), 7), round(likelihood, 4))


def _lowest(asset: ObjectAsset, rotation: np.ndarray) -> float:
    return min(float((part.vertices @ rotation[2]).min()) for part in asset.parts)
