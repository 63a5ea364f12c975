"""Piles: objects let fall one after another between walls of air, brought to rest, and let fall again.

Of each scene the objects are let go between four unseen walls around the region, in any orientation, each
above all that is there, with little friction and some drag. Then the walls are gone, and it is settled in
rounds that begin without velocity, as loading a file does: two with less friction, so that what would barely
hold does not, then as many as it takes until one moves nothing. What lies outside is let fall again, and so
is what does not come to rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cluttergen_jax.config import AIR_WALLS
from cluttergen_jax.geometry import product, rotate
from cluttergen_jax.physics.host import below_top, empty_piling
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.simulations import Simulations, damping_of, sleeping_model
from cluttergen_jax.physics.standing import displacement
from cluttergen_jax.types import Piling, Verdict

if TYPE_CHECKING:
    from cluttergen_jax.physics.native import NativePhysics

# Steps between two releases, and after the last one, before the walls are taken away.
GAP = 24
FALL = 160

# Between the walls: share of all friction coefficients; 1/s by which speeds and angular speeds decay.
# Without drag some piles diverge: what is light spins faster and faster.
FRICTION = 0.6
DRAG = 1.0
TURNING_DRAG = 5.0

# Steps of the first rounds without walls, share of friction and drag in them: what slides later slides now.
# Drag on speeds makes them less thorough.
SHAKE = 120
SHAKE_FRICTION = 0.7
SHAKE_TURNING_DRAG = 2.0

# Steps of a round of rest, and what it may move at most: metres, radians.
REST = 240
REST_SHIFT = 0.0005
REST_TURN = math.radians(0.5)

# Rounds of rest since the last release after which what still moves is let fall again; and last checks after
# which a pile is given up.
MAX_ROUNDS = 4
MAX_CHECKS = 3

# Metres and radians that an object may move in the last check: a fifth of what `verify` allows in five times
# as long. What leans and rolls in a heap goes on as it began.
CREEP_SHIFT = 0.001
CREEP_TURN = math.radians(1)

# Metres: between a box that is let go and those below it; of the walls of air inside the region, so that
# they are touched and not a bin's walls; height above the top at which objects wait.
_GAP_ABOVE = 0.002
_INSET = 0.001
_WAITING = 20.0


class PileRequest(NamedTuple):
    """What is piled, for n scenes. K objects in the compiled world, S slots, R releases of an object at most.

    Attributes:
      order: i32[n, S], objects in the order of their release, -1 for none.
      draws: f32[n, R, S, 6], for each release a quaternion of any length, and where in the region in x and y,
        from -1 to 1.
      region: f32[n, 9], its world pose and its half extents.
      half_extents: f32[n, K, 3], of the objects' boxes, metres.
      whole: f32[n], 1 where a box must lie in the region whole, 0 where its centre must.
      budget: i32[n], releases of a scene at most.
    """

    order: np.ndarray
    draws: np.ndarray
    region: np.ndarray
    half_extents: np.ndarray
    whole: np.ndarray
    budget: np.ndarray


def walled_simulations(layout: Layout, size: int, num_threads: int) -> Simulations:
    """Simulations of a world between walls of air, with little friction and some drag."""
    assert layout.compile_walled is not None
    model = sleeping_model(layout.compile_walled())
    model.opt.noslip_iterations = 0
    model.geom_friction[:] *= FRICTION
    model.dof_damping[:] = damping_of(model, DRAG, TURNING_DRAG)
    return Simulations(model, layout, size, num_threads)


class _Stage(IntEnum):
    """What comes next in a scene."""

    RELEASE = 0
    SHAKE_OTHER = 1
    SHAKE = 2
    REST = 3
    CHECK = 4
    OVER = 5


class Piler:
    """One block of piles while they are made.

    Args:
      engine: whose world it is.
      walled: simulations between walls, at least as many as there are scenes.
      asked: of the block.
    """

    def __init__(self, engine: NativePhysics, walled: Simulations, asked: PileRequest) -> None:
        self.engine = engine
        self.walled = walled
        self.asked = asked
        num = len(asked.order)
        num_objects = engine.layout.num_objects
        self.plain = engine.simulations(num)
        self.result = empty_piling(np, (num,), num_objects)
        self.poses = np.tile(engine.layout.parked, (num, 1, 1))
        self.stage = np.full(num, int(_Stage.RELEASE))
        self.rounds = np.zeros(num, int)
        self.checks = np.zeros(num, int)
        is_slot = asked.order >= 0
        rows = np.arange(num)
        self.is_member = np.zeros((num, num_objects), bool)
        self.is_member[rows[:, None], np.maximum(asked.order, 0)] |= is_slot
        self.is_pending = self.is_member.copy()
        self._latest = np.zeros(num, int)

    def run(self) -> Piling:
        """Makes every pile of the block, or finds that it cannot be made."""
        work: dict[_Stage, Callable[[np.ndarray], None]] = {
            _Stage.RELEASE: self._release,
            _Stage.SHAKE_OTHER: self._shake_other,
            _Stage.SHAKE: self._shake,
            _Stage.REST: self._rest,
            _Stage.CHECK: self._check,
        }
        while (self.stage != _Stage.OVER).any():
            for stage, do in work.items():
                if (rows := np.flatnonzero(self.stage == stage)).size:
                    do(rows)
        self._look_at_rest()
        self.result.poses[:] = np.where(self.is_member[..., None], self.poses, 0.0)
        return self.result

    def _release(self, rows: np.ndarray) -> None:
        """Lets go of what is pending, one object after another, between the walls."""
        sims = self.walled
        ids = np.arange(len(rows))
        self._stand_walls(rows)
        is_there = self.is_member[rows] & ~self.is_pending[rows]
        sims.release(self.poses[rows], is_there, is_there, self._waiting(rows))
        order = self.asked.order[rows]
        is_due = np.take_along_axis(self.is_pending[rows], np.maximum(order, 0), 1) & (order >= 0)
        turns = np.argsort(~is_due, axis=1, kind="stable")
        for turn in range(is_due.sum(1).max()):
            slot = turns[:, turn]
            at = np.flatnonzero(is_due[ids, slot])
            which = order[at, slot[at]]
            poses = sims.poses(at)
            above = self._pose_above(rows[at], which, slot[at], poses, is_there[at])
            sims.rouse(at, which, above)
            is_there[at, which] = True
            self.result.releases[rows[at], which] += 1
            self._latest[rows[at]] = which
            self._advance(sims, rows[at], at, GAP)
        self._advance(sims, rows, ids, FALL)
        self.is_pending[rows] = False
        self.rounds[rows] = 0
        self._give_up_failed(rows, *self._take_poses(sims, rows, ids))
        self._go_on(rows, self._first_round)

    @property
    def _first_round(self) -> _Stage:
        return _Stage.SHAKE_OTHER if self.engine.config.both_detectors else _Stage.SHAKE

    def _stand_walls(self, rows: np.ndarray) -> None:
        """Puts the walls around each scene's region."""
        position, quaternion = self.walled.planes(AIR_WALLS)
        region = self.asked.region[rows].astype(np.float64)
        for index, name in enumerate(AIR_WALLS):
            axis = "xy".index(name[-1])
            sign = 1.0 if name[-2] == "+" else -1.0
            inward = np.zeros(3)
            inward[axis] = -sign
            # From z to the inward normal: a right angle about z x inward.
            about = np.cross((0.0, 0.0, 1.0), inward) * math.sqrt(0.5)
            stand = np.broadcast_to([math.sqrt(0.5), *about], (len(rows), 4))
            quaternion[: len(rows), index] = product(region[:, 3:7], stand)
            away = -inward * (region[:, 7 + axis, None] - _INSET)
            position[: len(rows), index] = region[:, :3] + rotate(np, region[:, 3:7], away)

    def _waiting(self, rows: np.ndarray) -> np.ndarray:
        """f64[n, K, 7]: where objects wait, one above the other, high above the region."""
        radius = np.linalg.norm(self.asked.half_extents[rows], axis=-1)
        poses = np.zeros((*radius.shape, 7))
        poses[..., :2] = self.asked.region[rows, None, :2]
        poses[..., 2] = self.engine.layout.top + _WAITING + np.cumsum(2 * radius + 0.1, axis=1)
        poses[..., 3] = 1.0
        return poses

    def _pose_above(
        self,
        rows: np.ndarray,
        which: np.ndarray,
        slot: np.ndarray,
        poses: np.ndarray,
        is_there: np.ndarray,
    ) -> np.ndarray:
        """f64[n, 7]: where to let go of one object of each scene: in the region, above all that is there."""
        draw = self.asked.draws[rows, self.result.releases[rows, which], slot].astype(np.float64)
        region = self.asked.region[rows].astype(np.float64)
        turn = draw[:, :4] / np.maximum(np.linalg.norm(draw[:, :4], axis=-1, keepdims=True), 1e-12)
        half = self.asked.half_extents[rows].astype(np.float64)
        own = _reach(turn, half[np.arange(len(rows)), which])
        room = np.maximum(region[:, 7:] - own[:, :2] - _INSET, 0.0)
        local = np.concatenate([draw[:, 4:] * room, np.zeros((len(rows), 1))], axis=1)
        xy = (region[:, :3] + rotate(np, region[:, 3:7], local))[:, :2]
        quaternion = product(region[:, 3:7], turn)
        own = _reach(quaternion, half[np.arange(len(rows)), which])
        others = _reach(poses[..., 3:], half)
        gap = np.abs(poses[..., :2] - xy[:, None]) - others[..., :2] - own[:, None, :2]
        is_below = is_there & (gap < 0).all(-1)
        top = np.where(is_below, poses[..., 2] + others[..., 2], self.engine.layout.top).max(1)
        return np.concatenate([xy, (top + own[:, 2] + _GAP_ABOVE)[:, None], quaternion], axis=1)

    def _shake_other(self, rows: np.ndarray) -> None:
        with self.plain.detected_by("libccd", self.engine.config.file_margin):
            self._shake_once(rows, _Stage.SHAKE)

    def _shake(self, rows: np.ndarray) -> None:
        self._shake_once(rows, _Stage.REST)

    def _shake_once(self, rows: np.ndarray, following: _Stage) -> None:
        """A round with less friction and some drag. Where it fails it is left out: another may help."""
        with self.plain.lower_friction(SHAKE_FRICTION, 0.0, SHAKE_TURNING_DRAG):
            self._round(rows, SHAKE)
        self._go_on(rows, following)

    def _rest(self, rows: np.ndarray) -> None:
        """A round of rest; its first steps are enough where they are those of a scene that stands."""
        config = self.engine.config
        start = self.poses[rows].astype(np.float32)
        self.poses[rows] = start
        overflowed, is_finite = self._round(rows, config.stand_steps)
        is_moving = self._moves(rows, start, config.stand_shift, config.stand_turn)
        is_good = ~is_moving.any(1) & ~overflowed & is_finite
        # What stands so is checked, and saved, as it was.
        self.poses[rows[is_good]] = start[is_good]
        self._go_on(rows[is_good], _Stage.CHECK)
        rows = rows[~is_good]
        start = start[~is_good]
        ids = np.flatnonzero(~is_good)
        if not rows.size:
            return
        self._advance(self.plain, rows, ids, REST - config.stand_steps)
        self._give_up_failed(rows, *self._take_poses(self.plain, rows, ids))
        self.rounds[rows] += 1
        is_moving = self._moves(rows, start, REST_SHIFT, REST_TURN)
        self._go_on(rows[~is_moving.any(1)], _Stage.CHECK)
        is_late = is_moving.any(1) & (self.rounds[rows] >= MAX_ROUNDS)
        is_late &= self.stage[rows] == _Stage.REST
        unsettled = np.full(is_late.sum(), Verdict.UNSETTLED)
        self._release_again(rows[is_late], is_moving[is_late], unsettled)

    def _moves(
        self, rows: np.ndarray, start: np.ndarray, max_shift: float, max_turn: float
    ) -> np.ndarray:
        """bool[n, K]: which objects are farther than that from where they were: metres, radians."""
        shift, turn = displacement(np, self.poses[rows], start)
        return ((shift > max_shift) | (turn > max_turn)) & self.is_member[rows]

    def _check(self, rows: np.ndarray) -> None:
        """The last check (docs/contract.md), from the poses that will be saved."""
        poses = self.poses[rows].astype(np.float32)
        standing = self.engine.stand_block(poses, self.is_member[rows], np.ones(len(rows), bool))
        self.poses[rows] = poses
        self.checks[rows] += 1
        self.result.check_steps[rows] += standing.num_steps
        self.result.drift[rows] = standing.shift.max(1)
        verdict = standing.verdict.copy()
        creeps = ((standing.shift > CREEP_SHIFT) | (standing.turn > CREEP_TURN)).any(1)
        verdict[creeps & (verdict == int(Verdict.STABLE))] = int(Verdict.CREPT)
        is_good = verdict == int(Verdict.STABLE)
        is_last = is_good | (self.checks[rows] >= MAX_CHECKS)
        self.result.verdict[rows[is_last]] = verdict[is_last]
        self.stage[rows[is_last]] = _Stage.OVER
        self._go_on(rows[~is_last], self._first_round)

    def _round(self, rows: np.ndarray, num_steps: int) -> tuple[np.ndarray, np.ndarray]:
        """A round without walls, from rest; as `_take_poses`."""
        ids = np.arange(len(rows))
        is_member = self.is_member[rows]
        self.plain.release(self.poses[rows], is_member, never_sleeps=is_member)
        self._advance(self.plain, rows, ids, num_steps)
        return self._take_poses(self.plain, rows, ids)

    def _advance(
        self, sims: Simulations, rows: np.ndarray, ids: np.ndarray, num_steps: int
    ) -> None:
        """Steps simulations `ids` of the scenes `rows`."""
        sims.advance(ids, num_steps)
        self.result.num_steps[rows] += num_steps
        self.result.steps[rows, self._latest[rows]] += num_steps

    def _take_poses(
        self, sims: Simulations, rows: np.ndarray, ids: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Keeps where objects are, where all went well: which overflowed and which are finite, bool[n]."""
        overflowed, is_finite = sims.failures(ids)
        is_good = is_finite & ~overflowed
        poses = np.where(self.is_member[rows][..., None], sims.poses(ids), self.poses[rows])
        self.poses[rows[is_good]] = poses[is_good]
        return overflowed, is_finite

    def _go_on(self, rows: np.ndarray, stage: _Stage) -> None:
        """The next stage of scenes that are not given up; or what lies outside is let go again."""
        rows = rows[self.stage[rows] != _Stage.OVER]
        self.stage[rows] = stage
        is_outside, is_below = self._outside(rows)
        is_any = is_outside.any(1)
        verdict = np.where(is_below.any(1), int(Verdict.FELL), int(Verdict.OUTSIDE))
        self._release_again(rows[is_any], is_outside[is_any], verdict[is_any])

    def _release_again(self, rows: np.ndarray, which: np.ndarray, verdict: np.ndarray) -> None:
        """Lets go of objects, bool[n, K], once more; or gives up scenes in which that was done too often."""
        releases = self.result.releases[rows]
        most = self.asked.draws.shape[1]
        is_spent = (which & (releases >= most)).any(1)
        is_spent |= releases.sum(1) + which.sum(1) > self.asked.budget[rows]
        self.is_pending[rows] = which
        self.stage[rows] = _Stage.RELEASE
        for row, each in zip(rows[is_spent], verdict[is_spent], strict=True):
            self._give_up(np.array([row]), Verdict(int(each)))

    def _outside(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """bool[n, K] each: which objects lie outside of the region or below the top, and which below."""
        poses = self.poses[rows]
        layout = self.engine.layout
        region = self.asked.region[rows, None].astype(np.float64)
        away = poses[..., :3] - region[..., :3]
        local = rotate(np, region[..., 3:7] * [1, -1, -1, -1], away)
        turn = product(region[..., 3:7] * [1, -1, -1, -1], poses[..., 3:])
        reach = self.asked.whole[rows, None, None] * _reach(turn, self.asked.half_extents[rows])
        is_beyond = (np.abs(local[..., :2]) + reach[..., :2] > region[..., 7:] + 1e-6).any(-1)
        is_below = below_top(np, poses, layout.center_of_mass, layout.top) & self.is_member[rows]
        return (is_beyond & self.is_member[rows]) | is_below, is_below

    def _give_up(self, rows: np.ndarray, verdict: Verdict) -> None:
        rows = rows[self.stage[rows] != _Stage.OVER]
        self.result.verdict[rows] = int(verdict)
        self.stage[rows] = _Stage.OVER

    def _give_up_failed(
        self, rows: np.ndarray, overflowed: np.ndarray, is_finite: np.ndarray
    ) -> None:
        self._give_up(rows[~is_finite], Verdict.NON_FINITE)
        self._give_up(rows[overflowed], Verdict.OVERFLOW)

    def _look_at_rest(self) -> None:
        """Overlaps and contacts of the piles that stand; what overlaps too much does not."""
        config = self.engine.config
        probe = self.engine.probe
        allowed = min(config.max_added_penetration, config.max_penetration)
        for row in np.flatnonzero(self.result.verdict == int(Verdict.STABLE)):
            depths = probe.depths(self.poses[row], self.is_member[row])
            if depths is None:
                self.result.verdict[row] = int(Verdict.OVERFLOW)
                continue
            self.result.penetration[row] = depths.max()
            if depths.max() > allowed:
                self.result.verdict[row] = int(Verdict.PENETRATING)
            self.result.touches[row] = depths[:-1, :-1] > 0
            self.result.level[row] = self._levels(int(row))

    def _levels(self, row: int) -> np.ndarray:
        """i32[K]: how many objects are below each, one upon the other, in the scene that was probed last."""
        com = rotate(np, self.poses[row][:, 3:], self.engine.layout.center_of_mass)
        height = self.poses[row][:, 2] + com[:, 2]
        level = np.zeros(len(height), np.int32)
        members = np.flatnonzero(self.is_member[row])
        for index in members[np.argsort(height[members])]:
            bears = self.engine.probe.bearers(int(index)) & (height < height[index])
            level[index] = level[bears].max() + 1 if bears.any() else 0
        return level


def _reach(quaternion: np.ndarray, half_extents: np.ndarray) -> np.ndarray:
    """f64[..., 3]: half extents of the upright box around a turned one."""
    axes = np.eye(3) * half_extents[..., None, :]
    return np.abs(rotate(np, quaternion[..., None, :], axes)).sum(-2)
