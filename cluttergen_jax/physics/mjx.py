"""The MJX engines: MuJoCo in JAX, on Warp kernels or in pure XLA.

One `while_loop` steps the whole batch until every scene is decided; a decided scene is carried along unmoved.
With Warp, large batches are compacted: once few scenes are left to be decided, those alone are stepped on.
Objects that are not placed, and those of decided scenes, are put back after every step, which is as good as
weightless. Overlaps at release and at rest, support margins and who bears whom are read in one pass over the
contacts of both moments, once the loop has ended.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from typing import TypeVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct
from mujoco import mjx
from mujoco.mjx import warp as mjx_warp

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.errors import ConfigError, MissingExtraError
from cluttergen_jax.geometry import norm, rotate
from cluttergen_jax.physics import stability
from cluttergen_jax.physics.host import (
    SUMS,
    OneScenePhysics,
    below_top,
    empty_settling,
    empty_standing,
    mask_scenes,
    one_scene,
    where,
)
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.log import silent_log
from cluttergen_jax.physics.margin import MIN_LIFT, MIN_SHIFT
from cluttergen_jax.physics.mjx_pairs import ConvexPairs, faces_first, soften_contacts
from cluttergen_jax.physics.standing import displacement
from cluttergen_jax.types import Array, Settling, Standing, Verdict

IMPLEMENTATIONS = ("warp", "jax")
_MAX_STATE = 1e10
"""MuJoCo's own limit (mjMAXVAL): what is larger counts as diverged, in every engine."""

# Bits of mujoco_warp's OverflowType that mean that contacts or constraints were lost: nefc, njmax_nnz,
# broadphase, narrowphase, CCD, nvmax, EPA horizon. The others tell of iteration limits and sensors.
_LOST = 0b11 | 1 << 2 | 1 << 3 | 1 << 4 | 1 << 7 | 1 << 8
_FEW = 3
"""A part of so many is few."""


@dataclass(frozen=True)
class WarpOptions:
    """How Warp simulates; but for too little room nothing of it changes a result, up to rounding.

    Attributes:
      num_contacts, num_rows: room for contacts and constraint rows of a scene; None measures the need.
      least_batch: once a third of a batch is left to be decided it is stepped on by itself, unless that
        would be fewer scenes than this; 0 never does so.
    """

    num_contacts: int | None = None
    num_rows: int | None = None
    least_batch: int = 64


WARP_DEFAULTS = WarpOptions()


class ContactRows(struct.PyTreeNode):
    """All contacts of a batch as one list. Functions of N scenes pass over those of scenes from N on.

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
      options: of Warp.

    Raises:
      ConfigError: unknown `impl`.
      MissingExtraError: Warp is not installed.
    """

    def __init__(self, layout: Layout, impl: str, options: WarpOptions = WARP_DEFAULTS) -> None:
        if impl not in IMPLEMENTATIONS:
            raise ConfigError(f"impl = {impl!r}", " or ".join(IMPLEMENTATIONS))
        self._layout = layout
        self._is_warp = impl == "warp"
        self._options = options if self._is_warp else WARP_DEFAULTS
        if not self._is_warp:
            model = soften_contacts(layout.model)
            self._model = mjx.put_model(model, impl="jax")
            self._pairs = ConvexPairs(model, self._model, layout.num_objects)
            with self._pairs.replacing_mjx():
                self._blank = mjx.make_data(model, impl="jax")
            return
        if not mjx_warp.WARP_INSTALLED:
            raise MissingExtraError("gpu", "the Warp engine")
        contacts = options.num_contacts
        rows = options.num_rows
        if contacts is None or rows is None:
            measured = room_for(layout)
            contacts = contacts or measured[0]
            rows = rows or measured[1]
        self._num_contacts = contacts
        # What is read from `overflow` after every step need not be printed.
        quiet = {"opt._impl.warn_overflow": 0}
        self._model = mjx.put_model(layout.model, impl="warp").tree_replace(quiet)
        self._blank = mjx.make_data(layout.model, impl="warp", naconmax=contacts, njmax=rows)

    def few_of(self, num_scenes: int) -> int:
        """How many of a batch's scenes are few enough to go on by themselves; 0 where none are."""
        least = self._options.least_batch
        few = num_scenes // _FEW if least and self._is_warp else 0
        return few if few >= least else 0

    def take_scenes(self, data: mjx.Data, index: Array) -> mjx.Data:
        """The scenes `index`, i32[M], of Warp's data by themselves; beyond the last, the last."""

        def of(array: Array) -> Array:
            return array.at[index].get(mode="clip")

        impl = data._impl
        return self.start_at(of(self.poses(data))).tree_replace(
            {
                "qvel": of(data.qvel),
                "qacc_warmstart": of(data.qacc_warmstart),
                "_impl.tree_asleep": of(impl.tree_asleep),
                "_impl.tree_awake": of(impl.tree_awake),
            }
        )

    def start_at(self, start: Array) -> mjx.Data:
        """Simulations at rest at `start`, f32[N, K, 7]."""
        blank = self._with_room(len(start)) if self._is_warp else self._blank
        return jax.vmap(lambda qpos: blank.replace(qpos=qpos))(start.reshape(len(start), -1))

    def _with_room(self, num_scenes: int) -> mjx.Data:
        """Warp's blank data with the contact list, which all scenes share, lengthened for them."""
        blank = self._blank
        size = num_scenes * self._num_contacts
        changes: dict[str, Array] = {"_impl.naconmax": size, "_impl.naccdmax": size}
        for name, array in vars(blank._impl).items():
            if name.startswith("contact__") and array.shape[0] == self._num_contacts:
                changes[f"_impl.{name}"] = jnp.zeros((size, *array.shape[1:]), array.dtype)
        return blank.tree_replace(changes)

    def step(self, data: mjx.Data, may_move: Array) -> mjx.Data:
        """One time step of the objects `may_move`, bool[N, K]; the others stay, at rest."""
        if self._is_warp:
            data = data.tree_replace({"_impl.overflow": jnp.zeros_like(data._impl.overflow)})
        with nullcontext() if self._is_warp else self._pairs.replacing_mjx():
            after = jax.vmap(mjx.step, in_axes=(None, 0))(self._model, data)
        # The warm start of those that stay is left as it is, and is right for the next step: with zeros there
        # the solver would find it worse than a cold start and throw away that of the others too.
        return after.replace(
            qpos=jnp.where(jnp.repeat(may_move, 7, axis=1), after.qpos, data.qpos),
            qvel=jnp.where(jnp.repeat(may_move, 6, axis=1), after.qvel, 0.0),
        )

    def halt_diverged(self, data: mjx.Data, is_finite: Array, start: Array) -> mjx.Data:
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

    def has_overflowed(self, data: mjx.Data) -> Array:
        """bool[N]: the last step lost contacts or constraints. A full contact list concerns all scenes."""
        if not self._is_warp:
            return jax.vmap(self._pairs.has_overflowed, in_axes=(None, 0))(self._model, data)
        return (data._impl.overflow & _LOST) != 0

    def contacts(self, poses: Array) -> tuple[ContactRows, Array]:
        """The contacts of scenes at poses f32[N, K, 7], everything awake, nothing moving.

        Returns:
          The contacts, and bool: some were lost, nobody knows of which scene.
        """
        if not self._is_warp:
            return self._contacts_in_jax(poses), jnp.asarray(False)
        # MJX dispatches all but this function to Warp by itself, and it can be imported with Warp alone.
        from mujoco.mjx.warp.collision_driver import collision

        data = self.start_at(poses)
        for stage in (mjx.kinematics, collision):
            data = jax.vmap(stage, in_axes=(None, 0))(self._model, data)
        impl = data._impl
        is_used = jnp.arange(impl.naconmax) < impl.nacon[0]
        depth = jnp.where(is_used, jnp.maximum(-impl.contact__dist, 0.0), 0.0)
        contacts = ContactRows(
            scene=impl.contact__worldid,
            geom=impl.contact__geom,
            depth=depth,
            position=impl.contact__pos,
            lift=impl.contact__frame[:, 0, 2],
        )
        return contacts, jnp.maximum(impl.nacon[0], impl.ncollision[0]) > impl.naconmax

    def _contacts_in_jax(self, poses: Array) -> ContactRows:
        data = self.start_at(poses)
        with faces_first():
            for stage in (mjx.kinematics, self._pairs.find_contacts):
                data = jax.vmap(stage, in_axes=(None, 0))(self._model, data)
        contact = data._impl.contact
        num_scenes, num_contacts = contact.dist.shape
        return ContactRows(
            scene=jnp.repeat(jnp.arange(num_scenes), num_contacts),
            geom=contact.geom.reshape(-1, 2),
            depth=jnp.maximum(-contact.dist, 0.0).ravel(),
            position=contact.pos.reshape(-1, 3),
            lift=contact.frame[..., 0, 2].ravel(),
        )


def start_poses(
    layout: Layout, poses: Array, is_placed: Array, is_active: Array
) -> tuple[Array, Array]:
    """The poses to simulate, f32[N, K, 7], unit quaternions, unplaced objects parked; and bool[N], is sound.

    Scenes that are inactive or have a pose that is not finite are parked whole.
    """
    length = norm(jnp, poses[..., 3:])
    is_small = (jnp.abs(poses) < _MAX_STATE).all(axis=-1)
    is_sound = jnp.isfinite(poses).all(axis=-1) & (length > 1e-3) & is_small
    is_scene_sound = (is_sound | ~is_placed).all(axis=-1)
    is_used = (is_placed & (is_active & is_scene_sound)[:, None])[..., None]
    unit = poses.at[..., 3:].divide(jnp.where(is_sound, length, 1.0)[..., None])
    return jnp.where(is_used, unit, jnp.asarray(layout.parked, jnp.float32)), is_scene_sound


_ROOM_MARGIN = 2.0
_LEAST_CONTACTS = 32


def room_for(layout: Layout, num_scenes: int = 8, num_steps: int = 60) -> tuple[int, int]:
    """Contacts and constraint rows that one scene may need at most, with a margin of two.

    All objects are dropped at once, close together, and the most that MuJoCo ever counts is taken.
    """
    rng = np.random.default_rng(0)
    most_contacts = _LEAST_CONTACTS / _ROOM_MARGIN
    most_rows = 0.0
    with silent_log():
        for _ in range(num_scenes):
            data = mujoco.MjData(layout.model)
            data.qpos[:] = _crowd(layout, rng).ravel()
            for _ in range(num_steps):
                mujoco.mj_step(layout.model, data)
                most_contacts = max(most_contacts, data.ncon)
                most_rows = max(most_rows, data.nefc)
    # A contact has at most six rows (pyramidal, condim 4), should the engines count contacts differently.
    return int(_ROOM_MARGIN * most_contacts), int(_ROOM_MARGIN * max(most_rows, 6 * most_contacts))


def _crowd(layout: Layout, rng: np.random.Generator) -> np.ndarray:
    """f64[K, 7]: upright objects, any yaw, in a heap over the middle of the support."""
    model = layout.model
    num_objects = layout.num_objects
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
    poses[:, 3] = np.cos(yaw)
    poses[:, 6] = np.sin(yaw)
    return poses


# What contacts tell: overlaps, who bears whom, support margins.


def overlaps(contacts: ContactRows, layout: Layout, num_scenes: int) -> Array:
    """f32[N, K + 1, K + 1]: overlap of every pair, metres, index K for the support."""
    size = layout.num_objects + 1
    pair = jnp.asarray(layout.geom_object)[contacts.geom]
    depths = jnp.zeros((num_scenes, size, size))
    depths = depths.at[contacts.scene, pair[:, 0], pair[:, 1]].max(contacts.depth, mode="drop")
    return jnp.maximum(depths, depths.swapaxes(1, 2))


def bearers(contacts: ContactRows, layout: Layout, focus: Array) -> Array:
    """bool[N, K]: who presses each scene's focus object, i32[N], upwards."""
    carried, carrier = _carried_and_carrier(contacts, layout)
    num_objects = layout.num_objects
    num_scenes = len(focus)
    presses = _presses(contacts) & (carried == focus[jnp.minimum(contacts.scene, num_scenes - 1)])
    bears = jnp.zeros((num_scenes, num_objects + 1), bool)
    return bears.at[contacts.scene, carrier].max(presses, mode="drop")[:, :-1]


def margins(contacts: ContactRows, layout: Layout, poses: Array) -> Array:
    """f32[N, K]: every object's support margin, metres.

    Args:
      poses: f32[N, K, 7], those at which the contacts were found.
    """
    num_scenes, num_objects = poses.shape[:2]
    carried, _ = _carried_and_carrier(contacts, layout)
    carries = _presses(contacts) & (carried < num_objects) & (contacts.scene < num_scenes)
    body = jnp.where(carries, contacts.scene * num_objects + carried, num_scenes * num_objects)
    center = rotate(jnp, poses[..., 3:], jnp.asarray(layout.center_of_mass, jnp.float32))
    plan = (poses[..., :3] + center)[..., :2].reshape(-1, 2)
    found = support_margins(contacts.position[:, :2], body, plan)
    return found.reshape(num_scenes, num_objects)


def _carried_and_carrier(contacts: ContactRows, layout: Layout) -> tuple[Array, Array]:
    """Objects i32[C] each: who is pressed upwards by the contact, and by whom; K for the support."""
    pair = jnp.asarray(layout.geom_object)[contacts.geom]
    is_up = contacts.lift > 0
    return jnp.where(is_up, pair[:, 1], pair[:, 0]), jnp.where(is_up, pair[:, 0], pair[:, 1])


def _presses(contacts: ContactRows) -> Array:
    """bool[C]: the contact carries, and does not merely touch a side."""
    return (contacts.depth > 0) & (jnp.abs(contacts.lift) >= MIN_LIFT)


MAX_POINTS = 64
"""Contacts of a body that are looked at. More are left out, which makes its support smaller, never larger."""

_BLOCK = 1024
_SAME_POINT = 1e-7
_FIRST, _SECOND = np.triu_indices(MAX_POINTS, 1)


def support_margins(position: Array, body: Array, center: Array) -> Array:
    """The signed distance of each body's centre of mass to the edge of its contacts' convex hull, in plan.

    Args:
      position: f32[C, 2], metres, contacts of all bodies in any order.
      body: i32[C], whom each carries; B or more for one that carries nobody.
      center: f32[B, 2], metres, centres of mass.

    Returns:
      f32[B], metres: positive within, negative outside; -inf for what nothing carries.
    """
    order = jnp.argsort(body)
    body = body[order]
    rank = jnp.arange(len(body)) - jnp.searchsorted(body, body)
    # The last row takes what carries nobody; a rank beyond the last column is dropped.
    row = jnp.minimum(body, len(center))
    shape = (len(center) + 1, MAX_POINTS)
    points = jnp.zeros((*shape, 2)).at[row, rank].set(position[order], mode="drop")[:-1]
    is_there = jnp.zeros(shape, bool).at[row, rank].set(True, mode="drop")[:-1]
    points = jnp.where(is_there[..., None], points - center[:, None], 0.0)
    return jax.lax.map(lambda each: support_margin(*each), (points, is_there), batch_size=_BLOCK)


def support_margin(points: Array, is_there: Array) -> Array:
    """`margin.support_margin` of the points f32[64, 2] that are there, bool[64].

    The distance is the least value, over all unit directions d, of the largest d.p. It is taken at a normal
    of one of the hull's sides or, where the origin is outside, towards it from a corner: those of all pairs
    of points and of all points are tried.
    """
    side = points[_SECOND] - points[_FIRST]
    length = norm(jnp, side)
    is_side = is_there[_FIRST] & is_there[_SECOND] & (length > _SAME_POINT)
    side = side / jnp.where(is_side, length, 1.0)[:, None]
    lowest, highest = _extent(jnp.stack([-side[:, 1], side[:, 0]], axis=-1), points, is_there)
    by_side = jnp.where(is_side, jnp.minimum(highest, -lowest), jnp.inf)
    distance = norm(jnp, points)
    inwards = -points / jnp.where(distance > 0, distance, 1.0)[:, None]
    by_corner = jnp.where(is_there, _extent(inwards, points, is_there)[1], jnp.inf)
    least = jnp.minimum(by_side.min(), by_corner.min())
    return jnp.where(is_there.any(), least, -jnp.inf)


def _extent(direction: Array, points: Array, is_there: Array) -> tuple[Array, Array]:
    """The least and the largest d.p over the points, for each of the directions f32[D, 2]: f32[D] each."""
    along = direction[:, None, 0] * points[:, 0] + direction[:, None, 1] * points[:, 1]
    return (
        jnp.where(is_there, along, jnp.inf).min(axis=1),
        jnp.where(is_there, along, -jnp.inf).max(axis=1),
    )


class _Batch(struct.PyTreeNode):
    """The scenes of a batch, as they began.

    Attributes:
      start: f32[N, K, 7], world frame; is_placed, is_focus: bool[N, K].
      is_judged: bool[N], there is something to simulate.
    """

    start: Array
    is_placed: Array
    is_focus: Array
    is_judged: Array


class _Attempts(struct.PyTreeNode):
    """A batch of attempts while it runs.

    Attributes:
      data: the simulations.
      track: the rule's memory; trajectory: f32[N, T + 1, 13] (`types.Settling`).
      overflowed, is_finite: bool[N].
    """

    batch: _Batch
    data: mjx.Data
    track: stability.Track
    trajectory: Array
    overflowed: Array
    is_finite: Array

    @property
    def is_running(self) -> Array:
        """bool[N]: not decided yet."""
        return self.batch.is_judged & ~self.track.is_over & self.is_finite & ~self.overflowed


class _Checks(struct.PyTreeNode):
    """A batch of last checks while it runs."""

    batch: _Batch
    data: mjx.Data
    standing: Standing

    @property
    def is_running(self) -> Array:
        """bool[N]: not decided yet."""
        return self.batch.is_judged & (self.standing.verdict == int(Verdict.NONE))


_Run = TypeVar("_Run", _Attempts, _Checks)
_T = TypeVar("_T")


_REFERENCE = (
    "compiling engine 'jax', which is a reference and none for many scenes, for {number} convex parts: half a"
    " minute for four, minutes for ninety; on a CPU it then runs tens to hundreds of times slower than engine"
    " 'native', which compiles in seconds"
)


def _where_running(running: Array, after: _T, before: _T) -> _T:
    """A pytree of scenes after a step of those that run, bool[N]; of the others as it was."""
    return jax.tree.map(lambda new, old: where(jnp, running, new, old), after, before)


class MjxPhysics(OneScenePhysics):
    """`host.Physics` on MJX.

    Args:
      layout: the compiled world.
      config: when an object stands still.
      impl: "warp" (an NVIDIA GPU; slowly, a CPU) or "jax" (a reference, wherever XLA runs; slow).
      options: of Warp.

    Raises:
      ConfigError: unknown `impl`.
      MissingExtraError: Warp is not installed.
    """

    def __init__(
        self,
        layout: Layout,
        config: StabilityConfig,
        impl: str = "warp",
        options: WarpOptions = WARP_DEFAULTS,
    ) -> None:
        super().__init__(config, one_scene(self.settle_batch), one_scene(self.stand_batch))
        self.layout = layout
        self.scenes = MjxScenes(layout, impl, options)
        if impl == "jax":
            self.compiling = _REFERENCE.format(number=layout.model.ngeom)

    def settle_batch(
        self, poses: Array, is_placed: Array, focus: Array, is_active: Array
    ) -> Settling:
        """`settle` for scenes with one leading axis."""
        start, is_sound = start_poses(self.layout, poses, is_placed, is_active)
        is_focus = jnp.arange(self.layout.num_objects) == focus[:, None]
        batch = _Batch(start, is_placed, is_focus, is_active & is_sound)
        run = self._run_to_end(self._release(batch), self._attempt_step)
        return self._report(run, poses, is_active)

    def _release(self, batch: _Batch) -> _Attempts:
        num_scenes, num_objects = batch.is_placed.shape
        rows = jnp.arange(num_scenes)
        focus = jnp.argmax(batch.is_focus, axis=1)
        trajectory = jnp.zeros((num_scenes, self.config.last_step + 1, 13), jnp.float32)
        return _Attempts(
            batch=batch,
            data=self.scenes.start_at(batch.start),
            track=stability.new_track(jnp, (num_scenes,), num_objects, jnp.float32),
            trajectory=trajectory.at[:, 0, :7].set(batch.start[rows, focus]),
            overflowed=jnp.zeros(num_scenes, bool),
            is_finite=jnp.ones(num_scenes, bool),
        )

    def _attempt_step(self, run: _Attempts) -> _Attempts:
        scenes = self.scenes
        config = self.config
        batch = run.batch
        running = run.is_running
        rows = jnp.arange(len(running))
        focus = jnp.argmax(batch.is_focus, axis=1)
        data = scenes.step(run.data, running[:, None] & batch.is_placed)
        is_finite = scenes.is_finite(data)
        data = scenes.halt_diverged(data, is_finite, batch.start)
        velocity = scenes.velocity(data, focus)
        is_neighbour = batch.is_placed & ~batch.is_focus
        shift, turn = displacement(jnp, scenes.poses(data), batch.start)
        shift = shift * is_neighbour
        turn = turn * is_neighbour
        motion = stability.step_motion(jnp, velocity, run.track.velocity, config)
        after = stability.advance(jnp, run.track, motion, shift, turn, config)
        row = jnp.concatenate([scenes.poses(data)[rows, focus], velocity], axis=-1)
        index = jnp.where(running, after.step, config.last_step + 1)
        return _Attempts(
            batch=batch,
            data=data,
            track=_where_running(running, after, run.track),
            trajectory=run.trajectory.at[rows, index].set(row, mode="drop"),
            overflowed=run.overflowed | (running & scenes.has_overflowed(data)),
            is_finite=run.is_finite & (is_finite | ~running),
        )

    def _run_to_end(self, run: _Run, step: Callable[[_Run], _Run]) -> _Run:
        """Steps until every scene is decided; once few are left, those alone, as a batch of their own."""
        num_scenes = len(run.batch.start)
        few = self.scenes.few_of(num_scenes)
        run = jax.lax.while_loop(lambda run: jnp.sum(run.is_running) > few, step, run)
        if not few:
            return run
        index = jnp.nonzero(run.is_running, size=few, fill_value=num_scenes)[0]
        whole = run.replace(data=None)
        part = jax.tree.map(lambda leaf: leaf.at[index].get(mode="clip"), whole)
        # What fills up the places of a smaller number is no scene.
        part = part.replace(
            batch=part.batch.replace(is_judged=part.batch.is_judged & (index < num_scenes)),
            data=self.scenes.take_scenes(run.data, index),
        )
        part = self._run_to_end(part, step)
        data = run.data.replace(qpos=run.data.qpos.at[index].set(part.data.qpos, mode="drop"))
        merged = jax.tree.map(
            lambda leaf, new: leaf.at[index].set(new, mode="drop"), whole, part.replace(data=None)
        )
        return merged.replace(batch=run.batch, data=data)

    def _report(
        self,
        run: _Attempts,
        poses: Array,
        is_active: Array,
    ) -> Settling:
        start = run.batch.start
        is_placed = run.batch.is_placed
        is_focus = run.batch.is_focus
        num_scenes, num_objects = is_placed.shape
        track = run.track
        is_finite = run.is_finite & run.batch.is_judged
        config = self.config
        ended = self.scenes.poses(run.data)
        final = jnp.where((is_placed & is_finite[:, None])[..., None], ended, poses)
        is_at_rest = track.is_quiet & is_finite & ~run.overflowed
        focus = jnp.argmax(is_focus, axis=1)
        contacts, lost = self._contacts(ended, start, is_focus, is_at_rest)
        both = overlaps(contacts, self.layout, 2 * num_scenes).reshape(2, num_scenes, -1)
        # What was lost may be anybody's.
        overflowed = run.overflowed | (is_at_rest & lost)
        center_of_mass = self.layout.center_of_mass.astype(np.float32)
        verdict, is_quiet = stability.verdict_of_attempt(
            jnp,
            track,
            is_focus=is_focus,
            is_neighbour=is_placed & ~is_focus,
            is_below=below_top(jnp, final, center_of_mass, self.layout.top),
            penetrates=stability.penetrates(jnp, both[0], both[1], config),
            overflowed=overflowed,
            is_finite=is_finite,
            config=config,
        )

        def where_at_rest(array: Array) -> Array:
            return mask_scenes(jnp, array, is_at_rest)

        report = empty_settling(jnp, (num_scenes,), num_objects, config)
        depths = both[0].reshape(num_scenes, num_objects + 1, num_objects + 1)
        is_moved = is_placed & (is_focus | (track.shift >= MIN_SHIFT))
        margin = jnp.where(is_moved, margins(contacts, self.layout, final), jnp.inf)
        return report.replace(
            verdict=jnp.where(is_active, verdict, report.verdict),
            num_steps=track.step,
            poses=final,
            penetration=mask_scenes(jnp, depths.max(axis=(1, 2)), ~overflowed & is_at_rest),
            is_quiet=is_quiet,
            margin=where_at_rest(margin),
            touches=where_at_rest((depths[jnp.arange(num_scenes), focus] > 0)[:, :-1]),
            bears=where_at_rest(bearers(contacts, self.layout, focus)),
            trajectory=mask_scenes(jnp, run.trajectory, is_finite),
            **{name: mask_scenes(jnp, getattr(track, name), is_finite) for name in SUMS},
        )

    def _contacts(
        self, final: Array, start: Array, is_focus: Array, is_at_rest: Array
    ) -> tuple[ContactRows, Array]:
        """Contacts of 2 N scenes: as they came to rest, then as they were before without the focus object.

        Objects of the others are parked: they touch nothing. See `MjxScenes.contacts`.
        """
        parked = jnp.asarray(self.layout.parked, jnp.float32)
        after = jnp.where(is_at_rest[:, None, None], final, parked)
        before = jnp.where((is_at_rest[:, None] & ~is_focus)[..., None], start, parked)
        return self.scenes.contacts(jnp.concatenate([after, before]))

    def stand_batch(self, poses: Array, is_placed: Array, is_active: Array) -> Standing:
        """`stand` for scenes with one leading axis."""
        start, is_sound = start_poses(self.layout, poses, is_placed, is_active)
        batch = _Batch(start, is_placed, jnp.zeros_like(is_placed), is_active & is_sound)
        blank = empty_standing(jnp, (len(poses),), self.layout.num_objects)
        checks = _Checks(batch, self.scenes.start_at(start), blank)
        run = self._run_to_end(checks, self._check_step)
        standing = run.standing
        diverged = jnp.where(is_active & ~is_sound, int(Verdict.NON_FINITE), standing.verdict)
        return standing.replace(
            verdict=diverged,
            shift=standing.shift * is_placed,
            turn=standing.turn * is_placed,
        )

    def _check_step(self, run: _Checks) -> _Checks:
        scenes = self.scenes
        batch = run.batch
        running = run.is_running
        before = run.standing
        data = scenes.step(run.data, running[:, None] & batch.is_placed)
        is_finite = scenes.is_finite(data)
        data = scenes.halt_diverged(data, is_finite, batch.start)
        shift, turn = displacement(jnp, scenes.poses(data), batch.start)
        num_steps = before.num_steps + 1
        shift = jnp.maximum(before.shift, shift)
        turn = jnp.maximum(before.turn, turn)
        verdict = stability.verdict_of_scene(
            jnp, num_steps, shift, turn, batch.is_placed, self.config
        )
        verdict = jnp.where(scenes.has_overflowed(data), int(Verdict.OVERFLOW), verdict)
        verdict = jnp.where(is_finite, verdict, int(Verdict.NON_FINITE))
        after = Standing(verdict=verdict, num_steps=num_steps, shift=shift, turn=turn)
        return _Checks(batch, data, _where_running(running, after, before))
