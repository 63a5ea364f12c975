"""One scene as a person fills it, by the rules that methods obey, and the seconds of work that count."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.geometry import rotate_in_plane, yaw_quaternion
from cluttergen_jax.placement.heightmap import VOID, HeightMapper
from cluttergen_jax.placement.problem import Setup
from cluttergen_jax.placement.region import action_of_pose
from cluttergen_jax.placement.replay import Attempt
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.scenes import SceneBatch, scene_of
from cluttergen_jax.placement.search import CLEARANCE, Candidates, lower_onto, under_side
from cluttergen_jax.placement.types import Episode, SupportGraph
from cluttergen_jax.types import Array, Settling, Verdict

_ON_TOP = 0.002


@dataclass(frozen=True)
class Held:
    """Where the current object is held: a pose in the region frame, in which it is let go.

    Attributes:
      x, y, z: metres, of the object's origin; z above the support's top. yaw: radians, from the region's x.
      is_lowered: it was lowered to first contact, and not moved since.
    """

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    yaw: float = 0.0
    is_lowered: bool = False


@dataclass(frozen=True)
class Lowered:
    """How the current object touches what is below it.

    Attributes:
      lift: metres higher than on the bare top.
      hanging: share of its under-side beyond the support's edge.
    """

    lift: float
    hanging: float

    @property
    def is_on_top(self) -> bool:
        """Whether it touches the support itself."""
        return self.lift < _ON_TOP


@dataclass(frozen=True, eq=False)
class Drop:
    """One attempt by hand, and what its verdict rests on.

    Attributes:
      attempt: as replays show one.
      mover: the placed object that was moved the most for its limits; None if nothing else stands there.
      shift, turn: metres and radians by which it was moved.
      penetration: metres, the deepest overlap. margin: metres, the new object's support margin.
    """

    attempt: Attempt
    mover: int | None
    shift: float
    turn: float
    penetration: float
    margin: float


@dataclass(frozen=True)
class Check:
    """The last check of a filled scene.

    Attributes:
      verdict: STABLE, or why the scene does not stand.
      mover: the object that moved the farthest; drift: how far, metres.
    """

    verdict: Verdict
    mover: int
    drift: float


@dataclass(frozen=True, eq=False)
class Before:
    """What `HandScene.undo` goes back to."""

    poses: Array
    is_placed: Array
    support_graph: SupportGraph
    held: Held


IDLE = 60.0
"""Seconds without any input after which nobody is taken to be at work."""
_CLEAR = 0.03


class ActiveClock:
    """Seconds of work: it runs from the first input on, and stands still `idle` seconds after the latest.

    Args:
      now: seconds, from any beginning.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic, idle: float = IDLE) -> None:
        self._now = now
        self._idle = idle
        self._before = 0.0
        self._latest = None

    _latest: float | None

    def touch(self) -> None:
        """There was an input."""
        self._latest = self._now()
        self._before = self.seconds

    def stop(self) -> None:
        """Nothing more counts until the next input."""
        self._before = self.seconds
        self._latest = None

    @property
    def seconds(self) -> float:
        """So far."""
        since = 0.0 if self._latest is None else self._now() - self._latest
        return self._before + min(since, self._idle)


class HandError(ClutterGenError):
    """What a person asked for cannot be done now."""


class HandScene:
    """One scene in the hands of a person, or of a program: an episode steered by the rules that methods obey.

    The current object is held, moved, lowered and dropped; what settled stably is committed, after anything
    else the scene is what it was. A person may try as often as they like, take the objects in any order and
    take back what they placed; all attempts count. K objects in the world.

    Args:
      setup: the problem; its placement takes nothing away and remembers no attempt.
      key: draws the objects, and the order in which they are offered.
      number: the scene's own, for people.
      now: the clock's.
      objects: the world's objects to be placed, in this order, in place of drawn ones.

    Attributes:
      held: where the current object is.
      is_closed: the scene is kept, and nothing can be done in it any more.
    """

    def __init__(
        self,
        setup: Setup,
        key: Array,
        number: int = 0,
        now: Callable[[], float] = time.monotonic,
        objects: Sequence[int] | None = None,
    ) -> None:
        self.setup = setup
        self.number = number
        self.clock = ActiveClock(now)
        self._rules = setup.problem.rules
        self._episode: Episode = _begin(self._rules, key, setup.keep_out, setup.start)
        if objects is not None:
            index = np.full(self._rules.num_slots, -1, np.int32)
            index[: len(objects)] = objects
            self._episode = self._episode.replace(object_index=jnp.asarray(index))
        self._before: list[Before] = []
        self._failure = Verdict.NONE
        self.is_closed = False
        self.hold(0.0, 0.0, 0.0)
        # Nobody has done anything yet.
        self.clock = ActiveClock(now)

    held: Held

    @cached_property
    def _mapper(self) -> HeightMapper:
        return HeightMapper.of(self._rules.geometry, self._rules.region)

    # What there is.

    @property
    def objects(self) -> tuple[ObjectAsset, ...]:
        """The world's K objects."""
        return self.setup.problem.world.objects

    @property
    def names(self) -> tuple[str, ...]:
        """Theirs, as banks have them."""
        return self.setup.problem.world.names

    @property
    def all(self) -> list[int]:
        """The scene's objects: those that stand in the order of placement, then those left."""
        index = np.asarray(self._episode.object_index)
        return [int(each) for each in index[index >= 0]]

    @property
    def left(self) -> list[int]:
        """The objects left, the current one first."""
        return self.all[int(self._episode.slot) :]

    @property
    def num_placed(self) -> int:
        """How many objects stand."""
        return int(self._episode.slot)

    @property
    def current(self) -> int | None:
        """The current object; None if all are placed."""
        return next(iter(self.left), None)

    @property
    def poses(self) -> np.ndarray:
        """f32[K, 7], world poses of what stands, metres, wxyz."""
        return np.asarray(self._episode.poses)

    @property
    def is_placed(self) -> np.ndarray:
        """bool[K]."""
        return np.asarray(self._episode.is_placed)

    @property
    def num_attempts(self) -> int:
        """Attempts so far, those taken back included."""
        return int(self._episode.counts.attempts.sum())

    @property
    def can_undo(self) -> bool:
        """Whether a placed object can be taken back."""
        return bool(self._before) and not self.is_closed

    @property
    def held_pose(self) -> np.ndarray:
        """f32[7]: where the current object is held, world frame."""
        region = self.setup.problem.region
        held = self.held
        xy = np.array(region.center) + rotate_in_plane((held.x, held.y), region.yaw)
        position = (*xy, self.setup.problem.world.support.top + held.z)
        return np.array([*position, *yaw_quaternion(region.yaw + held.yaw)], np.float32)

    # What a person does.

    def touch(self) -> None:
        """There was an input, of whatever kind: the clock runs on."""
        if not self.is_closed:
            self.clock.touch()

    def choose(self, object_index: int) -> None:
        """Makes another of the objects left the current one; HandError where it is none of them."""
        if object_index not in self.left:
            raise HandError(f"{self.names[object_index]} is not among the objects left")
        self.skip(self.left.index(object_index))

    def skip(self, places: int = 1) -> None:
        """Makes the object so many places further on the current one; those passed over come last.

        Raises:
          HandError: no object is left.
        """
        self._check_current()
        episode = self._episode
        slots = np.arange(self._rules.num_slots)
        first = self.num_placed
        last = len(self.all)
        order = np.concatenate([slots[:first], np.roll(slots[first:last], -places), slots[last:]])
        counts = episode.counts
        self._episode = episode.replace(
            object_index=episode.object_index[order],
            attempt=jnp.int32(0),
            counts=counts.replace(attempts=counts.attempts[order], steps=counts.steps[order]),
        )
        self.hold(self.held.x, self.held.y, self.held.yaw)

    def hold(self, x: float, y: float, yaw: float) -> None:
        """Holds the current object above all that stands; within the region, wherever it is asked for.

        Args:
          x, y: metres, region frame; yaw: radians, from the region's x.
        """
        self.touch()
        half = self.setup.problem.region.half_extents
        x = float(np.clip(x, -half[0], half[0]))
        y = float(np.clip(y, -half[1], half[1]))
        self.held = Held(x, y, self._clear_height(), math.remainder(yaw, math.tau))

    def hold_at(self, position: np.ndarray, wxyz: np.ndarray) -> None:
        """`hold` at a world pose; its height and whatever leans do not count."""
        region = self.setup.problem.region
        x, y = rotate_in_plane(np.asarray(position)[:2] - region.center, -region.yaw)
        self.hold(x, y, 2.0 * float(np.arctan2(wxyz[3], wxyz[0])) - region.yaw)

    def lower(self) -> Lowered:
        """Lowers the current object vertically to 1 mm above first contact, as searches do.

        Raises:
          HandError: no object is left, there is nothing below it, or it would have to be let go too high.
        """
        self._check_current()
        held = self.held
        limit = float(self._rules.height_range(self._episode))
        candidates = Candidates(jnp.array([[held.x, held.y]]), jnp.array([held.yaw]))
        fit = jax.device_get(_lower(self._rules, self._mapper, self._episode, candidates))
        rest = float(fit.rest[0])
        lift = float(fit.rest[0]) - self._half_height()
        if rest <= VOID / 2:
            raise HandError("there is nothing below it", hint="another place")
        if rest + CLEARANCE > limit:
            raise HandError(
                f"it would be let go {100 * rest:.1f} cm above the support's top",
                f"{100 * limit:.1f} cm at most: the height of the tallest placed object and its own",
                "a lower place",
            )
        self.held = Held(held.x, held.y, rest + CLEARANCE, held.yaw, is_lowered=True)
        return Lowered(lift, float(fit.hanging[0]))

    def drop(self, pose: np.ndarray | None = None) -> Drop:
        """Lets go of the current object where it is held: one attempt; HandError where no object is left.

        Args:
          pose: f[7], world frame, however turned, in place of where it is held, above the surface it is for.
        """
        self._check_current()
        held = self.held
        before = self._episode
        if pose is None:
            position = jnp.array([held.x, held.y, held.z])
            action, asked = _release(self._rules, before, position, jnp.float32(held.yaw))
        else:
            action = jnp.zeros(4)
            before, asked = _release_at(self._rules, before, jnp.asarray(pose, jnp.float32))
        settling = self._rules.simulator.settle(*asked)
        after, transition, _ = _judge(self._rules, before, action, settling)
        verdict = Verdict(int(transition.verdict))
        # A person may go on for as long as they like.
        self._episode = after.replace(is_over=jnp.bool_(False))
        if verdict == Verdict.STABLE:
            self._before.append(Before(before.poses, before.is_placed, before.support_graph, held))
            self.hold(0.0, 0.0, 0.0)
        else:
            self._failure = verdict
        return self._drop_report(before, transition, jax.device_get(settling))

    def undo(self) -> int:
        """Takes the object that was placed last back into the hand, and moves all others back; which it was.

        Raises:
          HandError: nothing was placed.
        """
        self._check_open()
        if not self._before:
            raise HandError("nothing was placed that could be taken back")
        before = self._before.pop()
        now = self._episode
        slot = self.num_placed - 1
        self._episode = now.replace(
            slot=jnp.int32(slot),
            attempt=jnp.int32(0),
            poses=before.poses,
            is_placed=before.is_placed,
            support_graph=before.support_graph,
            counts=now.counts.replace(rest_steps=now.counts.rest_steps.at[slot].set(0)),
            is_success=jnp.bool_(False),
            drift=jnp.float32(0),
        )
        self.hold(before.held.x, before.held.y, before.held.yaw)
        return self.left[0]

    def check(self) -> Check:
        """The last check: whether all objects stand together; HandError where not all are placed."""
        self._check_open()
        if self.left:
            raise HandError(
                f"{len(self.left)} of {len(self.all)} objects are not placed yet",
                "a scene whose every object stands",
                "placing them, or giving the scene up",
            )
        self.touch()
        episode = self._episode
        standing = self._rules.simulator.stand(episode.poses, episode.is_placed, jnp.bool_(True))
        self._episode = _conclude(self._rules, episode, standing).replace(is_over=jnp.bool_(False))
        verdict = Verdict(int(standing.verdict))
        if verdict != Verdict.STABLE:
            self._failure = verdict
        shift = np.where(self.is_placed, np.asarray(standing.shift), -1.0)
        return Check(verdict, int(np.argmax(shift)), float(shift.max()))

    def keep_as_given(self, poses: np.ndarray, max_shift: float) -> SceneBatch | None:
        """The scene with all objects at f[K, 7], if it stands the last check and moves `max_shift` at most.

        Nothing is placed for it, so that what lies on what is not known.
        """
        is_placed = np.isin(np.arange(len(poses)), self.all)
        episode = self._episode.replace(
            poses=jnp.asarray(poses, jnp.float32),
            is_placed=jnp.asarray(is_placed),
            slot=jnp.int32(len(self.all)),
        )
        standing = self._rules.simulator.stand(episode.poses, episode.is_placed, jnp.bool_(True))
        if standing.verdict != Verdict.STABLE or standing.shift.max() > max_shift:
            return None
        scene = jax.device_get(scene_of(_conclude(self._rules, episode, standing)))
        return scene.replace(level=None, num_touching=None)

    def close(self) -> None:
        """The scene is kept: nothing can be done in it any more, and its time ends."""
        self.clock.stop()
        self.is_closed = True

    def result(self) -> SceneBatch:
        """The scene as banks store it, NumPy arrays without leading axes.

        A success is what `check` found to stand. The verdict of any other scene is that of its latest
        failure, NONE where nothing failed.
        """
        scene = jax.device_get(scene_of(self._episode))
        verdict = Verdict.STABLE if scene.is_success else self._failure
        return scene.replace(verdict=np.int32(verdict))

    # How it is done.

    def _check_open(self) -> None:
        if self.is_closed:
            raise HandError("this scene is kept already", hint="a new scene")

    def _check_current(self) -> None:
        self._check_open()
        self.touch()
        if not self.left:
            raise HandError(
                "every object is placed", hint="saving the scene, or taking an object back"
            )

    def _clear_height(self) -> float:
        """Metres: where the current object is clear of all others, as far as it may be let go there."""
        top = self.setup.problem.world.support.top
        tall = np.asarray(self._rules.geometry.half_extents)[:, 2]
        highest = np.max((self.poses[:, 2] - top + tall)[self.is_placed], initial=0.0)
        own = 0.0 if self.current is None else tall[self.current]
        most = float(self._rules.height_range(self._episode))
        return min(float(highest + own + _CLEAR), most)

    def _half_height(self) -> float:
        return float(self._rules.geometry.half_extents[self.left[0], 2])

    def _drop_report(self, before: Episode, transition: Any, settling: Settling) -> Drop:
        focus = int(transition.object_index)
        is_placed = np.asarray(before.is_placed)
        config = self._rules.physics.config
        moved = np.maximum(settling.shift / config.max_shift, settling.turn / config.max_turn)
        mover = None
        if is_placed.any():
            mover = int(np.argmax(np.where(is_placed, moved, -1.0)))
        return Drop(
            attempt=Attempt.of(before, transition, settling),
            mover=mover,
            shift=0.0 if mover is None else float(settling.shift[mover]),
            turn=0.0 if mover is None else float(settling.turn[mover]),
            penetration=float(settling.penetration),
            margin=float(settling.margin[focus]),
        )


@jax.jit
def _begin(rules: Rules, key: Array, keep_out: Any, start: Any) -> Episode:
    return rules.begin(key, None, keep_out, start)


@jax.jit
def _lower(rules: Rules, mapper: HeightMapper, episode: Episode, candidates: Candidates) -> Any:
    heights = mapper(episode.region, episode.poses, episode.is_placed)
    return lower_onto(under_side(rules.body(episode)), heights, candidates)


@jax.jit
def _release(rules: Rules, episode: Episode, position: Array, yaw: Array) -> Any:
    action = action_of_pose(position, yaw, episode.region, rules.height_range(episode))
    return action, rules.release(episode, action)


@jax.jit
def _release_at(rules: Rules, episode: Episode, pose: Array) -> Any:
    focus = rules.focus(episode)
    if rules.surfaces is not None and episode.surface is not None:
        number = rules.surfaces.below(pose[:3])
        surface = episode.surface.at[focus].set(number)
        episode = episode.replace(surface=surface, region=rules.surfaces.region(number))
    poses = episode.poses.at[focus].set(pose)
    is_placed = episode.is_placed.at[focus].set(True)
    return episode, (poses, is_placed, focus, jnp.bool_(True))


@jax.jit
def _judge(rules: Rules, episode: Episode, action: Array, settling: Settling) -> Any:
    after, transition, is_filled = rules.judge(episode, action, settling)
    return after, transition.replace(settling=None), is_filled


@jax.jit
def _conclude(rules: Rules, episode: Episode, standing: Any) -> Episode:
    return rules.conclude(episode, standing, jnp.bool_(True))
