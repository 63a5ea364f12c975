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
# What turned by less within so many steps and moves slower, in m/s and rad/s, lies still.
_BLOCK_STEPS = 60
_STILL = 0.001


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
    sine = np.linalg.norm(axis)
    cosine = up[2]
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
    releases = _Releases(asset, seed)
    groups: list[tuple[np.ndarray, list[int]]] = [(np.array([0.0, 0.0, 1.0]), [])]
    for row in releases.at_rest():
        up = releases.up(row)
        near = [
            rows for first, rows in groups if np.arccos(np.clip(first @ up, -1, 1)) < _SAME_POSE
        ]
        near[0].append(row) if near else groups.append((up, [row]))
    own, *others = (rows for _, rows in groups)
    kept = [rows for rows in others if len(rows) >= _MIN_LIKELIHOOD * _RELEASES]
    kept.sort(key=len, reverse=True)
    releases.finish([rows[0] for rows in kept])
    turns = [np.eye(3), *(upright_turn(releases.up(rows[0])) for rows in kept)]
    shares = [len(rows) / _RELEASES for rows in (own, *kept)]
    return tuple(_pose(asset, *each) for each in zip(turns, shares, strict=True))


class _Releases:
    """The object let go just above the table in random orientations, each a simulation for itself.

    What lies still is not simulated on, until that is asked for.
    """

    def __init__(self, asset: ObjectAsset, seed: int) -> None:
        self._batch = Batch(solo_model(asset), _RELEASES, nthread=1)
        self._qpos = self._batch.bind("qpos")
        self._qvel = self._batch.bind("qvel")
        self._num_steps = np.zeros(_RELEASES, int)
        quaternions = np.random.default_rng(seed).normal(size=(_RELEASES, 4))
        quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
        for row, quaternion in enumerate(quaternions):
            self._qpos[row] = [
                0,
                0,
                0.002 - _lowest(asset, rotation_matrix(quaternion)),
                *quaternion,
            ]

    def up(self, row: int) -> np.ndarray:
        """f64[3]: the world's up in the object's frame."""
        return rotation_matrix(self._qpos[row, 3:7])[2]

    def at_rest(self) -> list[int]:
        """The releases that come to rest."""
        running = np.arange(_RELEASES)
        while running.size and self._num_steps[running[0]] < _RELEASE_STEPS:
            before = self._qpos[running]
            self._step(running, _BLOCK_STEPS)
            is_still = (np.abs(self._qvel[running]) < _STILL).all(1)
            is_still &= (np.abs(self._qpos[running, 3:] - before[:, 3:]) < _STILL).all(1)
            running = running[~is_still]
        is_sound = np.isfinite(self._qpos).all(1) & (self._qpos[:, 2] > 0)
        return np.flatnonzero(
            is_sound & (np.linalg.norm(self._qvel[:, 3:], axis=1) < 0.05)
        ).tolist()

    def finish(self, rows: list[int]) -> None:
        """Simulates some to the end, after which what it creeps is told by its pose as well."""
        for row in rows:
            self._step(np.array([row]), _RELEASE_STEPS - int(self._num_steps[row]))

    def _step(self, rows: np.ndarray, number: int) -> None:
        if number:
            self._batch.step(rows, nstep=number)
            self._num_steps[rows] += number


def _pose(asset: ObjectAsset, rotation: np.ndarray, likelihood: float) -> RestingPose:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    w, x, y, z = (round(float(value), 7) + 0.0 for value in quaternion)
    return RestingPose((w, x, y, z), round(-_lowest(asset, rotation), 7), round(likelihood, 4))


def _lowest(asset: ObjectAsset, rotation: np.ndarray) -> float:
    return min(float((part.vertices @ rotation[2]).min()) for part in asset.parts)
