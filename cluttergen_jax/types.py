"""Vocabulary: verdicts, what `settle` and `stand` report, and small lengths in words."""

from __future__ import annotations

import enum
from typing import Any

from flax import struct

Array = Any
"""A JAX or a NumPy array; shapes and units stand with each field."""


class Verdict(enum.IntEnum):
    """How an attempt or a finished scene was judged. On the host `sentence` explains it."""

    NONE = -1
    STABLE = 0
    UNSETTLED = 1
    DISPLACED = 2
    PENETRATING = 3
    FELL = 4
    OUTSIDE = 5
    OVERFLOW = 6
    NON_FINITE = 7
    CREPT = 8
    UNSUPPORTED = 9
    FRAGILE = 10
    UNRELATED = 11
    BLOCKED = 12

    @property
    def sentence(self) -> str:
        """What the code means, for people."""
        return _SENTENCES[self]

    @property
    def label(self) -> str:
        """The word used in tables and files, such as `non-finite`."""
        return self.name.lower().replace("_", "-")


_SENTENCES = {
    Verdict.NONE: "nothing was judged",
    Verdict.STABLE: "came to rest in time, and nothing else was disturbed",
    Verdict.UNSETTLED: "did not come to rest in time",
    Verdict.DISPLACED: "a placed object was moved",
    Verdict.PENETRATING: "two bodies overlap",
    Verdict.FELL: "fell below the support's top",
    Verdict.OUTSIDE: "came to rest outside the queried region, or too far beyond the support's edge",
    Verdict.OVERFLOW: "the simulator ran out of room for contacts",
    Verdict.NON_FINITE: "the simulation diverged",
    Verdict.CREPT: "the finished scene moved in the last check",
    Verdict.UNSUPPORTED: "came to rest with its centre of mass too near the edge of what carries it",
    Verdict.FRAGILE: "would not stand under a slight tilt, less friction and softer contacts",
    Verdict.UNRELATED: "came to rest where a relation asked for does not hold, or, packed or natural, on "
    "an object that shall carry none",
    Verdict.BLOCKED: "a door or a drawer hit an object when it was closed, or did not close",
}


class Settling(struct.PyTreeNode):
    """One attempt, as the simulator saw it. K objects in the compiled world, T + 1 trajectory rows.

    T is the step at which an attempt ends at the latest (`StabilityConfig.last_step`).

    Attributes:
      verdict: i32, a `Verdict`; UNSUPPORTED, UNRELATED, CREPT and BLOCKED are never given here, OUTSIDE only
        for what is in the way of a door that is to be closed, FRAGILE only where
        `StabilityConfig.robust_tilt` asks for it. NONE if the scene was inactive.
      num_steps: i32, the step at which the attempt ended.
      check_steps: i32, steps simulated after that, to see whether what came to rest is fragile.
      poses: f32[K, 7], final poses of all objects, world frame, metres, wxyz.
      trajectory: f32[T + 1, 13], the focus object's position, quaternion wxyz, linear and angular velocity
        in the world frame (m, m/s, rad/s): at release, then after each step; rows after `num_steps` are zero.
      motion_sum: f32, sum over steps of |v| + |a| with v, a in R^6 (the paper's reward).
      speed_sum: f32, sum over steps of the 1-norm of v in R^6 (the published code's reward).
      shift: f32[K], the farthest that each placed neighbour was from its start, metres.
      turn: f32[K], the most that each placed neighbour had turned, radians.
      penetration: f32, the deepest overlap at the end of an attempt that came to rest, metres; else zero.
      is_quiet: bool, the focus object came to rest in time: all that the paper's looser count asks.
      margin: f32[K], metres, after an attempt that came to rest: the support margin (`physics.margin`) of the
        focus object, and of each neighbour that it moved by 0.01 mm or more; infinite for all others, -inf
        for what nothing carries. Zero after other attempts.
      touches: bool[K], after an attempt that came to rest: the placed objects that touch the focus object.
      bears: bool[K], those among them that press it upwards.
    """

    verdict: Array
    num_steps: Array
    check_steps: Array
    poses: Array
    trajectory: Array
    motion_sum: Array
    speed_sum: Array
    shift: Array
    turn: Array
    penetration: Array
    is_quiet: Array
    margin: Array
    touches: Array
    bears: Array


class Standing(struct.PyTreeNode):
    """The last check of a finished scene, everything awake, from rest.

    Attributes:
      verdict: i32: STABLE, CREPT, OVERFLOW or NON_FINITE; NONE if the scene was inactive.
      num_steps: i32, steps simulated.
      shift: f32[K], how far each placed object was from its start at most, metres.
      turn: f32[K], how much each had turned at most, radians.
    """

    verdict: Array
    num_steps: Array
    shift: Array
    turn: Array


class Closing(Standing):
    """The last check of a finished scene whose doors were closed before it. D doors that close.

    Attributes:
      verdict: as that of a `Standing`, or BLOCKED.
      poses: f32[K, 7], where objects came to lie: drawers carry what is in them.
      travel: f32[D], by which each door moved, radians or metres.
      door: i32, the door that hit an object or did not close, -1 for none.
      hit: i32, the object that it hit, -1 for none.
    """

    poses: Array
    travel: Array
    door: Array
    hit: Array


class Piling(struct.PyTreeNode):
    """A pile or a crowd, as the simulator saw it. K objects in the compiled world.

    Attributes:
      verdict: i32: STABLE or CREPT after its last check; or what kept it from that: UNSETTLED, PENETRATING,
        OUTSIDE, FELL, OVERFLOW or NON_FINITE. NONE if the scene was inactive.
      num_steps: i32, steps simulated until it was at rest; check_steps: i32, those of last checks.
      poses: f32[K, 7], final poses of all objects, world frame, metres, wxyz.
      releases: i32[K], how often each object was let go.
      steps: i32[K], steps made after a release of each object and before the next release of another.
      drift: f32, metres, the largest movement in the last check.
      penetration: f32, the deepest overlap at rest, metres.
      touches: bool[K, K], pairs of objects that touch; level: i32[K], 0 on the support alone, else one more
        than the highest of the objects that carry it and whose centre of mass is lower.
      num_beside: i32, pairs of objects that touch from the side; num_leaning: i32, objects that lean, counted
        where objects were drawn together (`physics.crowds`); is_left_out: bool[K], those that tipped over or
        left the region meanwhile, or found no place: the others stand without them; margin: f32[K], metres,
        how well they do.
      rejected: i32[13], attempts by why they were taken back (`Verdict`), where objects came one by one.
    """

    verdict: Array
    num_steps: Array
    check_steps: Array
    poses: Array
    releases: Array
    steps: Array
    drift: Array
    penetration: Array
    touches: Array
    level: Array
    num_beside: Array
    num_leaning: Array
    is_left_out: Array
    margin: Array
    rejected: Array


def small_length(metres: float) -> str:
    """A small length with three digits that count: `0.12 mm`, `3.4 um`, `< 1 um`.

    Below a micrometre, the digits of a simulation tell of its arithmetic and of nothing that moved.
    """
    if metres < 1e-6:
        return "< 1 um"
    return f"{1e6 * metres:.3g} um" if metres < 1e-5 else f"{1e3 * metres:.3g} mm"
