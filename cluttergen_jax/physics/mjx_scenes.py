"""A batch of MJX simulations of one model: release, step, read motions, contacts and failures.

MJX has no sleeping. Objects that are not placed are put back where they are parked after every step, which is
as good as weightless, and so are the scenes that are decided: they stay where they were when they were.
"""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct
from mujoco import mjx
from mujoco.mjx import warp as mjx_warp

from cluttergen_jax.errors import ConfigError, MissingExtraError
from cluttergen_jax.geometry import norm, rotate
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.log import silent_log
from cluttergen_jax.physics.margin import MIN_LIFT
from cluttergen_jax.physics.mjx_faces import faces_first
from cluttergen_jax.physics.mjx_margin import support_margins
from cluttergen_jax.types import Array

IMPLEMENTATIONS = ("warp", "jax")
_FIRMEST = (0.9, 0.95)
_MAX_STATE = 1e10
"""MuJoCo's own limit (mjMAXVAL): what is larger counts as diverged, in every engine."""

# Bits of mujoco_warp's OverflowType that mean that contacts or constraints were lost: nefc, njmax_nnz,
# broadphase, narrowphase, CCD, nvmax, EPA horizon. The others tell of iteration limits and sensors.
_LOST = 0b11 | 1 << 2 | 1 << 3 | 1 << 4 | 1 << 7 | 1 << 8


class ContactRows(struct.PyTreeNode):
    """All contacts of a batch as one list.

    Attributes:
      scene: i32[C]; geom: i32[C, 2]; depth: f32[C], overlap in metres, zero for a free place in the list.
      position: f32[C, 3], world, metres; lift: f32[C], vertical part of the unit normal, which points from
        the first geom to the second.
    """

    scene: Array
    geom: Array
    depth: Array
    position: Array
    lift: Array


class MjxScenes:
    """The model on the device, and what can be done with a batch of its simulations.

    Args:
      layout: the compiled world.
      impl: "warp" or "jax".
      num_contacts, num_rows: room for contacts and constraint rows of a scene (Warp); None measures it.

    Raises:
      ConfigError: unknown `impl`.
      MissingExtraError: Warp is not installed.
    """

    def __init__(
        self, layout: Layout, impl: str, num_contacts: int | None = None, num_rows: int | None = None
    ) -> None:
        if impl not in IMPLEMENTATIONS:
            raise ConfigError(f"impl = {impl!r}", " or ".join(IMPLEMENTATIONS))
        self._layout, self._is_warp = layout, impl == "warp"
        if not self._is_warp:
            model = layout.model.__copy__()
            # MJX's Newton solver, in float32, throws a box on the table upwards at 7 m/s in one drop of ten
            # if contacts are firmer; softer by a few micrometres they are solved.
            model.geom_solimp[:, :2] = np.minimum(model.geom_solimp[:, :2], _FIRMEST)
            self._model, self._blank = mjx.put_model(model, impl="jax"), mjx.make_data(model, impl="jax")
            return
        if not mjx_warp.WARP_INSTALLED:
            raise MissingExtraError("gpu", "the Warp engine")
        contacts, rows = (num_contacts, num_rows) if num_contacts and num_rows else room_for(layout)
        self._num_contacts, num_rows = num_contacts or contacts, num_rows or rows
        # Warp need not print what is read from `overflow` after every step.
        self._model = mjx.put_model(layout.model, impl="warp").tree_replace({"opt._impl.warn_overflow": 0})
        self._blank = mjx.make_data(layout.model, impl="warp", naconmax=self._num_contacts, njmax=num_rows)

    def release(self, start: Array) -> mjx.Data:
        """Simulations at rest at `start`, f32[N, K, 7]."""
        blank = self._blank if not self._is_warp else self._with_room(len(start))
        return jax.vmap(lambda qpos: blank.replace(qpos=qpos))(start.reshape(len(start), -1))

    def _with_room(self, num_scenes: int) -> mjx.Data:
        """Warp's blank data with the contact list, which all scenes share, lengthened for them."""
        size = num_scenes * self._num_contacts
        changes: dict[str, Any] = {"_impl.naconmax": size, "_impl.naccdmax": size}
        for name, array in vars(self._blank._impl).items():
            if name.startswith("contact__") and array.shape[0] == self._num_contacts:
                changes[f"_impl.{name}"] = jnp.zeros((size, *array.shape[1:]), array.dtype)
        return self._blank.tree_replace(changes)

    def step(self, data: mjx.Data, may_move: Array) -> mjx.Data:
        """One time step for the objects that may move, bool[N, K]; the others stay, at rest."""
        if self._is_warp:
            data = data.tree_replace({"_impl.overflow": jnp.zeros_like(data._impl.overflow)})
        with nullcontext() if self._is_warp else faces_first():
            after = jax.vmap(mjx.step, in_axes=(None, 0))(self._model, data)
        # The warm start of those that stay is left as it is, and is right for the next step: with zeros there
        # the solver would find it worse than a cold start and throw away that of the others too.
        return after.replace(
            qpos=jnp.where(jnp.repeat(may_move, 7, axis=1), after.qpos, data.qpos),
            qvel=jnp.where(jnp.repeat(may_move, 6, axis=1), after.qvel, 0.0),
        )

    def halted(self, data: mjx.Data, is_finite: Array, start: Array) -> mjx.Data:
        """The scenes that are not finite, bool[N], put back to `start`, f32[N, K, 7], at rest."""
        keep = is_finite[:, None]
        return data.replace(
            qpos=jnp.where(keep, data.qpos, start.reshape(data.qpos.shape)),
            qvel=jnp.where(keep, data.qvel, 0.0),
            qacc_warmstart=jnp.where(keep, data.qacc_warmstart, 0.0),
        )

    def poses(self, data: mjx.Data) -> Array:
        """f32[N, K, 7]: where all objects are."""
        return data.qpos.reshape(-1, self._layout.num_objects, 7)

    def velocity(self, data: mjx.Data, focus: Array) -> Array:
        """f32[N, 6]: linear and angular velocity of one object each, at its origin, world frame."""
        rows = jnp.arange(len(focus))
        velocity = data.qvel.reshape(-1, self._layout.num_objects, 6)[rows, focus]
        angular = rotate(jnp, self.poses(data)[rows, focus, 3:], velocity[:, 3:])
        return jnp.concatenate([velocity[:, :3], angular], axis=-1)

    def is_finite(self, data: mjx.Data) -> Array:
        """bool[N]: the scene has not diverged."""
        size = jnp.maximum(jnp.abs(data.qpos).max(axis=1), jnp.abs(data.qvel).max(axis=1))
        return size < _MAX_STATE

    def overflowed(self, data: mjx.Data) -> Array:
        """bool[N]: the last step lost contacts or constraints. A full contact list concerns all scenes."""
        if not self._is_warp:
            return jnp.zeros(len(data.qpos), bool)
        return (data._impl.overflow & _LOST) != 0

    def contacts(self, data: mjx.Data) -> ContactRows:
        """The contacts at the poses from which the last step started."""
        impl = data._impl
        if self._is_warp:
            is_used = jnp.arange(impl.naconmax) < impl.nacon[0]
            depth = jnp.where(is_used, -impl.contact__dist, 0.0)
            return ContactRows(
                scene=impl.contact__worldid,
                geom=impl.contact__geom,
                depth=jnp.maximum(depth, 0.0),
                position=impl.contact__pos,
                lift=impl.contact__frame[:, 0, 2],
            )
        num_scenes, num_contacts = impl.contact.dist.shape
        return ContactRows(
            scene=jnp.repeat(jnp.arange(num_scenes), num_contacts),
            geom=impl.contact.geom.reshape(-1, 2),
            depth=jnp.maximum(-impl.contact.dist, 0.0).ravel(),
            position=impl.contact.pos.reshape(-1, 3),
            lift=impl.contact.frame[..., 0, 2].ravel(),
        )

    def depths(self, data: mjx.Data) -> Array:
        """f32[N, K + 1, K + 1]: overlap of every pair at the start of the last step, K for the support."""
        contacts, size = self.contacts(data), self._layout.num_objects + 1
        pair = jnp.asarray(self._layout.geom_object)[contacts.geom]
        depths = jnp.zeros((len(data.qpos), size, size))
        depths = depths.at[contacts.scene, pair[:, 0], pair[:, 1]].max(contacts.depth, mode="drop")
        return jnp.maximum(depths, depths.swapaxes(1, 2))

    def bearers(self, data: mjx.Data, focus: Array) -> Array:
        """bool[N, K]: who presses each scene's focus object upwards at the start of the last step.

        Args:
          focus: i32[N].
        """
        contacts, num_objects = self.contacts(data), self._layout.num_objects
        pair = jnp.asarray(self._layout.geom_object)[contacts.geom]
        is_up = contacts.lift > 0
        carried, carrier = (jnp.where(is_up, pair[:, i], pair[:, 1 - i]) for i in (1, 0))
        presses = (contacts.depth > 0) & (jnp.abs(contacts.lift) >= MIN_LIFT)
        presses &= carried == focus[jnp.minimum(contacts.scene, len(focus) - 1)]
        bears = jnp.zeros((len(focus), num_objects + 1), bool)
        return bears.at[contacts.scene, carrier].max(presses, mode="drop")[:, :-1]

    def margins(self, data: mjx.Data, poses: Array) -> Array:
        """f32[N, K]: every object's support margin, metres, at the poses from which the last step started.

        Args:
          poses: f32[N, K, 7], those poses.
        """
        contacts, num_objects = self.contacts(data), self._layout.num_objects
        pair = jnp.asarray(self._layout.geom_object)[contacts.geom]
        carried = jnp.where(contacts.lift > 0, pair[:, 1], pair[:, 0])
        carries = (contacts.depth > 0) & (jnp.abs(contacts.lift) >= MIN_LIFT) & (carried < num_objects)
        body = jnp.where(carries, contacts.scene * num_objects + carried, len(poses) * num_objects)
        center = rotate(jnp, poses[..., 3:], jnp.asarray(self._layout.center_of_mass, jnp.float32))
        plan = (poses[..., :3] + center)[..., :2].reshape(-1, 2)
        margins = support_margins(contacts.position[:, :2], body, plan)
        return margins.reshape(len(poses), num_objects)


def start_poses(layout: Layout, poses: Array, is_placed: Array, is_active: Array) -> tuple[Array, Array]:
    """The poses to simulate, f32[N, K, 7], unit quaternions, unplaced objects parked; and bool[N], is sound.

    Scenes that are inactive or have a pose that is not finite are parked whole.
    """
    length = norm(jnp, poses[..., 3:])
    is_sound = jnp.isfinite(poses).all(axis=-1) & (length > 1e-3) & (jnp.abs(poses) < _MAX_STATE).all(axis=-1)
    is_scene_sound = (is_sound | ~is_placed).all(axis=-1)
    is_used = (is_placed & (is_active & is_scene_sound)[:, None])[..., None]
    unit = poses.at[..., 3:].divide(jnp.where(is_sound, length, 1.0)[..., None])
    return jnp.where(is_used, unit, jnp.asarray(layout.parked, jnp.float32)), is_scene_sound


_ROOM_MARGIN = 2.0
_LEAST_CONTACTS = 32


def room_for(layout: Layout, num_scenes: int = 8, num_steps: int = 60) -> tuple[int, int]:
    """ContactRows and constraint rows that one scene may need at most, with a margin of two.

    All objects are dropped at once, close together, and the most that MuJoCo ever counts is taken.
    """
    rng = np.random.default_rng(0)
    most_contacts, most_rows = _LEAST_CONTACTS / _ROOM_MARGIN, 0.0
    with silent_log():
        for _ in range(num_scenes):
            data = mujoco.MjData(layout.model)
            data.qpos[:] = _crowd(layout, rng).ravel()
            for _ in range(num_steps):
                mujoco.mj_step(layout.model, data)
                most_contacts, most_rows = max(most_contacts, data.ncon), max(most_rows, data.nefc)
    # A contact has at most six rows (pyramidal, condim 4), should the engines count contacts differently.
    return int(_ROOM_MARGIN * most_contacts), int(_ROOM_MARGIN * max(most_rows, 6 * most_contacts))


def _crowd(layout: Layout, rng: np.random.Generator) -> np.ndarray:
    """f64[K, 7]: upright objects, any yaw, in a heap over the middle of the support."""
    model, num_objects = layout.model, layout.num_objects
    support = layout.geom_object == num_objects
    center = model.geom_pos[support, :2].mean(0)
    reach = np.zeros(num_objects)
    np.maximum.at(
        reach,
        layout.geom_object[~support],
        model.geom_rbound[~support] + np.linalg.norm(model.geom_pos[~support], axis=1),
    )
    spread = np.sqrt(num_objects) * reach.mean()
    yaw = rng.uniform(0, np.pi, num_objects)
    poses = np.zeros((num_objects, 7))
    poses[:, :2] = center + rng.uniform(-spread, spread, (num_objects, 2)) / 2
    poses[:, 2] = layout.top + reach * rng.uniform(0.5, 1.5, num_objects)
    poses[:, 3], poses[:, 6] = np.cos(yaw), np.sin(yaw)
    return poses
