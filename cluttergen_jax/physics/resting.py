"""Objects that lean on one another brought to rest together: in rounds that begin without velocity.

A round begins as loading a file does. What moves goes on from where it came to, until a round moves nothing;
then the last check is made (docs/contract.md). Who makes the heap (`piles`, `crowds`) says how it begins.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np

from cluttergen_jax.geometry import product, rotate
from cluttergen_jax.physics.host import below_top, empty_piling
from cluttergen_jax.physics.simulations import Simulations
from cluttergen_jax.physics.standing import displacement
from cluttergen_jax.types import Piling, Verdict

if TYPE_CHECKING:
    from cluttergen_jax.physics.native import NativePhysics

# Steps of the first rounds without walls, share of friction and drag in them: what slides later slides now.
# Drag on speeds makes them less thorough.
SHAKE = 120
SHAKE_FRICTION = 0.7
SHAKE_TURNING_DRAG = 2.0

# Steps of a round of rest, and what it may move at most: metres, radians.
REST = 240
REST_SHIFT = 0.0005
REST_TURN = math.radians(0.5)

# Rounds of rest since a scene began after which what still moves begins again; and last checks after which it
# is given up.
MAX_ROUNDS = 4
MAX_CHECKS = 3

# Metres and radians that an object may move in the last check: a fifth of what `verify` allows in five times
# as long. What leans and rolls in a heap goes on as it began.
CREEP_SHIFT = 0.001
CREEP_TURN = math.radians(1)


class Stage(IntEnum):
    """What comes next in a scene."""

    BEGIN = 0
    SHAKE_OTHER = 1
    SHAKE = 2
    REST = 3
    CHECK = 4
    OVER = 5


class RestRounds:
    """One block of n scenes while they are made and brought to rest.

    Args:
      engine: whose world of K objects it is.
      is_member: bool[n, K], the objects of each scene.
      region: f[n, 9], world pose and half extents of where they belong.
      half_extents: f[n, K, 3], of the objects' boxes, metres.
      whole: f[n], 1 where a box must lie in the region whole, 0 where its centre must.
    """

    def __init__(
        self,
        engine: NativePhysics,
        is_member: np.ndarray,
        region: np.ndarray,
        half_extents: np.ndarray,
        whole: np.ndarray,
    ) -> None:
        num, num_objects = is_member.shape
        self.engine = engine
        self.is_member = is_member
        self.region = region
        self.half_extents = half_extents
        self.whole = whole
        self.plain = engine.simulations(num)
        self.result = empty_piling(np, (num,), num_objects)
        self.poses = np.tile(engine.layout.parked, (num, 1, 1))
        self.stage = np.full(num, int(Stage.BEGIN))
        self.rounds = np.zeros(num, int)
        self.max_rounds = MAX_ROUNDS
        self.checks = np.zeros(num, int)
        self.latest = np.zeros(num, int)

    def begin(self, rows: np.ndarray) -> None:
        """Makes the heaps of these scenes, and goes on with `first_round`."""
        raise NotImplementedError

    def begin_again(self, rows: np.ndarray, which: np.ndarray, verdict: np.ndarray) -> None:
        """Makes them once more, or gives them up.

        Args:
          which: bool[m, K], objects that do not lie where they should, or do not come to rest.
          verdict: i[m], of a scene that is given up.
        """
        raise NotImplementedError

    @property
    def first_round(self) -> Stage:
        """The stage after `begin`."""
        return Stage.SHAKE_OTHER if self.engine.config.both_detectors else Stage.SHAKE

    def run(self) -> Piling:
        """Makes every scene of the block, or finds that it cannot be made."""
        work: dict[Stage, Callable[[np.ndarray], None]] = {
            Stage.BEGIN: self.begin,
            Stage.SHAKE_OTHER: self._shake_other,
            Stage.SHAKE: self._shake,
            Stage.REST: self.rest,
            Stage.CHECK: self._check,
        }
        while (self.stage != Stage.OVER).any():
            for stage, do in work.items():
                if (rows := np.flatnonzero(self.stage == stage)).size:
                    do(rows)
            self.renew()
        self.look_at_rest()
        self.result.poses[:] = np.where(self.is_member[..., None], self.poses, 0.0)
        return self.result

    def renew(self) -> None:
        """Looks after a turn of all stages for scenes that are over and should not be."""

    def _shake_other(self, rows: np.ndarray) -> None:
        with self.plain.detected_by("libccd", self.engine.config.file_margin):
            self._shake_once(rows, Stage.SHAKE)

    def _shake(self, rows: np.ndarray) -> None:
        self._shake_once(rows, Stage.REST)

    def _shake_once(self, rows: np.ndarray, following: Stage) -> None:
        """A round with less friction and some drag. Where it fails it is left out: another may help."""
        with self.plain.lower_friction(SHAKE_FRICTION, 0.0, SHAKE_TURNING_DRAG):
            self._round(rows, SHAKE)
        self.go_on(rows, following)

    def rest(self, rows: np.ndarray) -> None:
        """A round of rest; its first steps are enough where they are those of a scene that stands."""
        config = self.engine.config
        start = self.poses[rows].astype(np.float32)
        self.poses[rows] = start
        overflowed, is_finite = self._round(rows, config.stand_steps)
        is_moving = self._moves(rows, start, config.stand_shift, config.stand_turn)
        is_good = ~is_moving.any(1) & ~overflowed & is_finite
        # What stands so is checked, and saved, as it was.
        self.poses[rows[is_good]] = start[is_good]
        self.go_on(rows[is_good], Stage.CHECK)
        rows = rows[~is_good]
        start = start[~is_good]
        ids = np.flatnonzero(~is_good)
        if not rows.size:
            return
        self.advance(self.plain, rows, ids, REST - config.stand_steps)
        self.give_up_failed(rows, *self.take_poses(self.plain, rows, ids))
        self.rounds[rows] += 1
        is_moving = self._moves(rows, start, REST_SHIFT, REST_TURN)
        self.go_on(rows[~is_moving.any(1)], Stage.CHECK)
        is_late = is_moving.any(1) & (self.rounds[rows] >= self.max_rounds)
        is_late &= self.stage[rows] == Stage.REST
        unsettled = np.full(is_late.sum(), Verdict.UNSETTLED)
        self.begin_again(rows[is_late], is_moving[is_late], unsettled)

    def _moves(
        self, rows: np.ndarray, start: np.ndarray, max_shift: float, max_turn: float
    ) -> np.ndarray:
        """bool[n, K]: which objects are farther than that from where they were: metres, radians."""
        shift, turn = displacement(np, self.poses[rows], start)
        return ((shift > max_shift) | (turn > max_turn)) & self.is_member[rows]

    def _check(self, rows: np.ndarray) -> None:
        """The last check (docs/contract.md), from the poses that will be saved."""
        verdict = self.judge(rows)
        self.checks[rows] += 1
        is_good = verdict == int(Verdict.STABLE)
        is_last = is_good | (self.checks[rows] >= MAX_CHECKS)
        self.result.verdict[rows[is_last]] = verdict[is_last]
        self.stage[rows[is_last]] = Stage.OVER
        self.go_on(rows[~is_last], self.first_round)

    def judge(self, rows: np.ndarray, is_brief: bool = False) -> np.ndarray:
        """Verdicts of the last check, i[m], from poses that are then those that are saved.

        Args:
          is_brief: end with the check's first stage; what is not quiet in it is UNSETTLED.
        """
        poses = self.poses[rows].astype(np.float32)
        every = np.ones(len(rows), bool)
        standing = self.engine.stand_block(poses, self.is_member[rows], every, is_brief)
        self.poses[rows] = poses
        self.result.check_steps[rows] += standing.num_steps
        self.result.drift[rows] = standing.shift.max(1)
        verdict = standing.verdict.copy()
        creeps = ((standing.shift > CREEP_SHIFT) | (standing.turn > CREEP_TURN)).any(1)
        verdict[creeps & (verdict == int(Verdict.STABLE))] = int(Verdict.CREPT)
        return verdict

    def _round(self, rows: np.ndarray, num_steps: int) -> tuple[np.ndarray, np.ndarray]:
        """A round without walls, from rest; as `take_poses`."""
        ids = np.arange(len(rows))
        is_member = self.is_member[rows]
        self.plain.release(self.poses[rows], is_member, never_sleeps=is_member)
        self.advance(self.plain, rows, ids, num_steps)
        return self.take_poses(self.plain, rows, ids)

    def advance(self, sims: Simulations, rows: np.ndarray, ids: np.ndarray, num_steps: int) -> None:
        """Steps simulations `ids` of the scenes `rows`."""
        sims.advance(ids, num_steps)
        self.result.num_steps[rows] += num_steps
        self.result.steps[rows, self.latest[rows]] += num_steps

    def take_poses(
        self, sims: Simulations, rows: np.ndarray, ids: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Keeps where objects are, where all went well: which overflowed and which are finite, bool[n]."""
        overflowed, is_finite = sims.failures(ids)
        is_good = is_finite & ~overflowed
        poses = np.where(self.is_member[rows][..., None], sims.poses(ids), self.poses[rows])
        self.poses[rows[is_good]] = poses[is_good]
        return overflowed, is_finite

    def go_on(self, rows: np.ndarray, stage: Stage) -> None:
        """The next stage of scenes that are not given up; or what lies outside is let go again."""
        rows = rows[self.stage[rows] != Stage.OVER]
        self.stage[rows] = stage
        is_outside, is_below = self._outside(rows)
        is_any = is_outside.any(1)
        verdict = np.where(is_below.any(1), int(Verdict.FELL), int(Verdict.OUTSIDE))
        self.begin_again(rows[is_any], is_outside[is_any], verdict[is_any])

    def _outside(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """bool[n, K] each: which objects lie outside of the region or below the top, and which below."""
        poses = self.poses[rows]
        layout = self.engine.layout
        region = self.region[rows, None].astype(np.float64)
        away = poses[..., :3] - region[..., :3]
        local = rotate(np, region[..., 3:7] * [1, -1, -1, -1], away)
        turn = product(region[..., 3:7] * [1, -1, -1, -1], poses[..., 3:])
        reach = self.whole[rows, None, None] * reach_of(turn, self.half_extents[rows])
        is_beyond = (np.abs(local[..., :2]) + reach[..., :2] > region[..., 7:] + 1e-6).any(-1)
        is_below = below_top(np, poses, layout.center_of_mass, layout.top) & self.is_member[rows]
        return (is_beyond & self.is_member[rows]) | is_below, is_below

    def give_up(self, rows: np.ndarray, verdict: Verdict) -> None:
        """Ends scenes, with a verdict, that are not over."""
        rows = rows[self.stage[rows] != Stage.OVER]
        self.result.verdict[rows] = int(verdict)
        self.stage[rows] = Stage.OVER

    def give_up_failed(
        self, rows: np.ndarray, overflowed: np.ndarray, is_finite: np.ndarray
    ) -> None:
        """Gives up scenes of which `take_poses` kept nothing."""
        self.give_up(rows[~is_finite], Verdict.NON_FINITE)
        self.give_up(rows[overflowed], Verdict.OVERFLOW)

    def look_at_rest(self) -> None:
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
            self.result.num_beside[row] = self.num_beside(int(row), self.poses[row])

    def num_beside(self, row: int, poses: np.ndarray) -> int:
        """How many pairs of objects of a scene touch from the side, with objects at f[K, 7]."""
        probe = self.engine.near_probe
        if probe.depths(poses, self.is_member[row]) is None:
            return 0
        return int(np.triu(probe.beside()).sum())

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


def reach_of(quaternion: np.ndarray, half_extents: np.ndarray) -> np.ndarray:
    """f64[..., 3]: half extents of the upright box around a turned one."""
    axes = np.eye(3) * half_extents[..., None, :]
    return np.abs(rotate(np, quaternion[..., None, :], axes)).sum(-2)
