"""The rule that judges attempts, written once over the Python array API standard (`standing` has scenes').

Every function takes the array namespace `xp` (NumPy in the native engine, `jax.numpy` in MJX) and arrays with
any leading axes, so the same lines decide in both engines.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.geometry import norm
from cluttergen_jax.physics.standing import has_moved
from cluttergen_jax.types import Array, Verdict


class Track(NamedTuple):
    """What is remembered of an attempt while it runs; leading axes are those of the batch.

    Attributes:
      step: i32, steps taken.
      hold: i32, quiet steps in a row.
      is_over: bool, the attempt has ended.
      is_quiet: bool, it ended quiet and in time.
      velocity: f[..., 6], of the focus object after the last step, linear then angular, world frame.
      motion_sum, speed_sum: f, see `Settling`.
      shift, turn: f[..., K], see `Settling`.
    """

    step: Array
    hold: Array
    is_over: Array
    is_quiet: Array
    velocity: Array
    motion_sum: Array
    speed_sum: Array
    shift: Array
    turn: Array


def new_track(xp: Any, batch: tuple[int, ...], num_objects: int, dtype: Any) -> Track:
    """A track at release: at rest, nothing counted."""

    def scalar(kind: Any) -> Array:
        return xp.zeros(batch, dtype=kind)

    return Track(
        step=scalar(xp.int32),
        hold=scalar(xp.int32),
        is_over=scalar(xp.bool),
        is_quiet=scalar(xp.bool),
        velocity=xp.zeros((*batch, 6), dtype=dtype),
        motion_sum=scalar(dtype),
        speed_sum=scalar(dtype),
        shift=xp.zeros((*batch, num_objects), dtype=dtype),
        turn=xp.zeros((*batch, num_objects), dtype=dtype),
    )


def is_quiet_step(xp: Any, velocity: Array, acceleration: Array, config: StabilityConfig) -> Array:
    """Whether all four motions are below their limits (paper, section 3.1).

    Args:
      velocity, acceleration: f[..., 6], linear then angular, world frame.

    Returns:
      bool[...].
    """
    limits = (
        (velocity[..., :3], config.max_speed),
        (velocity[..., 3:], config.max_angular_speed),
        (acceleration[..., :3], config.max_acceleration),
        (acceleration[..., 3:], config.max_angular_acceleration),
    )
    quiet = None
    for motion, limit in limits:
        size = xp.max(xp.abs(motion), axis=-1) if config.per_axis else norm(xp, motion)
        quiet = size < limit if quiet is None else quiet & (size < limit)
    return quiet


class StepMotion(NamedTuple):
    """What a step tells of the focus object's motion.

    Attributes:
      velocity: f[..., 6], after it, linear then angular, world frame.
      is_quiet: bool[...], all four motions are below their limits.
      size, change: f[...], lengths of velocity and acceleration; speed: f[...], sum of the former's parts.
    """

    velocity: Array
    is_quiet: Array
    size: Array
    change: Array
    speed: Array


def step_motion(xp: Any, velocity: Array, before: Array, config: StabilityConfig) -> StepMotion:
    """The motion of a step, or of many at once, from the velocities f[..., 6] after it and before it."""
    acceleration = (velocity - before) / config.timestep
    return StepMotion(
        velocity,
        is_quiet_step(xp, velocity, acceleration, config),
        norm(xp, velocity),
        norm(xp, acceleration),
        xp.sum(xp.abs(velocity), axis=-1),
    )


def advance(
    xp: Any, track: Track, motion: StepMotion, shift: Array, turn: Array, config: StabilityConfig
) -> Track:
    """The track after one more step of an attempt that is still running.

    Args:
      motion: of the step.
      shift, turn: f[..., K], how far every object is from its start.
    """
    step = track.step + 1
    hold = xp.where(motion.is_quiet, track.hold + 1, 0)
    ends_quiet = hold >= config.quiet_steps
    return Track(
        step=step,
        hold=hold,
        is_over=ends_quiet | (step >= config.last_step),
        is_quiet=ends_quiet & (step <= config.decision_step),
        velocity=motion.velocity,
        motion_sum=track.motion_sum + motion.size + motion.change,
        speed_sum=track.speed_sum + motion.speed,
        shift=xp.maximum(track.shift, shift),
        turn=xp.maximum(track.turn, turn),
    )


def verdict_of_attempt(
    xp: Any,
    track: Track,
    is_focus: Array,
    is_neighbour: Array,
    is_below: Array,
    penetrates: Array,
    overflowed: Array,
    is_finite: Array,
    config: StabilityConfig,
) -> tuple[Array, Array]:
    """The attempt's verdict, the gravest of all that went wrong, and whether the focus object alone passed.

    Args:
      is_focus, is_neighbour: bool[..., K], the current object, and the placed objects other than it.
      is_below: bool[..., K], whose centre of mass ended below the support's top.
      penetrates, overflowed, is_finite: bool[...].

    Returns:
      i32[...], a `Verdict`, and bool[...], `Settling.is_quiet`.
    """
    focus_fell = xp.any(is_focus & is_below, axis=-1)
    verdict = xp.where(track.is_quiet, int(Verdict.STABLE), int(Verdict.UNSETTLED))
    fell = focus_fell
    if config.judge_neighbours:
        went_far = (track.shift > config.max_shift) | (track.turn > config.max_turn)
        verdict = xp.where(track.is_quiet & penetrates, int(Verdict.PENETRATING), verdict)
        verdict = xp.where(
            xp.any(is_neighbour & went_far, axis=-1), int(Verdict.DISPLACED), verdict
        )
        fell = fell | xp.any(is_neighbour & is_below, axis=-1)
    verdict = xp.where(fell, int(Verdict.FELL), verdict)
    verdict = xp.where(overflowed, int(Verdict.OVERFLOW), verdict)
    verdict = xp.where(is_finite, verdict, int(Verdict.NON_FINITE))
    is_quiet = track.is_quiet & ~focus_fell & ~overflowed & is_finite
    return xp.asarray(verdict, dtype=xp.int32), is_quiet


def penetrates(xp: Any, depth: Array, depth_before: Array, config: StabilityConfig) -> Array:
    """Whether any pair overlaps too much at the end of an attempt.

    Args:
      depth: f[..., P], overlap of each pair now, metres, zero where apart.
      depth_before: f[..., P], the pair's own overlap at rest before the attempt; zero for the focus
        object's pairs.

    Returns:
      bool[...].
    """
    allowed = xp.minimum(depth_before + config.max_added_penetration, config.max_penetration)
    return xp.any(depth > allowed, axis=-1)


def verdict_of_scene(
    xp: Any, step: Array, shift: Array, turn: Array, is_placed: Array, config: StabilityConfig
) -> Array:
    """The last check's verdict after `step` steps, i32[...]: NONE while it is not over.

    Staged: a scene that hardly moved by the end of the first stage stands, others run to the end of the
    second.

    Args:
      step: i32[...]; shift, turn: f[..., K], the farthest so far; is_placed: bool[..., K].
    """
    is_unsteady = (shift > config.stand_shift) | (turn > config.stand_turn)
    stands_early = (step == config.stand_steps) & ~xp.any(is_placed & is_unsteady, axis=-1)
    stands_fully = ~xp.any(is_placed & has_moved(shift, turn, config), axis=-1)
    at_end = xp.where(stands_fully, int(Verdict.STABLE), int(Verdict.CREPT))
    verdict = xp.where(step >= config.stand_full_steps, at_end, int(Verdict.NONE))
    return xp.asarray(xp.where(stands_early, int(Verdict.STABLE), verdict), dtype=xp.int32)
