"""The native engine: MuJoCo's C simulator, a batch of scenes on a thread pool, behind a JAX callback.

Placed neighbours may fall asleep during an attempt (they wake when touched), the focus object never does, and
the last check keeps everything awake. Objects that are not placed sleep where they are parked: asleep they are
weightless. Every call resets the simulations it uses, so that no sleeping state leaks from one to the next.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.physics import stability
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.overlap import OverlapProbe
from cluttergen_jax.physics.report import below_top, empty_settling, empty_standing
from cluttergen_jax.physics.simulations import Simulations, sleeping_model
from cluttergen_jax.types import Array, Settling, Standing, Verdict

_MAX_BATCHES = 3


class NativePhysics:
    """`protocol.Physics` on MuJoCo's C engine: the default on a CPU.

    Args:
      layout: the compiled world.
      config: when an object stands still.
      num_threads: simulation threads; 0 takes every core.
      max_simulations: scenes simulated at a time; a larger batch is cut. Each takes about 4 MB.
    """

    def __init__(
        self, layout: Layout, config: StabilityConfig, num_threads: int = 0, max_simulations: int = 128
    ) -> None:
        self.layout, self.config = layout, config
        self._num_threads, self._max_simulations = num_threads, max_simulations
        self._model = sleeping_model(layout.model)
        self._cache: OrderedDict[int, Simulations] = OrderedDict()
        self._probe = OverlapProbe(layout)
        self._lock = threading.Lock()

    def settle(self, poses: Array, is_placed: Array, focus: Array, is_active: Array) -> Settling:
        """See `protocol.Physics.settle`."""
        shapes = jax.eval_shape(lambda: empty_settling(jnp, (), self.layout.num_objects, self.config))
        poses, is_placed = jnp.asarray(poses, jnp.float32), jnp.asarray(is_placed, bool)
        focus, is_active = jnp.asarray(focus, jnp.int32), jnp.asarray(is_active, bool)
        return jax.pure_callback(
            _flattened(self.settle_batch),
            shapes,
            poses,
            is_placed,
            focus,
            is_active,
            vmap_method="broadcast_all",
        )

    def stand(self, poses: Array, is_placed: Array, is_active: Array) -> Standing:
        """See `protocol.Physics.stand`."""
        shapes = jax.eval_shape(lambda: empty_standing(jnp, (), self.layout.num_objects))
        poses, is_placed = jnp.asarray(poses, jnp.float32), jnp.asarray(is_placed, bool)
        is_active = jnp.asarray(is_active, bool)
        return jax.pure_callback(
            _flattened(self.stand_batch), shapes, poses, is_placed, is_active, vmap_method="broadcast_all"
        )

    def settle_batch(
        self, poses: np.ndarray, is_placed: np.ndarray, focus: np.ndarray, is_active: np.ndarray
    ) -> Settling:
        """`settle` for N scenes held in NumPy arrays with one leading axis."""
        result = empty_settling(np, (len(poses),), self.layout.num_objects, self.config)
        result.poses[:] = poses
        is_sound = _is_sound(poses, is_placed)
        result.verdict[is_active & ~is_sound] = Verdict.NON_FINITE
        with self._lock:
            for block in self._blocks(is_active & is_sound):
                attempt = _Attempt(self, poses[block], is_placed[block], focus[block])
                attempt.run()
                attempt.report(result, block)
        return result

    def stand_batch(self, poses: np.ndarray, is_placed: np.ndarray, is_active: np.ndarray) -> Standing:
        """`stand` for N scenes held in NumPy arrays with one leading axis."""
        result = empty_standing(np, (len(poses),), self.layout.num_objects)
        is_sound = _is_sound(poses, is_placed)
        result.verdict[is_active & ~is_sound] = Verdict.NON_FINITE
        with self._lock:
            for block in self._blocks(is_active & is_sound):
                self._stand_block(poses[block], is_placed[block], result, block)
        return result

    def _blocks(self, is_wanted: np.ndarray) -> list[np.ndarray]:
        indices, size = np.flatnonzero(is_wanted), self._max_simulations
        return [indices[start : start + size] for start in range(0, len(indices), size)]

    def simulations(self, num_scenes: int) -> Simulations:
        """A cached batch with room for `num_scenes`; sizes are powers of two, so that a few are enough."""
        size = min(self._max_simulations, 1 << (num_scenes - 1).bit_length())
        if size not in self._cache:
            while len(self._cache) >= _MAX_BATCHES:
                self._cache.popitem(last=False)
            self._cache[size] = Simulations(self._model, self.layout, size, self._num_threads)
        self._cache.move_to_end(size)
        return self._cache[size]

    def overlaps_too_much(
        self, before: np.ndarray, after: np.ndarray, is_placed: np.ndarray, focus: int
    ) -> tuple[bool, float]:
        """Whether a scene at rest has a pair that overlaps too much, and the deepest overlap in metres."""
        depths = self._probe.depths(after, is_placed)
        deepest = float(depths.max())
        if deepest <= self.config.max_added_penetration:
            return False, deepest
        was_placed = is_placed & (np.arange(len(is_placed)) != focus)
        depths_before = self._probe.depths(before, was_placed)
        too_much = stability.penetrates(np, depths.ravel(), depths_before.ravel(), self.config)
        return bool(too_much), deepest

    def _stand_block(
        self, poses: np.ndarray, is_placed: np.ndarray, result: Standing, block: np.ndarray
    ) -> None:
        config = self.config
        sims = self.simulations(len(block))
        start = sims.release(poses, is_placed, never_sleeps=is_placed)
        running = np.arange(len(block))
        for last_step, passes in (
            (config.stand_steps, stability.stands_early),
            (config.stand_full_steps, stability.stands_fully),
        ):
            first_step = int(result.num_steps[block[running]].max(initial=0))
            for _ in range(first_step, last_step):
                if not running.size:
                    return
                sims.step(running)
                overflowed, is_finite = sims.failures(running)
                shift, turn = stability.moved(np, sims.poses(running), start[running])
                at = block[running]
                result.num_steps[at] += 1
                result.shift[at] = np.maximum(result.shift[at], shift * is_placed[running])
                result.turn[at] = np.maximum(result.turn[at], turn * is_placed[running])
                result.verdict[at[overflowed]] = Verdict.OVERFLOW
                result.verdict[at[~is_finite]] = Verdict.NON_FINITE
                running = running[~overflowed & is_finite]
            at = block[running]
            stood = passes(np, result.shift[at], result.turn[at], is_placed[running], config)
            result.verdict[at] = np.where(stood, Verdict.STABLE, Verdict.CREPT)
            running = running[~stood]


class _Attempt:
    """One block of attempts while it is simulated."""

    def __init__(
        self, engine: NativePhysics, poses: np.ndarray, is_placed: np.ndarray, focus: np.ndarray
    ) -> None:
        num, num_objects = len(poses), engine.layout.num_objects
        self.engine, self.poses, self.is_placed, self.focus = engine, poses, is_placed, focus
        self.rows = np.arange(num)
        self.is_neighbour = is_placed & (np.arange(num_objects) != focus[:, None])
        self.sims = engine.simulations(num)
        self.start = self.sims.release(poses, is_placed, never_sleeps=is_placed & ~self.is_neighbour)
        self.track = stability.new_track(np, (num,), num_objects, np.float64)
        self.trajectory = np.zeros((num, engine.config.max_steps + 1, 13), np.float32)
        self.trajectory[:, 0, :7] = self.start[self.rows, focus]
        self.overflowed, self.is_finite = np.zeros(num, bool), np.ones(num, bool)

    def run(self) -> None:
        """Steps until every scene of the block is decided."""
        running = self.rows
        while running.size:
            self.sims.step(running)
            self._judge(running)
            is_over = self.track.is_over | self.overflowed | ~self.is_finite
            running = running[~is_over[running]]

    def _judge(self, running: np.ndarray) -> None:
        focus = self.focus[running]
        self.overflowed[running], self.is_finite[running] = self.sims.failures(running)
        poses = self.sims.poses(running)
        velocity = self.sims.velocity(running, focus)
        shift, turn = stability.moved(np, poses, self.start[running])
        is_neighbour = self.is_neighbour[running]
        before = stability.Track(*(field[running] for field in self.track))
        after = stability.advance(
            np, before, velocity, shift * is_neighbour, turn * is_neighbour, self.engine.config
        )
        for field, values in zip(self.track, after, strict=True):
            field[running] = values
        self.trajectory[running, after.step, :7] = poses[np.arange(len(running)), focus]
        self.trajectory[running, after.step, 7:] = velocity

    def report(self, result: Settling, block: np.ndarray) -> None:
        """Writes the block's verdicts and motions into `result`."""
        engine, track = self.engine, self.track
        final = self.sims.poses(self.rows)
        final = np.where(self.is_placed[..., None], final, self.poses).astype(np.float32)
        final[~self.is_finite] = self.poses[~self.is_finite]
        overlap = [(False, 0.0)] * len(block)
        for row in np.flatnonzero(track.is_quiet & self.is_finite):
            overlap[row] = engine.overlaps_too_much(
                self.poses[row], final[row], self.is_placed[row], int(self.focus[row])
            )
        fell = (below_top(np, final, engine.layout.center_of_mass, engine.layout.top) & self.is_placed).any(1)
        result.verdict[block] = stability.verdict_of_attempt(
            np,
            track,
            self.is_neighbour,
            fell,
            np.array([too_much for too_much, _ in overlap], bool),
            self.overflowed,
            self.is_finite,
            engine.config,
        )
        result.num_steps[block] = track.step
        result.poses[block] = final
        result.trajectory[block] = self.trajectory
        result.motion_sum[block] = track.motion_sum
        result.speed_sum[block] = track.speed_sum
        result.shift[block] = track.shift
        result.turn[block] = track.turn
        result.penetration[block] = [deepest for _, deepest in overlap]
        result.is_quiet[block] = track.is_quiet & ~fell & ~self.overflowed & self.is_finite


def _is_sound(poses: np.ndarray, is_placed: np.ndarray) -> np.ndarray:
    """Whether every placed pose is finite and has a direction, bool[N]."""
    finite = np.isfinite(poses).all(-1) & (np.linalg.norm(poses[..., 3:], axis=-1) > 1e-3)
    return (finite | ~is_placed).all(-1)


def _flattened(function: Callable[..., Any]) -> Callable[..., Any]:
    """`function`, which wants one leading axis, for callbacks with any number; is_active comes last."""

    def call(*args: Array) -> Any:
        arrays = [np.asarray(array) for array in args]
        batch = arrays[-1].shape
        result = function(*(array.reshape(-1, *array.shape[len(batch) :]) for array in arrays))
        return jax.tree.map(lambda array: array.reshape(*batch, *array.shape[1:]), result)

    return call
