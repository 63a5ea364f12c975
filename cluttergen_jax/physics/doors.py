"""Doors and drawers that stand open while objects are placed, and are closed before the last check.

A hand that pushes with at most `FORCE` leads each of them slowly to where it is closed, all objects awake:
drawers first, then what turns, and those of a kind together. An object that is moved out of its place, or
that keeps a door from closing, ends it. Then the doors stand where they are closed, the objects rest, and the
last check (docs/contract.md) is that of any other scene. What is in a drawer moves with it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from cluttergen_jax.geometry import product, rotate
from cluttergen_jax.physics.host import empty_closing
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.simulations import sleeping_model
from cluttergen_jax.physics.standing import displacement
from cluttergen_jax.types import Closing, Verdict

if TYPE_CHECKING:
    from cluttergen_jax.physics.native import NativePhysics

CLOSED_TURN = math.radians(1)
"""Radians: a hinge that is nearer to where it is closed has closed."""
CLOSED_SHIFT = 0.002
"""Metres: likewise of what slides."""
FORCE = 10.0
"""Newtons at the farthest edge of a door, at most."""
SPEED = 0.25
"""Metres a second of that edge, at most."""
_SHORTEST = 1.0
_LONGEST = 6.0
"""Seconds in which doors close."""
_HOLD = 30
"""Steps in which closed doors are held before it is looked where they are."""
_REST = 60
"""Steps of rest with the doors where they are closed, before the last check."""
_LOOK = 12
"""Steps between two looks."""
_STIFF = 30.0
"""Radians a second: how fast a door follows the hand."""


class CarryingSurface(NamedTuple):
    """A surface of the support with the doors open.

    Attributes:
      door: that which carries it, -1 for none.
      T_world_surface: f64[4, 4]; low, high: f64[2], of the box around its outline, in its frame, metres.
    """

    door: int
    T_world_surface: np.ndarray
    low: np.ndarray
    high: np.ndarray


@dataclass(frozen=True, eq=False)
class Carriage:
    """How what stands on D doors and drawers moves with them.

    Attributes:
      moves: f64[..., D, 4, 4], from where each stands to where it is after a travel of f64[..., D].
      surfaces: of the support, before anything has moved.
    """

    moves: Callable[[np.ndarray], np.ndarray]
    surfaces: tuple[CarryingSurface, ...]

    def carriers(self, poses: np.ndarray, center_of_mass: np.ndarray) -> np.ndarray:
        """i[..., K]: the door that carries each object, -1 for none: that of the surface next below it.

        Args:
          poses: f[..., K, 7], before anything has moved; center_of_mass: f[K, 3], object frames, metres.
        """
        center = poses[..., :3] + rotate(
            np, poses[..., 3:], np.broadcast_to(center_of_mass, poses[..., :3].shape)
        )
        carrier = np.full(poses.shape[:-1], -1)
        nearest = np.full(poses.shape[:-1], np.inf)
        for door, T, low, high in self.surfaces:
            local = (center - T[:3, 3]) @ T[:3, :3]
            is_over = ((local[..., :2] >= low) & (local[..., :2] <= high)).all(-1)
            is_next = is_over & (local[..., 2] >= 0) & (local[..., 2] < nearest)
            carrier = np.where(is_next, door, carrier)
            nearest = np.where(is_next, local[..., 2], nearest)
        return carrier

    def carried(
        self, poses: np.ndarray, carriers: np.ndarray, travel: np.ndarray, back: bool = False
    ) -> np.ndarray:
        """f64[..., K, 7]: poses f[..., K, 7] once doors have moved, objects at rest in what carries them.

        Args:
          carriers: i[..., K]; travel: f64[..., D].
          back: the other way round, from where doors have moved to where they stood.
        """
        from scipy.spatial.transform import Rotation

        moved = poses.astype(np.float64)
        T = self.moves(travel)
        T = np.linalg.inv(T) if back else T
        for door in range(T.shape[-3]):
            own = T[..., door, :, :]
            turn = Rotation.from_matrix(own[..., :3, :3].reshape(-1, 3, 3)).as_quat()
            turn = np.roll(turn, 1, axis=-1).reshape(*own.shape[:-2], 1, 4)
            position = rotate(np, turn, poses[..., :3]) + own[..., None, :3, 3]
            there = np.concatenate([position, product(turn, poses[..., 3:])], axis=-1)
            moved = np.where((carriers == door)[..., None], there, moved)
        return moved


@dataclass(frozen=True, eq=False)
class DoorLayout:
    """What an engine knows of D doors that close.

    Attributes:
      names: of their joints; is_turning: bool[D], hinges.
      travel: f64[D], from open to closed, radians or metres.
      reach: f64[D], metres from a hinge's axis to the farthest point that it moves; 1 for what slides.
      carriage: how what is in them moves with them.
      closed: the world with the doors closed, its objects as those of the open one.
      compile_moving: compiles the world with doors that move, their joints behind the objects', and an
        actuator for each; bodies: the names of the doors' bodies in it.
    """

    names: tuple[str, ...]
    is_turning: np.ndarray
    travel: np.ndarray
    reach: np.ndarray
    carriage: Carriage
    closed: Layout
    compile_moving: Callable[[], mujoco.MjModel]
    bodies: tuple[str, ...]

    @property
    def tolerance(self) -> np.ndarray:
        """f64[D], radians or metres by which a closed door may be off."""
        return np.where(self.is_turning, CLOSED_TURN, CLOSED_SHIFT)

    def carriers(self, poses: np.ndarray) -> np.ndarray:
        """i[..., K]: see `Carriage`; poses are with the doors open."""
        return self.carriage.carriers(poses, self.closed.center_of_mass)


class DoorCloser:
    """Closes the doors of scenes, a block at a time.

    Args:
      engine: whose scenes they are, with the doors open; closed: that of the world with the doors closed.
    """

    def __init__(self, engine: NativePhysics, closed: NativePhysics, num_threads: int) -> None:
        assert engine.layout.doors is not None
        self._engine = engine
        self._closed = closed
        self._layout = engine.layout.doors
        self._num_threads = num_threads
        self._num_objects = engine.layout.num_objects
        self._model = self._make_model()
        self._batch: Batch | None = None
        bodies = {self._model.body(name).id: k for k, name in enumerate(self._layout.bodies)}
        self._door_of_geom = np.array([bodies.get(int(k), -1) for k in self._model.geom_bodyid])
        # Objects come before the doors' bodies, in the order of their joints.
        object_of_body = np.full(self._model.nbody, -1)
        object_of_body[self._model.jnt_bodyid[: self._num_objects]] = np.arange(self._num_objects)
        self._object_of_geom = object_of_body[self._model.geom_bodyid]

    def _make_model(self) -> mujoco.MjModel:
        model = sleeping_model(self._layout.compile_moving())
        first = 6 * self._num_objects
        inertia = model.dof_M0[first:]
        model.actuator_gainprm[:, 0] = _STIFF**2 * inertia
        model.actuator_biasprm[:, 1] = -(_STIFF**2) * inertia
        model.actuator_biasprm[:, 2] = -2 * _STIFF * inertia
        most = FORCE * self._layout.reach
        model.actuator_forcerange[:] = np.stack([-most, most], axis=1)
        return model

    def close_block(
        self, poses: np.ndarray, is_placed: np.ndarray, is_active: np.ndarray
    ) -> Closing:
        """The last check of scenes whose doors are closed first: see `Closing`."""
        layout = self._layout
        num_doors = len(layout.names)
        result = empty_closing(np, (len(poses),), self._num_objects, num_doors)
        result.poses[:] = poses
        is_finite = np.isfinite(poses).all(-1) & (np.linalg.norm(poses[..., 3:], axis=-1) > 1e-3)
        is_sound = (is_finite | ~is_placed).all(-1)
        result.verdict[is_active & ~is_sound] = Verdict.NON_FINITE
        is_active = is_active & is_sound
        indices = np.flatnonzero(is_active)
        size = self._engine.max_simulations
        for first in range(0, len(indices), size):
            block = indices[first : first + size]
            self._move(poses[block].astype(np.float64), is_placed[block], result, block)
        is_left = is_active & (result.verdict == int(Verdict.NONE))
        self._rest(poses, is_placed, result, is_left)
        return result

    def is_in_the_way(self, poses: np.ndarray, is_placed: np.ndarray, focus: int) -> bool:
        """Whether an object would overlap the support once its doors are closed.

        Args:
          poses: f[K, 7], with the doors open; is_placed: bool[K].
        """
        layout = self._layout
        only = is_placed & (np.arange(len(is_placed)) == focus)
        ends = layout.carriage.carried(poses, layout.carriers(poses), layout.travel)
        depths = self._closed.probe.depths(ends, only)
        return depths is None or bool(depths[focus, -1] > self._engine.config.max_penetration)

    def _simulations(self, num: int) -> Batch:
        if self._batch is None or self._batch.nsim < num:
            size = min(self._engine.max_simulations, 1 << (num - 1).bit_length())
            self._batch = Batch(self._model, size, self._num_threads, persistent=True)
            self._batch.expand("tree_sleep_policy")
            self._batch.expand("qpos0")
        return self._batch

    def _release(self, batch: Batch, poses: np.ndarray, is_placed: np.ndarray) -> np.ndarray:
        """Puts objects at rest with the doors open; f64[n, K, 7], where they are."""
        num = len(poses)
        never = int(mujoco.mjtSleepPolicy.mjSLEEP_NEVER)
        policy = batch.expand("tree_sleep_policy")
        policy[:num] = never
        objects = policy[:num, : self._num_objects]
        objects[...] = np.where(is_placed, never, int(mujoco.mjtSleepPolicy.mjSLEEP_INIT))
        start = np.where(is_placed[..., None], poses, self._engine.layout.parked)
        start[..., 3:] /= np.linalg.norm(start[..., 3:], axis=-1, keepdims=True)
        flat = start.reshape(num, -1)
        batch.expand("qpos0")[:num, : flat.shape[1]] = flat
        batch.reset(np.arange(num), stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        qpos = batch.bind("qpos")
        qpos[:num] = 0.0
        qpos[:num, : flat.shape[1]] = flat
        return start

    def _ramp(self) -> np.ndarray:
        """f64[T, D]: where the hand leads each door, step by step."""
        layout = self._layout
        timestep = self._model.opt.timestep
        travel = layout.travel
        targets = [np.zeros((1, len(travel)))]
        for is_stage in (~layout.is_turning, layout.is_turning):
            if not is_stage.any():
                continue
            # A cosine is fastest in its middle.
            longest = float((np.abs(travel) * layout.reach)[is_stage].max())
            seconds = min(max(math.pi / 2 * longest / SPEED, _SHORTEST), _LONGEST)
            share = (1 - np.cos(np.linspace(0, math.pi, math.ceil(seconds / timestep)))) / 2
            targets.append(targets[-1][-1] + share[:, None] * np.where(is_stage, travel, 0.0))
        hold = np.repeat(targets[-1][-1:], _HOLD, axis=0)
        return np.concatenate([*targets[1:], hold])

    def _move(
        self, poses: np.ndarray, is_placed: np.ndarray, result: Closing, block: np.ndarray
    ) -> None:
        """Closes the doors of some scenes; verdicts of those that fail are written into `result`."""
        layout = self._layout
        config = self._engine.config
        batch = self._simulations(len(poses))
        start = self._release(batch, poses, is_placed)
        carriers = layout.carriers(start)
        ramp = self._ramp()
        qpos = batch.bind("qpos")
        num = 7 * self._num_objects
        running = np.arange(len(poses))
        for first in range(0, len(ramp), _LOOK):
            control = ramp[first : first + _LOOK]
            raised = np.zeros(0, int)
            try:
                batch.rollout(len(control), control=control[None], record=(), ids=running)
            except SimulationError as error:
                raised = np.asarray(error.ids)
            at = block[running]
            result.num_steps[at] += len(control)
            now = qpos[running, :num].reshape(len(running), -1, 7)
            travel = qpos[running, num:]
            rests = layout.carriage.carried(start[running], carriers[running], travel)
            shift, turn = displacement(np, now, rests)
            shift = np.where(is_placed[running], shift, 0.0)
            turn = np.where(is_placed[running], turn, 0.0)
            result.shift[at] = np.maximum(result.shift[at], shift)
            result.turn[at] = np.maximum(result.turn[at], turn)
            is_off = (shift > config.stand_full_shift) | (turn > config.stand_full_turn)
            is_late = first + _LOOK >= len(ramp)
            is_open = np.abs(travel - layout.travel) > layout.tolerance
            has_failed = is_off.any(1) | (is_open.any(1) & is_late)
            is_lost = ~np.isfinite(qpos[running]).all(1)
            is_full = np.isin(running, raised)
            for row in np.flatnonzero(has_failed & ~is_lost & ~is_full):
                pair = self._pair(batch, int(running[row]), shift[row], carriers[running[row]])
                result.door[at[row]], result.hit[at[row]] = pair
            result.travel[at] = np.where(is_lost[:, None], 0.0, travel)
            is_good = ~is_lost & ~is_full
            kept = np.where(is_placed[running][..., None], now, poses[running])
            result.poses[at[is_good]] = kept[is_good]
            verdict = np.full(len(running), int(Verdict.NONE))
            verdict[has_failed] = Verdict.BLOCKED
            verdict[is_full] = Verdict.OVERFLOW
            verdict[is_lost] = Verdict.NON_FINITE
            result.verdict[at] = verdict
            running = running[verdict == int(Verdict.NONE)]
            if not running.size:
                return
        at = block[running]
        # Closed to within a hair, and then whole: what is in a drawer goes the rest of the way with it.
        now = qpos[running, :num].reshape(len(running), -1, 7)
        travel = qpos[running, num:]
        back = layout.carriage.carried(now, carriers[running], travel, back=True)
        whole = np.broadcast_to(layout.travel, travel.shape)
        ends = layout.carriage.carried(back, carriers[running], whole)
        result.poses[at] = np.where(is_placed[running][..., None], ends, poses[running])
        result.travel[at] = layout.travel

    def _pair(
        self, batch: Batch, sim: int, shift: np.ndarray, carriers: np.ndarray
    ) -> tuple[int, int]:
        """The door that hit an object, and the object, where they touch; else by what moved most."""
        data = batch.get_data(sim)
        best = (0.0, -1, -1)
        for depth, (a, b) in zip(data.contact.dist, data.contact.geom, strict=True):
            for door_geom, object_geom in ((a, b), (b, a)):
                door = int(self._door_of_geom[door_geom])
                index = int(self._object_of_geom[object_geom])
                if door < 0 or index < 0 or carriers[index] == door:
                    continue
                if -depth >= best[0]:
                    best = (float(-depth), door, index)
        if best[1] >= 0:
            return best[1], best[2]
        index = int(np.argmax(shift))
        # What is in a drawer is hit by what the drawer runs into.
        door = int(carriers[index])
        if door < 0:
            left = np.abs(self._layout.travel - batch.bind("qpos")[sim, 7 * self._num_objects :])
            door = int(np.argmax(left / self._layout.tolerance))
        return door, index if shift[index] > 0 else -1

    def _rest(
        self, poses: np.ndarray, is_placed: np.ndarray, result: Closing, is_left: np.ndarray
    ) -> None:
        """Lets objects rest with the doors closed, and runs the last check."""
        engine = self._closed
        config = engine.config
        indices = np.flatnonzero(is_left)
        for first in range(0, len(indices), engine.max_simulations):
            at = indices[first : first + engine.max_simulations]
            ids = np.arange(len(at))
            sims = engine.simulations(len(at))
            start = sims.release(result.poses[at], is_placed[at], never_sleeps=is_placed[at])
            sims.advance(ids, _REST)
            result.num_steps[at] += _REST
            overflowed, is_finite = sims.failures(ids)
            now = sims.poses(ids)
            shift, turn = displacement(np, now, start)
            is_off = (shift > config.stand_full_shift) | (turn > config.stand_full_turn)
            is_off &= is_placed[at]
            for row in np.flatnonzero(is_finite & ~overflowed):
                index = at[row]
                depths = engine.probe.depths(now[row], is_placed[index])
                if depths is None:
                    result.verdict[index] = Verdict.OVERFLOW
                    continue
                hit = int(np.argmax(depths[:-1, -1]))
                if is_off[row].any() or depths[hit, -1] > config.max_penetration:
                    hit = int(np.argmax(shift[row])) if is_off[row].any() else hit
                    carrier = int(self._layout.carriers(poses[index])[hit])
                    result.verdict[index] = Verdict.BLOCKED
                    result.door[index] = carrier if carrier >= 0 else len(self._layout.names) - 1
                    result.hit[index] = hit
            result.verdict[at[overflowed]] = Verdict.OVERFLOW
            result.verdict[at[~is_finite]] = Verdict.NON_FINITE
            kept = np.where(is_placed[at][..., None], now, poses[at])
            is_good = is_finite & ~overflowed
            result.poses[at[is_good]] = kept[is_good]
        is_due = is_left & (result.verdict == int(Verdict.NONE))
        standing = engine.stand_block(result.poses, is_placed, is_due)
        result.verdict[is_due] = standing.verdict[is_due]
        result.num_steps[is_due] += standing.num_steps[is_due]
        result.shift[is_due] = standing.shift[is_due]
        result.turn[is_due] = standing.turn[is_due]

    def free(self) -> None:
        """Gives back the simulations."""
        self._batch = None
        self._closed.free()


def door_text(names: Sequence[str], door: int, hit: int, objects: Sequence[str]) -> str:
    """What a door did, in words: `door_left hits mug`, or `drawer_1 does not close`; "" for nothing."""
    if door < 0:
        return ""
    return f"{names[door]} hits {objects[hit]}" if hit >= 0 else f"{names[door]} does not close"
