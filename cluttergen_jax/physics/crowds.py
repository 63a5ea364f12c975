"""Crowds: objects that stand apart drawn together by a slow force, until they touch from the side.

While they come together nothing has friction, and drag holds them slow: what is pushed then slides, and
little tips. Friction is back before they are brought to rest. Where some are to lean, a stronger force
draws them on with friction; what is held by its neighbours stays so.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cluttergen_jax.geometry import rotate, rotate_in_plane
from cluttergen_jax.physics.convex_outlines import gaps_in_plan, move_together, reaches_of_boxes
from cluttergen_jax.physics.resting import RestRounds, Stage, reach_of
from cluttergen_jax.types import Verdict

if TYPE_CHECKING:
    from cluttergen_jax.physics.native import NativePhysics


class Pull(NamedTuple):
    """How objects are drawn together.

    Attributes:
      strength: m/s^2 towards the middle of a group.
      height: of each object's half height, how far above its centre of mass.
      drag, turning_drag: 1/s, by which speeds and angular speeds decay.
      time_share: of a step's usual time.
      most_steps: until enough of them touch, or lean.
    """

    strength: float
    height: float
    drag: float
    turning_drag: float
    time_share: float
    most_steps: int


TOGETHER = Pull(2.0, height=0.0, drag=8.0, turning_drag=300.0, time_share=2.0, most_steps=96)
"""Without friction, of which each step costs half; objects keep how they are turned, and hardly tip."""
PRESS = Pull(1.2, height=0.0, drag=30.0, turning_drag=30.0, time_share=1.0, most_steps=36)
"""Likewise, all steps: overlaps become micrometres, and what touches goes on touching."""
LEAN = Pull(6.0, height=1.0, drag=2.0, turning_drag=2.0, time_share=1.0, most_steps=240)
"""With friction: tall objects tip against their neighbours."""
HOLD = Pull(2.0, height=0.0, drag=10.0, turning_drag=10.0, time_share=1.0, most_steps=96)
"""With `_HOLD_FRICTION` of their friction, all steps: what tipped is held, or stands up among the others."""
_HOLD_FRICTION = 0.3
# What leans while it is drawn, for each object that is to lean in the end: some stand up again.
_LEANING_FIRST = 1.5

# Steps until the targets are looked at for the first time, and between two looks.
_FIRST_LOOK = 24
_STRIDE = 12

# With friction and without a force: steps, and 1/s.
_RELAX_STEPS = 36
_RELAX_DRAG = 10.0

# Moves towards the middle of a group, without simulating. Metres by which something may overlap more then.
_MOVES = 12
_DEEPER = 0.0001
# Where an object is put back: metres from where it was placed, and radians from straight outwards.
_OUTWARD = (0.0, 0.04, 0.08, 0.12, 0.16, 0.2)
_TURNS = (0.0, math.pi / 4, -math.pi / 4)

# Rounds of rest after which what still moves is left out.
_MAX_ROUNDS = 2

# Metres from the middle of a group at which the force upon an object begins to fade, and from a box to keep
# out of at which it begins to turn round.
_NEAR = 0.02
_NEAR_BOX = 0.03
# Objects of a group where each shall touch another; fewer where fewer shall; and never fewer than that.
_GROUP = 10
_MIN_GROUP = 4
_ROUNDS = 4

LEANS = math.radians(5)
"""An object leans if it is tilted by more than this from how it was placed."""
TIPS = math.radians(30)
"""Where nothing is to lean, what is tilted by more than this has tipped over."""


class CrowdRequest(NamedTuple):
    """What is drawn together, for n scenes of K objects; T tries of each.

    Attributes:
      poses: f32[n, K, 7], where objects stand; is_placed: bool[n, K].
      draws: f32[n, T, K], from 0 to 1: in each try the objects with the largest begin the groups.
      region: f32[n, 9], its world pose and its half extents.
      half_extents: f32[n, K, 3], of the objects' boxes, metres.
      whole: f32[n], 1 where a box must lie in the region whole, 0 where its centre must.
      keep_out: f32[n, B, 5], boxes that nothing may come to lie in, in plan: centre, half extents, yaw.
      margin: f32[n, K], metres, the support margin that is asked of each object.
      side: f32[n], pairs that are to touch from the side, for each object.
      lean: f32[n], share of the objects that are to lean.
      may_tip: bool[n], what tips over may stay.
      is_kept: bool[n], objects keep what they lie on, and how they are turned.
    """

    poses: np.ndarray
    is_placed: np.ndarray
    draws: np.ndarray
    region: np.ndarray
    half_extents: np.ndarray
    whole: np.ndarray
    keep_out: np.ndarray
    margin: np.ndarray
    side: np.ndarray
    lean: np.ndarray
    may_tip: np.ndarray
    is_kept: np.ndarray


class Crowder(RestRounds):
    """One block of crowds while they are made.

    Args:
      engine: whose world it is.
      asked: of the block.
    """

    def __init__(self, engine: NativePhysics, asked: CrowdRequest) -> None:
        region = asked.region, asked.half_extents, asked.whole
        super().__init__(engine, asked.is_placed.copy(), *region)
        self.asked = asked
        keep_out = asked.keep_out.astype(np.float64)
        self._box_places = keep_out[..., :2]
        self._box_reaches = reaches_of_boxes(keep_out[..., 2:4], keep_out[..., 4])
        self.max_rounds = _MAX_ROUNDS
        self._tries = np.zeros(len(asked.side), int)

    @property
    def first_round(self) -> Stage:
        """See `RestRounds`: nothing that stands by itself has to be shaken."""
        return super().first_round if self.asked.lean.any() else Stage.REST

    def begin(self, rows: np.ndarray) -> None:
        """Draws the objects of each scene together, from where they were placed, if they are not together."""
        sims = self.plain
        start = self.asked.poses[rows].astype(np.float64)
        self.poses[rows] = start
        is_apart = [not self._is_together(row) for row in rows]
        self.stage[rows] = self.first_round
        rows = rows[is_apart]
        if not rows.size:
            return
        ids = np.arange(len(rows))
        is_member = self.is_member[rows]
        middles = self._middles(rows)
        self._bring_near(rows, middles, is_member)
        sims.release(self.poses[rows], is_member, never_sleeps=is_member)
        with sims.no_friction(TOGETHER.drag, TOGETHER.turning_drag, TOGETHER.time_share):
            self._pull(rows, ids, middles, TOGETHER, self._has_sides)
        is_kept = self.asked.is_kept.any()
        turning_drag = TOGETHER.turning_drag if is_kept else PRESS.turning_drag
        with sims.no_friction(PRESS.drag, turning_drag):
            self._pull(rows, ids, middles, PRESS)
        if (leaning := np.flatnonzero(self.asked.lean[rows] > 0)).size:
            with sims.lower_friction(1.0, LEAN.drag, LEAN.turning_drag):
                self._pull(rows, leaning, middles, LEAN, self._has_leaning)
            with sims.lower_friction(_HOLD_FRICTION, HOLD.drag, HOLD.turning_drag):
                self._pull(rows, leaning, middles, HOLD)
        nothing = np.zeros(is_member.shape)
        sims.push(ids, np.zeros((*nothing.shape, 3)), nothing)
        with sims.lower_friction(1.0, _RELAX_DRAG, _RELAX_DRAG):
            self.advance(sims, rows, ids, _RELAX_STEPS)
        self.rounds[rows] = 0
        self.checks[rows] = 0
        self.give_up_failed(rows, *self.take_poses(sims, rows, ids))
        for row, middle in zip(rows, middles, strict=True):
            if self.stage[row] != Stage.OVER:
                self._stand_again(row, middle)
        self.go_on(rows, self.first_round)

    def _is_together(self, row: int) -> bool:
        """Whether the targets are met where objects were placed: those of whom some were placed again."""
        enough = self.asked.side[row] * self.is_member[row].sum()
        return not self.asked.lean[row] and self.num_beside(row, self.poses[row]) >= enough

    def _bring_near(self, rows: np.ndarray, middles: np.ndarray, is_moving: np.ndarray) -> None:
        """Moves objects as they stand towards the middles of their groups, where there is room.

        What touches, or stands below a rim, is moved together, or not at all.

        Args:
          middles: f64[m, K, 2]; is_moving: bool[m, K], the objects that may move.
        """
        from scipy.sparse.csgraph import connected_components

        probe = self.engine.probe
        start = self.poses[rows]
        is_member = self.is_member[rows]
        reaches = self.engine.outlines.reaches(start)
        places = start[..., :2]
        is_same = gaps_in_plan(places, reaches, places, reaches)[0] <= 0
        is_same &= is_member[:, None] & is_member[..., None]
        for each, pairs in enumerate(is_same):
            _, group = connected_components(pairs, directed=False)
            is_same[each] = group[:, None] == group
        stays = (is_same & (is_member & ~is_moving)[:, None]).any(-1)
        middles = np.where(stays[..., None], places, middles)
        moved = start.copy()
        moved[..., :2] = move_together(
            places, reaches, is_same, is_member, middles, self._boxes(rows), _MOVES
        )
        for row, before, after, there in zip(rows, start, moved, is_member, strict=True):
            depths = probe.depths(before, there)
            if depths is None:
                continue
            deepest = depths + _DEEPER
            depths = probe.depths(after, there)
            if depths is not None and (depths <= deepest).all():
                self.poses[row] = after

    def _boxes(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the boxes to keep out of are, f64[m, B, 2], and how far they reach, f64[m, B, D]."""
        return self._box_places[rows], self._box_reaches[rows]

    def _from_boxes(self, rows: np.ndarray, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gaps in plan from objects at f64[m, K, 7] to the nearest box, f64[m, K], and directions to it."""
        places, reaches = self._boxes(rows)
        own = self.engine.outlines.reaches(poses)
        gaps, towards = gaps_in_plan(poses[..., :2], own, places, reaches)
        nearest = gaps.argmin(-1)[..., None]
        towards = np.take_along_axis(towards, nearest[..., None], axis=2)[:, :, 0]
        return np.take_along_axis(gaps, nearest, axis=2)[..., 0], towards

    def _stand_again(self, row: int, middle: np.ndarray) -> None:
        """Puts what tipped over, is held too little, or climbed where it may not, back where it was placed.

        If there is no room it stands a little farther from the middle of its group, or is left out. From
        there it comes as near as it can.
        """
        poses = self.poses[row]
        climbing = self._climbing(row)
        is_bad = self._has_tipped(np.array([row]))[0] | self._has_climbed(row, climbing)
        if self.engine.probe.depths(poses, self.is_member[row]) is None:
            return
        members = np.flatnonzero(self.is_member[row])
        margins = self.engine.probe.margins(members)
        is_bad[members[margins < self.asked.margin[row, members]]] = True
        if self._box_places.size:
            is_bad |= self._from_boxes(np.array([row]), poses[None])[0][0] < 0
        for index in np.flatnonzero(is_bad):
            placed = self.asked.poses[row, index].astype(np.float64)
            outward = placed[:2] - middle[index]
            outward /= max(np.linalg.norm(outward), 1e-6)
            for away, turn in product(_OUTWARD, _TURNS):
                poses[index] = placed
                poses[index, :2] += away * rotate_in_plane(outward, turn)
                depths = self.engine.probe.depths(poses, self.is_member[row])
                if depths is None or (depths[index, :-1] > 0).any():
                    continue
                climbing = self._climbing(row)
                if not (climbing[index] | climbing[:, index]).any():
                    break
            else:
                self._leave_out(np.array([row]), (np.arange(len(poses)) == index)[None])
        if (is_bad & self.is_member[row]).any():
            self._bring_near(np.array([row]), middle[None], is_bad[None])

    def _has_climbed(self, row: int, climbing: np.ndarray) -> np.ndarray:
        """bool[K]: of two objects of which one climbed on the other, or slipped under it, the smaller one."""
        upper, lower = np.nonzero(climbing)
        area = self.half_extents[row, :, :2].prod(1)
        smaller = np.where(area[upper] < area[lower], upper, lower)
        return np.isin(np.arange(len(area)), smaller)

    def _climbing(self, row: int) -> np.ndarray:
        """bool[K, K]: which objects, by row, lie on which, or just over it, though they were not placed so.

        Nothing does where objects may lie on others.
        """
        is_member = self.is_member[row]
        if not self.asked.is_kept[row]:
            return np.zeros((len(is_member),) * 2, bool)
        probe = self.engine.under_probe
        lies = [
            probe.lies_on()
            for poses in (self.asked.poses[row], self.poses[row])
            if probe.depths(poses, is_member) is not None
        ]
        return lies[1] & ~lies[0] if len(lies) == 2 else np.zeros((len(is_member),) * 2, bool)

    def _has_tipped(self, rows: np.ndarray) -> np.ndarray:
        """bool[m, K]: what tipped over that may not."""
        is_tilted = self._tilts(rows, self.poses[rows]) > TIPS
        return is_tilted & ~self.asked.may_tip[rows, None]

    def _middles(self, rows: np.ndarray) -> np.ndarray:
        """f64[m, K, 2]: the middle of each object's group, in plan: groups of objects near one another."""
        place = self.asked.poses[rows, :, :2].astype(np.float64)
        draws = self.asked.draws[rows, self._tries[rows]]
        middles = np.zeros_like(place)
        for each, is_member in enumerate(self.is_member[rows]):
            members = np.flatnonzero(is_member)
            own = place[each, members]
            size = max(_MIN_GROUP, _GROUP * self.asked.side[rows[each]])
            number = max(1, round(len(members) / size))
            middle = own[np.argsort(-draws[each, members])[:number]]
            group = np.zeros(len(members), int)
            for _ in range(_ROUNDS):
                group = np.linalg.norm(own[:, None] - middle, axis=-1).argmin(1)
                for number in np.unique(group):
                    middle[number] = own[group == number].mean(0)
            middles[each, members] = middle[group]
        return middles

    def _pull(
        self,
        rows: np.ndarray,
        ids: np.ndarray,
        middles: np.ndarray,
        how: Pull,
        is_done: Callable[[int, int], bool] | None = None,
    ) -> None:
        """Draws objects towards the middles of their groups; each further try is slower.

        Args:
          rows: scenes of all simulations; ids: the simulations that are meant.
          is_done: of a scene and its simulation, whether it has enough; None to make all steps.
        """
        sims = self.plain
        for step in range(0, how.most_steps, _STRIDE):
            poses = sims.poses(ids)
            away = middles[ids] - poses[..., :2]
            distance = np.linalg.norm(away, axis=-1, keepdims=True)
            strength = how.strength / (self._tries[rows[ids], None, None] + 1)
            pull = strength * away / np.maximum(distance, _NEAR)
            if self._box_places.size:
                pull = _turned_from(*self._from_boxes(rows[ids], poses), pull, strength)
            pull = np.where(self.is_member[rows[ids], :, None], pull, 0.0)
            lever = how.height * reach_of(poses[..., 3:], self.half_extents[rows[ids]])[..., 2]
            sims.push(ids, np.concatenate([pull, np.zeros_like(pull[..., :1])], axis=-1), lever)
            self.advance(sims, rows[ids], ids, _STRIDE)
            if is_done is None or step + _STRIDE < _FIRST_LOOK:
                continue
            is_left = [not is_done(row, each) for row, each in zip(rows[ids], ids, strict=True)]
            ids = ids[np.array(is_left)]
            if not ids.size:
                break

    def _has_sides(self, row: int, simulation: int) -> bool:
        poses = self.plain.poses(np.array([simulation]))[0]
        return self.num_beside(row, poses) >= self.asked.side[row] * self.is_member[row].sum()

    def _has_leaning(self, row: int, simulation: int) -> bool:
        poses = self.plain.poses(np.array([simulation]))
        is_leaning = self._tilts(np.array([row]), poses)[0] > LEANS
        return is_leaning.sum() >= _LEANING_FIRST * self.asked.lean[row] * self.is_member[row].sum()

    def _tilts(self, rows: np.ndarray, poses: np.ndarray) -> np.ndarray:
        """f64[m, K]: radians between what was upwards of each object as it was placed, and upwards."""
        placed = self.asked.poses[rows].astype(np.float64)
        up = rotate(np, placed[..., 3:] * [1, -1, -1, -1], np.array([0.0, 0.0, 1.0]))
        height = np.clip(rotate(np, poses[..., 3:], up)[..., 2], -1.0, 1.0)
        return np.where(self.is_member[rows], np.arccos(height), 0.0)

    def go_on(self, rows: np.ndarray, stage: Stage) -> None:
        """See `RestRounds`; what tipped over, where it may not, is left out."""
        rows = rows[self.stage[rows] != Stage.OVER]
        self._leave_out(rows, self._has_tipped(rows))
        super().go_on(rows, stage)

    def _leave_out(self, rows: np.ndarray, which: np.ndarray) -> None:
        """From now on the objects bool[m, K] are not in their scenes."""
        self.result.is_left_out[rows] |= which
        self.is_member[rows] &= ~which

    def rest(self, rows: np.ndarray) -> None:
        """See `RestRounds`: what is at rest already is judged at once."""
        self.go_on(rows, Stage.REST)
        is_good = self.judge(rows, is_brief=True) == int(Verdict.STABLE)
        self.result.verdict[rows[is_good]] = int(Verdict.STABLE)
        self.stage[rows[is_good]] = Stage.OVER
        if not is_good.all():
            super().rest(rows[~is_good])

    def begin_again(self, rows: np.ndarray, which: np.ndarray, verdict: np.ndarray) -> None:
        """See `RestRounds`: what lies outside, or does not come to rest, is left out."""
        self._leave_out(rows, which)
        self.rounds[rows] = 0

    def renew(self) -> None:
        """See `RestRounds`: what was given up begins again in other groups, while tries are left."""
        is_left = self._tries + 1 < self.asked.draws.shape[1]
        is_failed = (self.stage == Stage.OVER) & (self.result.verdict != int(Verdict.STABLE))
        is_due = is_failed & is_left
        self._tries[is_due] += 1
        self.stage[is_due] = Stage.BEGIN
        self.result.verdict[is_due] = int(Verdict.NONE)
        self.result.is_left_out[is_due] = False
        self.is_member[is_due] = self.asked.is_placed[is_due]

    def look_at_rest(self) -> None:
        """See `RestRounds`; and counts what leans, and looks how well each object is supported."""
        super().look_at_rest()
        for row in np.flatnonzero(self.result.verdict == int(Verdict.STABLE)):
            members = np.flatnonzero(self.is_member[row])
            self.engine.probe.depths(self.poses[row], self.is_member[row])
            self.result.margin[row, members] = self.engine.probe.margins(members)
        is_leaning = self._tilts(np.arange(len(self.poses)), self.poses) > LEANS
        self.result.num_leaning[:] = is_leaning.sum(1)


def _turned_from(
    gap: np.ndarray, towards: np.ndarray, pull: np.ndarray, strength: np.ndarray
) -> np.ndarray:
    """Pulls, f64[m, K, 2], of which what draws objects nearer to a box near them is turned round."""
    along = (pull * towards).sum(-1, keepdims=True)
    pushed = (
        pull
        - np.maximum(along, 0.0) * towards
        - strength * (1 - gap / _NEAR_BOX)[..., None] * towards
    )
    return np.where((gap < _NEAR_BOX)[..., None], pushed, pull)
