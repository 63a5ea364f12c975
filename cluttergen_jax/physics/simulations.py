"""A reusable batch of MuJoCo simulations: release poses, step some of them, read motions and failures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from operator import attrgetter
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from cluttergen_jax.config import Detector
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.standing import disabled_flags

_FULL = [int(mujoco.mjtWarning.mjWARN_CONTACTFULL), int(mujoco.mjtWarning.mjWARN_CNSTRFULL)]
_BAD = [
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
]

SOFT_SOLREF = (0.02, 1.0)
SOFT_SOLIMP = (0.9, 0.95, 0.001, 0.5, 2.0)
"""MuJoCo's defaults: contacts ten times as deep as `ContactConfig`'s."""

_ROOMY = 4 << 20


def sleeping_model(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy in which every object starts asleep, and a diverging scene is left to be seen, not reset."""
    model = model.__copy__()
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    model.tree_sleep_policy[:] = mujoco.mjtSleepPolicy.mjSLEEP_INIT
    return model


def damping_of(model: mujoco.MjModel, drag: float, turning_drag: float) -> np.ndarray:
    """f64[6 K]: damping of all free joints with which speeds and angular speeds decay, 1/s."""
    body = model.jnt_bodyid
    linear = drag * np.repeat(model.body_mass[body][:, None], 3, axis=1)
    return np.concatenate([linear, turning_drag * model.body_inertia[body]], axis=1).ravel()


class Motion(NamedTuple):
    """What n simulations did in T steps.

    Attributes:
      poses: f64[n, T, K, 7], of all objects after each step.
      velocities: f64[n, T, K, 6], linear in the world frame, angular in the objects' own.
      num_steps: i64[n], steps made, 1 to T: the last one is where a simulation failed, if it did. What is
        told of later ones means nothing.
      overflowed: bool[n], it failed for want of room.
      is_finite: bool[n], it did not fail by diverging.
    """

    poses: np.ndarray
    velocities: np.ndarray
    num_steps: np.ndarray
    overflowed: np.ndarray
    is_finite: np.ndarray


class Simulations:
    """A fixed number of simulations of one model, used again by every call.

    `release` resets them (`mjSTAGE_NONE`: positions, velocities, warm start and sleeping state), so that no
    call sees what an earlier one left behind.
    """

    def __init__(self, model: mujoco.MjModel, layout: Layout, size: int, num_threads: int) -> None:
        self._batch = Batch(model, size, num_threads, persistent=True)
        self._policy = self._batch.expand("tree_sleep_policy")
        self._qpos0 = self._batch.expand("qpos0")
        self._parked = layout.parked
        # A reset collides whoever sleeps, and where that finds no room it ends the process. In the arena that
        # MuJoCo sizes by itself even all objects at one point fit; in one made small by hand all start awake.
        self._starts_asleep = model.narena >= _ROOMY
        self._num_objects = layout.num_objects
        self._qpos = self._batch.bind("qpos")
        self._qvel = self._batch.bind("qvel")
        self._force = self._batch.bind("xfrc_applied")
        self._body_index = layout.body_index
        self._raised = np.zeros(size, bool)

    def release(
        self,
        poses: np.ndarray,
        is_placed: np.ndarray,
        never_sleeps: np.ndarray,
        parked: np.ndarray | None = None,
    ) -> np.ndarray:
        """Puts the first n simulations at rest: placed objects at `poses`, the others parked.

        Args:
          poses: f[n, K, 7]; is_placed, never_sleeps: bool[n, K].
          parked: f[n, K, 7], where those wait that are not placed; at their usual places if None.

        Returns:
          f64[n, K, 7], the poses as simulated, quaternions normalised.
        """
        num = len(poses)
        ids = np.arange(num)
        self._policy[:num] = np.where(
            never_sleeps,
            int(mujoco.mjtSleepPolicy.mjSLEEP_NEVER),
            int(mujoco.mjtSleepPolicy.mjSLEEP_INIT),
        )
        start = np.where(is_placed[..., None], poses, self._parked if parked is None else parked)
        start[..., 3:] /= np.linalg.norm(start[..., 3:], axis=-1, keepdims=True)
        if self._starts_asleep:
            # Reference poses, unlike writes to the state, wake nobody.
            self._qpos0[:num] = start.reshape(num, -1)
        self._batch.reset(ids, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        self._qpos[:num] = start.reshape(num, -1)
        self._raised[:num] = False
        return start

    def rouse(self, ids: np.ndarray, objects: np.ndarray, poses: np.ndarray) -> None:
        """Puts one parked object of each of some simulations at a pose, from where on it never sleeps.

        Args:
          ids, objects: i[n]; poses: f[n, 7].
        """
        self._policy[ids, objects] = int(mujoco.mjtSleepPolicy.mjSLEEP_NEVER)
        # A write to the state wakes it up.
        self._qpos.reshape(len(self._qpos), -1, 7)[ids, objects] = poses

    def planes(self, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Where geoms of the world body stand, to be written: f64[size, N, 3] and f64[size, N, 4]."""
        first = self._batch.model.geom(names[0]).id
        return tuple(
            self._batch.expand(f)[:, first : first + len(names)] for f in ("geom_pos", "geom_quat")
        )

    @contextmanager
    def _change(self, values: dict[str, Any]) -> Iterator[None]:
        """Inside, fields of all simulations have these values; after it those of the model again."""
        for name, value in values.items():
            self._batch.expand(name)[:] = value
        try:
            yield
        finally:
            for name in values:
                self._batch.expand(name)[:] = attrgetter(name)(self._batch.model)

    def lower_friction(
        self, friction: float, drag: float, turning_drag: float
    ) -> AbstractContextManager[None]:
        """Inside, friction is `friction` times as much and yields, and motion decays; then all is as it was.

        Args:
          drag, turning_drag: 1/s, by which speeds and angular speeds decay.
        """
        model = self._batch.model
        return self._change(
            {
                "geom_friction": friction * model.geom_friction,
                "dof_damping": damping_of(model, drag, turning_drag),
                "opt.noslip_iterations": 0,
            }
        )

    def no_friction(
        self, drag: float, turning_drag: float, time_share: float = 1.0
    ) -> AbstractContextManager[None]:
        """Inside, nothing has friction, and motion decays; then all is as it was.

        Args:
          drag, turning_drag: 1/s, by which speeds and angular speeds decay.
          time_share: of a step's usual time.
        """
        model = self._batch.model
        return self._change(
            {
                "geom_condim": 1,
                "dof_damping": damping_of(model, drag, turning_drag),
                "opt.noslip_iterations": 0,
                "opt.timestep": time_share * model.opt.timestep,
            }
        )

    def push(self, ids: np.ndarray, acceleration: np.ndarray, lever: np.ndarray) -> None:
        """From now on a force acts on each object of the simulations `ids`, above its centre of mass.

        Args:
          acceleration: f[n, K, 3], m/s^2 that it gives an object alone, in the world frame.
          lever: f[n, K], metres above the centre of mass at which it acts.
        """
        force = acceleration * self._batch.model.body_mass[self._body_index, None]
        torque = lever[..., None] * np.stack(
            [-force[..., 1], force[..., 0], np.zeros_like(lever)], axis=-1
        )
        self._force[ids[:, None], self._body_index] = np.concatenate([force, torque], axis=-1)

    def loosen_contacts(self, friction: float) -> AbstractContextManager[None]:
        """Inside, friction is `friction` times as much, contacts are as soft as MuJoCo's default."""
        model = self._batch.model
        return self._change(
            {
                "geom_friction": friction * model.geom_friction,
                "geom_solref": SOFT_SOLREF,
                "geom_solimp": SOFT_SOLIMP,
                "opt.gravity": model.opt.gravity,
            }
        )

    def turn_gravity(self, direction: np.ndarray) -> None:
        """From now on gravity, as strong as the model's, points along the unit vector `direction`, f[3]."""
        strength = np.linalg.norm(self._batch.model.opt.gravity)
        self._batch.expand("opt.gravity")[:] = strength * direction

    def choose_detector(self, detector: Detector, margin: float = 0.0) -> None:
        """From now on convex collisions are found by this detector, from a distance of `margin` metres on."""
        self._batch.expand("opt.disableflags")[:] = disabled_flags(self._batch.model, detector)
        self._batch.expand("geom_margin")[:] = margin

    @contextmanager
    def detected_by(self, detector: Detector, margin: float) -> Iterator[None]:
        """Inside, convex collisions are found by this detector; after it by the native one again."""
        self.choose_detector(detector, margin)
        try:
            yield
        finally:
            self.choose_detector("native")

    def step(self, ids: np.ndarray) -> None:
        """One time step of the simulations `ids`; one that raises is marked, the others go on."""
        try:
            self._batch.step(ids)
        except SimulationError as error:
            self._raised[error.ids] = True

    def advance(self, ids: np.ndarray, num_steps: int) -> None:
        """Several time steps of the simulations `ids`, nothing recorded; one that fails makes no more."""
        try:
            self._batch.rollout(num_steps, record=(), ids=ids)
        except SimulationError as error:
            self._raised[error.ids] = True

    def run(self, ids: np.ndarray, num_steps: int) -> Motion:
        """Several time steps of the simulations `ids` at once, each step recorded.

        A thread keeps one simulation in its cache for all of its steps, and is called once: half the cost of
        as many calls of `step`.
        """
        num = len(ids)
        num_objects = self._num_objects
        # What is not recorded, because a step raised an error, stays NaN.
        qpos = np.full((num, num_steps, 7 * num_objects), np.nan)
        qvel = np.full((num, num_steps, 6 * num_objects), np.nan)
        try:
            self._batch.rollout(
                num_steps, record=("qpos", "qvel"), ids=ids, out={"qpos": qpos, "qvel": qvel}
            )
        except SimulationError as error:
            self._raised[error.ids] = True
        warned = self._batch.warning[ids, :, 1]
        raised = self._raised[ids]
        overflowed = warned[:, _FULL].any(1) | raised
        diverged = warned[:, _BAD].any(1)
        is_finite = np.isfinite(qpos).all(-1) & np.isfinite(qvel).all(-1) | raised[:, None]
        made = np.where(is_finite.all(1), num_steps, is_finite.argmin(1) + 1)
        for row in np.flatnonzero(overflowed | diverged):
            made[row] = min(made[row], _first_like_last(qpos[row], qvel[row]) + 1)
        last = np.arange(num), made - 1
        qpos[last] = np.where(raised[:, None], self._qpos[ids], qpos[last])
        return Motion(
            poses=qpos.reshape(num, num_steps, num_objects, 7),
            velocities=qvel.reshape(num, num_steps, num_objects, 6),
            num_steps=made,
            overflowed=overflowed,
            is_finite=is_finite[last] & ~diverged,
        )

    def failures(self, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the simulations `ids`: which ran out of room, and which are still finite; bool[n] each."""
        warning = self._batch.warning[ids, :, 1]
        overflowed = warning[:, _FULL].any(1) | self._raised[ids]
        finite = np.isfinite(self._qpos[ids]).all(1) & np.isfinite(self._qvel[ids]).all(1)
        return overflowed, finite & ~warning[:, _BAD].any(1)

    def poses(self, ids: np.ndarray) -> np.ndarray:
        """f64[n, K, 7]: where all objects are now."""
        return self._qpos[ids].reshape(len(ids), self._num_objects, 7)


def _first_like_last(*records: np.ndarray) -> int:
    """The first of f64[T, ...] that all later ones repeat: a simulation that warns makes no further step."""
    rows = np.concatenate(records, axis=1)
    differs = ((rows != rows[-1]) & ~(np.isnan(rows) & np.isnan(rows[-1]))).any(1)
    return int(np.flatnonzero(differs)[-1]) + 1 if differs.any() else 0
