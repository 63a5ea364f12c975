"""Piles: objects let fall one after another between walls of air, brought to rest, and let fall again.

Of each scene the objects are let go between four unseen walls around the region, in any orientation, each
above all that is there, with little friction and some drag. Then the walls are gone, and it is settled in
rounds that begin without velocity, as loading a file does: two with less friction, so that what would barely
hold does not, then as many as it takes until one moves nothing. What lies outside is let fall again, and so
is what does not come to rest.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cluttergen_jax.config import AIR_WALLS
from cluttergen_jax.geometry import product, rotate
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.resting import RestRounds, Stage, reach_of
from cluttergen_jax.physics.simulations import Simulations, damping_of, sleeping_model
from cluttergen_jax.types import Verdict

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


class Piler(RestRounds):
    """One block of piles while they are made.

    Args:
      engine: whose world it is.
      walled: simulations between walls, at least as many as there are scenes.
      asked: of the block.
    """

    def __init__(self, engine: NativePhysics, walled: Simulations, asked: PileRequest) -> None:
        is_slot = asked.order >= 0
        rows = np.arange(len(is_slot))
        is_member = np.zeros((len(is_slot), engine.layout.num_objects), bool)
        is_member[rows[:, None], np.maximum(asked.order, 0)] |= is_slot
        super().__init__(engine, is_member, asked.region, asked.half_extents, asked.whole)
        self.walled = walled
        self.asked = asked
        self.is_pending = is_member.copy()

    def begin(self, rows: np.ndarray) -> None:
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
            self.latest[rows[at]] = which
            self.advance(sims, rows[at], at, GAP)
        self.advance(sims, rows, ids, FALL)
        self.is_pending[rows] = False
        self.rounds[rows] = 0
        self.give_up_failed(rows, *self.take_poses(sims, rows, ids))
        self.go_on(rows, self.first_round)

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
        own = reach_of(turn, half[np.arange(len(rows)), which])
        room = np.maximum(region[:, 7:] - own[:, :2] - _INSET, 0.0)
        local = np.concatenate([draw[:, 4:] * room, np.zeros((len(rows), 1))], axis=1)
        xy = (region[:, :3] + rotate(np, region[:, 3:7], local))[:, :2]
        quaternion = product(region[:, 3:7], turn)
        own = reach_of(quaternion, half[np.arange(len(rows)), which])
        others = reach_of(poses[..., 3:], half)
        gap = np.abs(poses[..., :2] - xy[:, None]) - others[..., :2] - own[:, None, :2]
        is_below = is_there & (gap < 0).all(-1)
        top = np.where(is_below, poses[..., 2] + others[..., 2], self.engine.layout.top).max(1)
        return np.concatenate([xy, (top + own[:, 2] + _GAP_ABOVE)[:, None], quaternion], axis=1)

    def begin_again(self, rows: np.ndarray, which: np.ndarray, verdict: np.ndarray) -> None:
        """Lets go of objects, bool[n, K], once more; or gives up scenes in which that was done too often."""
        releases = self.result.releases[rows]
        most = self.asked.draws.shape[1]
        is_spent = (which & (releases >= most)).any(1)
        is_spent |= releases.sum(1) + which.sum(1) > self.asked.budget[rows]
        self.is_pending[rows] = which
        self.stage[rows] = Stage.BEGIN
        for row, each in zip(rows[is_spent], verdict[is_spent], strict=True):
            self.give_up(np.array([row]), Verdict(int(each)))
