"""The native engine: MuJoCo's C simulator, a batch of scenes on a thread pool, behind a JAX callback.

Placed neighbours sleep until they are touched, as they lay at rest before; the focus object never sleeps,
and the last check keeps everything awake. Objects that are not placed sleep where they are parked: asleep
they are weightless. Every call resets the simulations it uses, so that no sleeping state leaks from one to
the next.
"""

from __future__ import annotations

import math
import os
import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import jax
import mujoco
import numpy as np

from cluttergen_jax.config import StabilityConfig, Together
from cluttergen_jax.geometry import rotate
from cluttergen_jax.physics import stability
from cluttergen_jax.physics.alone import Alone
from cluttergen_jax.physics.convex_outlines import ConvexOutlines
from cluttergen_jax.physics.crowds import Crowder, CrowdRequest
from cluttergen_jax.physics.doors import DoorCloser
from cluttergen_jax.physics.drops import Bench, Dropper, DropRequest
from cluttergen_jax.physics.host import (
    SUMS,
    HostPhysics,
    below_top,
    empty_piling,
    empty_settling,
    empty_standing,
    mask_scenes,
    where,
)
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.log import silent_log
from cluttergen_jax.physics.margin import MIN_SHIFT, TOUCH_REACH, UNDER_REACH, OverlapProbe
from cluttergen_jax.physics.piles import Piler, PileRequest, walled_simulations
from cluttergen_jax.physics.simulations import Motion, Simulations, sleeping_model
from cluttergen_jax.physics.standing import displacement
from cluttergen_jax.types import Piling, Settling, Standing, Verdict

MAX_BATCHES = 3
PILES_AT_ONCE = 16
"""Made side by side, as they go on step by step together."""
_LOWER = 0.002
"""Metres of a step by which what is let go is lowered (`StabilityConfig.lower_releases`)."""
_MOST_LOWERED = 50
"""Such steps, at most."""
_FEW = 4
"""Steps made at once where the next one may decide a scene: some are in vain, but calls cost, too."""

# The first stage with the other detector, with which all settle a little anew: what moved less stands.
_OTHER_STEPS = 30
_OTHER_SHIFT = 0.0005
_OTHER_TURN = math.radians(0.5)

_OTHER_SHARE = 3
"""The second detector is asked in a third of the steps: it finds one fragile attempt in a hundred more, and
with all steps a robust scene would cost a third more."""

_MOST_NUMBERS = 2_000_000
"""Recorded at one time, 8 bytes each."""


class AtRest(NamedTuple):
    """What contacts tell of an attempt that came to rest.

    Attributes:
      penetrates: a pair overlaps too much.
      penetration: metres, the deepest overlap.
      margin: f64[K]; touches, bears: bool[K], see `Settling`.
    """

    penetrates: bool
    penetration: float
    margin: np.ndarray
    touches: np.ndarray
    bears: np.ndarray


class NativePhysics(HostPhysics):
    """`host.Physics` on MuJoCo's C engine: the default on a CPU.

    Args:
      layout: the compiled world.
      config: when an object stands still.
      num_threads: simulation threads; 0 takes every core.
      max_simulations: scenes simulated at a time; a larger batch is cut. Each takes about 4 MB.
    """

    def __init__(
        self,
        layout: Layout,
        config: StabilityConfig,
        num_threads: int = 0,
        max_simulations: int = 128,
    ) -> None:
        num_doors = 0 if layout.doors is None else len(layout.doors.names)
        super().__init__(layout.num_objects, config, num_doors)
        self.layout = layout
        self._num_threads = num_threads
        self.max_simulations = max_simulations
        self._model = sleeping_model(layout.model)
        self._cache: OrderedDict[int, Simulations] = OrderedDict()
        self.probe = OverlapProbe(layout, config.side_support)
        self._walled: Simulations | None = None
        self._lock = threading.Lock()
        self.closer: DoorCloser | None = None
        if layout.doors is not None:
            closed = NativePhysics(layout.doors.closed, config, num_threads, max_simulations)
            self.closer = DoorCloser(self, closed, num_threads)

    @cached_property
    def alone(self) -> Alone:
        """What is alone on a level top, and how it settles there."""
        return Alone(self)

    @property
    def knows_alone(self) -> bool:
        """Whether that is asked; a door that closes reaches what stands alone."""
        return self.config.decide_alone and self.closer is None

    @cached_property
    def near_probe(self) -> OverlapProbe:
        """Sees what touches from the side, too, where nothing presses."""
        return OverlapProbe(self.layout, reach=TOUCH_REACH)

    @cached_property
    def outlines(self) -> ConvexOutlines:
        """Of the objects, in plan."""
        return ConvexOutlines(self.layout)

    @cached_property
    def under_probe(self) -> OverlapProbe:
        """Sees what is right under something, too, where nothing presses."""
        return OverlapProbe(self.layout, reach=UNDER_REACH)

    def settle_batch(
        self, poses: np.ndarray, is_placed: np.ndarray, focus: np.ndarray, is_active: np.ndarray
    ) -> Settling:
        """`settle` for N scenes held in NumPy arrays with one leading axis."""
        result = empty_settling(np, (len(poses),), self.layout.num_objects, self.config)
        result.poses[:] = poses
        is_sound = _is_sound(poses, is_placed)
        result.verdict[is_active & ~is_sound] = Verdict.NON_FINITE
        is_left = is_active & is_sound
        with self._lock, silent_log():
            if self.knows_alone:
                for block in self._blocks(is_left):
                    is_left[block] = ~self.alone.settle(
                        poses[block], is_placed[block], focus[block], result, block
                    )
            for block in self._blocks(is_left):
                start = poses[block]
                if self.config.lower_releases:
                    start = self._lower_releases(start, is_placed[block], focus[block])
                self.settle_block(start, is_placed[block], focus[block], result, block)
            if self.config.robust_tilt:
                is_stable = result.verdict == int(Verdict.STABLE)
                for block in self._blocks(is_stable):
                    result.verdict[block], result.check_steps[block] = disturb(
                        self.simulations(len(block)),
                        result.poses[block],
                        is_placed[block],
                        focus[block],
                        self.config,
                    )
        return result

    def settle_block(
        self,
        poses: np.ndarray,
        is_placed: np.ndarray,
        focus: np.ndarray,
        result: Settling,
        block: np.ndarray,
    ) -> None:
        """Simulates attempts for what holds the engine already, and writes their reports into `result`."""
        attempt = _Attempt(self, poses, is_placed, focus)
        attempt.run()
        attempt.report(result, block)

    def _lower_releases(
        self, poses: np.ndarray, is_placed: np.ndarray, focus: np.ndarray
    ) -> np.ndarray:
        """f[n, K, 7]: scenes whose focus objects are lowered to the last of small steps without a contact."""
        lowered = poses.copy()
        for row, index in enumerate(focus.tolist()):
            at = lowered[row].astype(np.float64)
            height = at[index, 2]
            for step in range(_MOST_LOWERED):
                at[index, 2] = height - step * _LOWER
                depths = self.probe.depths(at, is_placed[row])
                if depths is None or depths[index].any():
                    break
                lowered[row, index, 2] = at[index, 2]
        return lowered

    def stand_batch(
        self, poses: np.ndarray, is_placed: np.ndarray, is_active: np.ndarray
    ) -> Standing:
        """`stand` for N scenes held in NumPy arrays with one leading axis; a `Closing` where doors close."""
        with self._lock, silent_log():
            if self.closer is not None:
                return self.closer.close_block(poses, is_placed, is_active)
            return self.stand_block(poses, is_placed, is_active)

    def stand_block(
        self,
        poses: np.ndarray,
        is_placed: np.ndarray,
        is_active: np.ndarray,
        is_brief: bool = False,
    ) -> Standing:
        """`stand_batch` for what holds the engine already, and is silent.

        Args:
          is_brief: end with the first stage; what is not quiet in it is UNSETTLED.
        """
        result = empty_standing(np, (len(poses),), self.layout.num_objects)
        is_sound = _is_sound(poses, is_placed)
        result.verdict[is_active & ~is_sound] = Verdict.NON_FINITE
        for block in self._blocks(is_active & is_sound):
            self._stand_block(
                poses[block],
                is_placed[block],
                is_placed[block],
                result,
                block,
                self.config,
                is_brief,
            )
        if self.config.both_detectors:
            # What one detector lets fall need not be asked of the other.
            is_left = result.verdict == int(Verdict.STABLE)
            is_asked = is_placed & is_left[:, None]
            for block in self._blocks(is_left) if self.knows_alone else ():
                is_asked[block] &= ~self.alone.rest(poses[block], is_placed[block])
            for block in self._blocks(is_asked.any(1)):
                self._stand_otherwise(
                    poses[block], is_placed[block], is_asked[block], result, block, is_brief
                )
        return result

    def stands_otherwise(self, poses: np.ndarray, is_placed: np.ndarray) -> np.ndarray:
        """Which scenes stand with the second detector, bool[n], for what holds the engine already."""
        result = empty_standing(np, (len(poses),), self.layout.num_objects)
        for block in self._blocks(np.ones(len(poses), bool)):
            scenes = (poses[block], is_placed[block], is_placed[block])
            self._stand_otherwise(*scenes, result, block, is_brief=True)
        return result.verdict == int(Verdict.STABLE)

    def make_batch(self, how: Together, *arrays: np.ndarray) -> Piling:
        """`HostPhysics.make` for N scenes, those that are active of them so many side by side."""
        make = {"pile": self._pile, "crowd": self._crowd, "drop": self._drop}[how]
        size = PILES_AT_ONCE if how == "pile" else self.max_simulations
        *asked, is_active = arrays
        result = empty_piling(np, (len(is_active),), self.layout.num_objects)
        indices = np.flatnonzero(is_active)
        with self._lock, silent_log():
            for start in range(0, len(indices), size):
                block = indices[start : start + size]
                made = make([each[block] for each in asked])
                for into, each in zip(jax.tree.leaves(result), jax.tree.leaves(made), strict=True):
                    into[block] = each
        return result

    def _pile(self, asked: Sequence[np.ndarray]) -> Piling:
        if self._walled is None:
            self._walled = walled_simulations(self.layout, PILES_AT_ONCE, self._num_threads)
        return Piler(self, self._walled, PileRequest(*asked)).run()

    def _crowd(self, asked: Sequence[np.ndarray]) -> Piling:
        return Crowder(self, CrowdRequest(*asked)).run()

    def _drop(self, asked: Sequence[np.ndarray]) -> Piling:
        return Dropper(self, self._benches, DropRequest(*asked)).run()

    @cached_property
    def _benches(self) -> list[Bench]:
        """Of each thread."""
        models = [self._model.__copy__() for _ in range(self._num_threads or os.cpu_count() or 1)]
        return [Bench(model, mujoco.MjData(model)) for model in models]

    def _blocks(self, is_wanted: np.ndarray) -> list[np.ndarray]:
        indices = np.flatnonzero(is_wanted)
        size = self.max_simulations
        return [indices[start : start + size] for start in range(0, len(indices), size)]

    def simulations(self, num_scenes: int) -> Simulations:
        """A cached batch with room for `num_scenes`; sizes are powers of two, so that a few are enough."""
        size = min(self.max_simulations, 1 << (num_scenes - 1).bit_length())
        if size not in self._cache:
            while len(self._cache) >= MAX_BATCHES:
                self._cache.popitem(last=False)
            self._cache[size] = Simulations(self._model, self.layout, size, self._num_threads)
        self._cache.move_to_end(size)
        return self._cache[size]

    def free(self) -> None:
        """See `BatchEngine`: the simulations."""
        with self._lock:
            self._cache.clear()
            self._walled = None
            self.__dict__.pop("_benches", None)
            if self.closer is not None:
                self.closer.free()

    def at_rest(
        self,
        before: np.ndarray,
        after: np.ndarray,
        is_placed: np.ndarray,
        focus: int,
        is_moved: np.ndarray,
    ) -> AtRest | None:
        """What contacts tell of one scene at rest; None if there was no room for them.

        Args:
          before, after: f[K, 7]; is_placed: bool[K]; is_moved: bool[K], whose support margin is wanted.
        """
        depths = self.probe.depths(after, is_placed)
        if depths is None:
            return None
        deepest = float(depths.max())
        margin = np.full(len(is_placed), np.inf)
        moved = np.flatnonzero(is_moved)
        margin[moved] = self.probe.margins(moved)
        touches = depths[focus, :-1] > 0
        bears = self.probe.bearers(focus)
        # No pair is allowed less than this, whatever it overlapped by before.
        if deepest <= min(self.config.max_added_penetration, self.config.max_penetration):
            return AtRest(False, deepest, margin, touches, bears)
        is_other = np.arange(len(is_placed)) != focus
        depths_before = self.probe.depths(before, is_placed & is_other)
        if depths_before is None:
            return None
        too_much = stability.penetrates(np, depths.ravel(), depths_before.ravel(), self.config)
        return AtRest(bool(too_much), deepest, margin, touches, bears)

    def _stand_block(
        self,
        poses: np.ndarray,
        is_placed: np.ndarray,
        is_awake: np.ndarray,
        result: Standing,
        block: np.ndarray,
        config: StabilityConfig,
        is_brief: bool = False,
    ) -> None:
        sims = self.simulations(len(block))
        start = sims.release(poses, is_placed, never_sleeps=is_awake)
        running = np.arange(len(block))
        while running.size:
            at = block[running]
            num_steps = self._steps_to_verdict(int(result.num_steps[at[0]]), len(at), config)
            motion = sims.run(running, num_steps)
            shift, turn = displacement(np, motion.poses, start[running, None])
            is_made = np.arange(shift.shape[1]) < (motion.num_steps - ~motion.is_finite)[:, None]
            counts = is_placed[running, None] & is_made[..., None]
            result.num_steps[at] += motion.num_steps
            result.shift[at] = np.maximum(result.shift[at], np.where(counts, shift, 0.0).max(1))
            result.turn[at] = np.maximum(result.turn[at], np.where(counts, turn, 0.0).max(1))
            reached = (result.num_steps[at], result.shift[at], result.turn[at])
            verdict = stability.verdict_of_scene(np, *reached, is_placed[running], config)
            if is_brief:
                is_past = (verdict == Verdict.NONE) & (result.num_steps[at] >= config.stand_steps)
                verdict[is_past] = Verdict.UNSETTLED
            verdict[motion.overflowed] = Verdict.OVERFLOW
            verdict[~motion.is_finite] = Verdict.NON_FINITE
            result.verdict[at] = verdict
            running = running[verdict == Verdict.NONE]

    def _stand_otherwise(
        self,
        poses: np.ndarray,
        is_placed: np.ndarray,
        is_asked: np.ndarray,
        result: Standing,
        block: np.ndarray,
        is_brief: bool,
    ) -> None:
        """The same check with the other detector, of scenes that stand with the first; added to `result`.

        Args:
          is_asked: bool[n, K], what is awake; the others sleep until they are touched.
        """
        sims = self.simulations(len(block))
        other = empty_standing(np, (len(block),), len(is_placed[0]))
        config = replace(
            self.config, stand_steps=_OTHER_STEPS, stand_shift=_OTHER_SHIFT, stand_turn=_OTHER_TURN
        )
        with sims.detected_by("libccd", self.config.file_margin):
            every = np.arange(len(block))
            self._stand_block(poses, is_placed, is_asked, other, every, config, is_brief)
        result.verdict[block] = other.verdict
        result.num_steps[block] += other.num_steps
        result.shift[block] = np.maximum(result.shift[block], other.shift)
        result.turn[block] = np.maximum(result.turn[block], other.turn)

    def _steps_to_verdict(self, step: int, num_scenes: int, config: StabilityConfig) -> int:
        """How many steps after `step` a last check may go on unjudged, with room for its records."""
        num_objects = self.layout.num_objects
        stages = (config.stand_steps, config.stand_full_steps)
        until = min(stage for stage in stages if stage > step)
        return min(until - step, max(1, _MOST_NUMBERS // (13 * num_objects * num_scenes)))


class _Attempt:
    """One block of attempts while it is simulated."""

    def __init__(
        self, engine: NativePhysics, poses: np.ndarray, is_placed: np.ndarray, focus: np.ndarray
    ) -> None:
        num = len(poses)
        num_objects = engine.layout.num_objects
        self.engine = engine
        self.poses = poses
        self.is_placed = is_placed
        self.focus = focus
        self.rows = np.arange(num)
        self.is_neighbour = is_placed & (np.arange(num_objects) != focus[:, None])
        self.sims = engine.simulations(num)
        is_focus = is_placed & ~self.is_neighbour
        self.start = self.sims.release(poses, is_placed, never_sleeps=is_focus)
        self.track = stability.new_track(np, (num,), num_objects, np.float64)
        self.trajectory = np.zeros((num, engine.config.last_step + 1, 13), np.float32)
        self.trajectory[:, 0, :7] = self.start[self.rows, focus]
        self.final = self.start.copy()
        self.overflowed = np.zeros(num, bool)
        self.is_finite = np.ones(num, bool)

    def run(self) -> None:
        """Steps until every scene of the block is decided."""
        running = self.rows
        while running.size:
            running = self._judge(running, self.sims.run(running, self._steps_to_verdict(running)))

    def _steps_to_verdict(self, running: np.ndarray) -> int:
        """How many steps to make at once: until the first scene can be decided, or a few more."""
        config = self.engine.config
        track = self.track
        left = config.last_step - int(track.step[running[0]])
        return min(left, max(_FEW, config.quiet_steps - int(track.hold[running].max())))

    def _judge(self, running: np.ndarray, motion: Motion) -> np.ndarray:
        """Judges the steps that were made, one after another; returns those still running."""
        num = len(running)
        rows = np.arange(len(running))
        focus = self.focus[running]
        velocity = motion.velocities[rows, :, focus]
        velocity[..., 3:] = rotate(np, motion.poses[rows, :, focus, 3:], velocity[..., 3:])
        shift, turn = displacement(np, motion.poses, self.start[running, None])
        is_neighbour = self.is_neighbour[running]
        track = stability.Track(*(field[running] for field in self.track))
        # Of all steps at once: calls cost more than numbers.
        before = np.concatenate([track.velocity[:, None], velocity[:, :-1]], axis=1)
        steps = stability.step_motion(np, velocity, before, self.engine.config)
        shift = shift * is_neighbour[:, None]
        turn = turn * is_neighbour[:, None]
        first = int(track.step[0])
        num_steps = np.zeros(num, int)
        is_running = np.ones(num, bool)
        for step in range(velocity.shape[1]):
            made = stability.StepMotion(*(field[:, step] for field in steps))
            config = self.engine.config
            after = stability.advance(np, track, made, shift[:, step], turn[:, step], config)
            track = after if is_running.all() else _where_running(is_running, after, track)
            num_steps += is_running
            has_failed = (motion.overflowed | ~motion.is_finite) & (num_steps == motion.num_steps)
            is_running = is_running & ~track.is_over & ~has_failed
            if not is_running.any():
                break
        for field, values in zip(self.track, track, strict=True):
            field[running] = values
        has_failed = num_steps == motion.num_steps
        self.overflowed[running] = motion.overflowed & has_failed
        self.is_finite[running] = motion.is_finite | ~has_failed
        self.final[running] = motion.poses[rows, num_steps - 1]
        moved = np.concatenate([motion.poses[rows, :, focus], velocity], axis=-1)
        moved[np.arange(moved.shape[1]) >= num_steps[:, None]] = 0.0
        self.trajectory[running, first + 1 : first + 1 + moved.shape[1]] = moved
        return running[is_running]

    def report(self, result: Settling, block: np.ndarray) -> None:
        """Writes the block's verdicts and motions into `result`."""
        engine = self.engine
        track = self.track
        final = np.where(self.is_placed[..., None], self.final, self.poses).astype(np.float32)
        final[~self.is_finite] = self.poses[~self.is_finite]
        penetrates = self._look_at_rest(final, result, block)
        result.verdict[block], result.is_quiet[block] = stability.verdict_of_attempt(
            np,
            track,
            is_focus=self.is_placed & ~self.is_neighbour,
            is_neighbour=self.is_neighbour,
            is_below=below_top(np, final, engine.layout.center_of_mass, engine.layout.top),
            penetrates=penetrates,
            overflowed=self.overflowed,
            is_finite=self.is_finite,
            config=engine.config,
        )
        if engine.closer is not None:
            for row in np.flatnonzero(result.verdict[block] == int(Verdict.STABLE)):
                scene = (final[row], self.is_placed[row], int(self.focus[row]))
                if engine.closer.is_in_the_way(*scene):
                    result.verdict[block[row]] = Verdict.OUTSIDE
        result.num_steps[block] = track.step
        result.poses[block] = final
        result.trajectory[block] = mask_scenes(np, self.trajectory, self.is_finite)
        for name in SUMS:
            values = mask_scenes(np, getattr(track, name), self.is_finite)
            getattr(result, name)[block] = values

    def _look_at_rest(self, final: np.ndarray, result: Settling, block: np.ndarray) -> np.ndarray:
        """Which scenes overlap too much, bool[n]; overlaps and margins are written into `result`."""
        penetrates = np.zeros(len(block), bool)
        is_moved = self.is_placed & (~self.is_neighbour | (self.track.shift >= MIN_SHIFT))
        for row in np.flatnonzero(self.track.is_quiet & self.is_finite & ~self.overflowed):
            focus = int(self.focus[row])
            scene = (self.poses[row], final[row], self.is_placed[row])
            found = self.engine.at_rest(*scene, focus, is_moved[row])
            if found is None:
                self.overflowed[row] = True
                continue
            penetrates[row] = found.penetrates
            at = block[row]
            result.penetration[at] = found.penetration
            result.margin[at] = found.margin
            result.touches[at] = found.touches
            result.bears[at] = found.bears
        return penetrates


def _where_running(
    is_running: np.ndarray, after: stability.Track, track: stability.Track
) -> stability.Track:
    """The track of those that run after a step, and of the others as it was."""
    pairs = zip(after, track, strict=True)
    return stability.Track(*(where(np, is_running, *pair) for pair in pairs))


def _is_sound(poses: np.ndarray, is_placed: np.ndarray) -> np.ndarray:
    """Whether every placed pose is finite and has a direction, bool[N]."""
    finite = np.isfinite(poses).all(-1) & (np.linalg.norm(poses[..., 3:], axis=-1) > 1e-3)
    return (finite | ~is_placed).all(-1)


def disturb(
    sims: Simulations,
    poses: np.ndarray,
    is_placed: np.ndarray,
    focus: np.ndarray,
    config: StabilityConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """Which scenes at rest would not stand under a slight tilt, less friction and softer contacts.

    What stands by a hair falls in the next simulator. It is found by one short simulation: gravity is tilted,
    and the tilt's direction turns once around, so that whatever would tip over an edge is leant over it for a
    while. In firm contact, heaps pass that fall as soon as contacts give way a little, as they do in most
    simulators.

    Args:
      sims: whose first n simulations are used; gravity, contacts and detector are as they were afterwards.
      poses: f[n, K, 7]; is_placed: bool[n, K]; focus: i[n].
      config: with `both_detectors` what stands with one of MuJoCo's detectors is asked with the other, too.

    Returns:
      i32[n], STABLE, FRAGILE or OVERFLOW; and i32[n], steps simulated.
    """
    verdict, num_steps = _disturb(sims, poses, is_placed, focus, config)
    left = np.flatnonzero(verdict == int(Verdict.STABLE))
    if config.both_detectors and left.size:
        with sims.detected_by("libccd", config.file_margin):
            faster = replace(config, robust_steps=max(1, config.robust_steps // _OTHER_SHARE))
            verdict[left], more = _disturb(sims, poses[left], is_placed[left], focus[left], faster)
        num_steps[left] += more
    return verdict, num_steps


def _disturb(
    sims: Simulations,
    poses: np.ndarray,
    is_placed: np.ndarray,
    focus: np.ndarray,
    config: StabilityConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """`disturb` with the detector that is chosen.

    All but the focus object sleep until they are touched, so that only what stands together with it is
    simulated. A scene is fragile as soon as any object is farther from where it came to rest than
    `config.robust_shift`, or has turned by more than `config.robust_turn`.
    """
    verdict = np.full(len(poses), int(Verdict.STABLE), np.int32)
    num_steps = np.zeros(len(poses), np.int32)
    is_focus = np.arange(poses.shape[1]) == focus[:, None]
    start = sims.release(poses, is_placed, never_sleeps=is_focus & is_placed)
    with sims.loosen_contacts(config.robust_friction):
        for down in _directions(config.robust_tilt, config.robust_steps):
            running = np.flatnonzero(verdict == int(Verdict.STABLE))
            if not running.size:
                break
            sims.turn_gravity(down)
            sims.step(running)
            num_steps[running] += 1
            overflowed, is_finite = sims.failures(running)
            poses_now = sims.poses(running)
            _, turn = displacement(np, poses_now, start[running])
            # In soft contact everything sinks a little, which is no fall.
            shift = np.linalg.norm(poses_now[..., :2] - start[running, :, :2], axis=-1)
            is_off = (shift > config.robust_shift) | (turn > config.robust_turn)
            is_fragile = (is_placed[running] & is_off).any(1) | ~is_finite
            verdict[running[is_fragile]] = Verdict.FRAGILE
            verdict[running[overflowed]] = Verdict.OVERFLOW
    return verdict, num_steps


def _directions(tilt: float, num_steps: int) -> np.ndarray:
    """f64[T, 3]: unit vectors of gravity, tilted by `tilt` radians, once around."""
    turn = 2 * np.pi * np.arange(num_steps) / num_steps
    sideways = np.sin(tilt) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return np.concatenate([sideways, np.full((num_steps, 1), -np.cos(tilt))], axis=1)
