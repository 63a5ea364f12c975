"""Objects dropped one after another: the loop that one writes in plain MuJoCo, written to be quick.

It is the rival that tables compare with. A free spot is looked for with MuJoCo's own contacts before anything
is simulated; where there is none the object is lifted over what it touches until it is free. Then it is let
go among the others, which sleep until they are touched. What does not come to rest, disturbs others or ends
outside is taken back and tried again; so is, where a support margin is asked for, what lacks it.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from queue import SimpleQueue
from threading import Lock
from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np

from cluttergen_jax.geometry import product, rotate
from cluttergen_jax.physics.margin import MIN_SHIFT
from cluttergen_jax.physics.resting import RestRounds, Stage, reach_of
from cluttergen_jax.physics.standing import displacement
from cluttergen_jax.types import Piling, Verdict

if TYPE_CHECKING:
    from cluttergen_jax.physics.native import NativePhysics

MAX_SPOTS = 100
"""Spots that are looked at before an object is lifted."""
RELEASE = 0.001
"""Metres above what is below."""
LIFT = 0.005
"""Metres of a step in which an object is lifted; after `MAX_LIFTS` of them its attempt has failed."""
MAX_LIFTS = 100


class DropRequest(NamedTuple):
    """What is dropped, for n scenes. K objects in the compiled world, S slots.

    Attributes:
      order: i32[n, S], objects in the order of their release, -1 for none.
      seed: u32[n, 2], of all that is drawn in a scene.
      region: f32[n, 9], its world pose and its half extents.
      half_extents: f32[n, K, 3], of the objects' boxes, metres.
      whole: f32[n], 1 where a box must lie in the region whole, 0 where its centre must.
      margins: f32[n, K], metres, the support margin asked of each object; -inf for none.
      max_attempts: i32[n], at each object.
      budget: i32[n], attempts of a scene at most.
    """

    order: np.ndarray
    seed: np.ndarray
    region: np.ndarray
    half_extents: np.ndarray
    whole: np.ndarray
    margins: np.ndarray
    max_attempts: np.ndarray
    budget: np.ndarray


class Bench(NamedTuple):
    """A model of one thread's own, whose reference poses change, and its data."""

    model: mujoco.MjModel
    data: mujoco.MjData


class Dropper(RestRounds):
    """One block of scenes while they are made.

    Args:
      engine: whose world it is.
      benches: one for each thread.
      asked: of the block.
    """

    def __init__(self, engine: NativePhysics, benches: list[Bench], asked: DropRequest) -> None:
        is_slot = asked.order >= 0
        is_member = np.zeros((len(is_slot), engine.layout.num_objects), bool)
        is_member[np.arange(len(is_slot))[:, None], np.maximum(asked.order, 0)] |= is_slot
        super().__init__(engine, is_member, asked.region, asked.half_extents, asked.whole)
        self.asked = asked
        self._probing = Lock()
        self._benches = benches
        self._idle: SimpleQueue[Bench] = SimpleQueue()
        for each in benches:
            self._idle.put(each)

    def run(self) -> Piling:
        """Makes every scene of the block, or finds that it cannot be made."""
        rows = np.arange(len(self.is_member))
        with ThreadPoolExecutor(len(self._benches)) as threads:
            verdicts = np.array(list(threads.map(self._make, rows.tolist())), np.int32)
        self.result.verdict[:] = verdicts
        self.stage[:] = int(Stage.OVER)
        filled = rows[verdicts == int(Verdict.STABLE)]
        if filled.size:
            self._stand(filled)
        self.look_at_rest()
        self.result.poses[:] = np.where(self.is_member[..., None], self.poses, 0.0)
        return self.result

    def _stand(self, rows: np.ndarray) -> None:
        """The last check, which is that of every method."""
        poses = self.poses[rows].astype(np.float32)
        is_asked = np.ones(len(rows), bool)
        standing = self.engine.stand_block(poses, self.is_member[rows], is_asked)
        self.poses[rows] = poses
        self.result.verdict[rows] = standing.verdict
        self.result.check_steps[rows] = standing.num_steps
        self.result.drift[rows] = standing.shift.max(1)

    def _make(self, row: int) -> int:
        """Drops the objects of a scene; its verdict before the last check."""
        rng = np.random.default_rng(self.asked.seed[row])
        is_there = np.zeros(self.engine.layout.num_objects, bool)
        with self._bench() as bench:
            for index in self.asked.order[row][self.asked.order[row] >= 0].tolist():
                is_there[index] = True
                verdict = Verdict.NONE
                for _ in range(int(self.asked.max_attempts[row])):
                    if self.result.releases[row].sum() >= self.asked.budget[row]:
                        break
                    verdict = self._attempt(bench, row, index, is_there, rng)
                    if verdict == Verdict.STABLE:
                        break
                    self.result.rejected[row, verdict] += 1
                if verdict != Verdict.STABLE:
                    self.result.is_left_out[row] = self.is_member[row] & ~is_there
                    self.result.is_left_out[row, index] = True
                    return int(Verdict.UNSETTLED if verdict == Verdict.NONE else verdict)
        return int(Verdict.STABLE)

    @contextmanager
    def _bench(self) -> Iterator[Bench]:
        bench = self._idle.get()
        try:
            yield bench
        finally:
            self._idle.put(bench)

    def _attempt(
        self,
        bench: Bench,
        row: int,
        index: int,
        is_there: np.ndarray,
        rng: np.random.Generator,
    ) -> Verdict:
        """Lets go of one object; where it is stable the scene's poses are as it left them."""
        self.result.releases[row, index] += 1
        start = np.where(is_there[:, None], self.poses[row], self.engine.layout.parked)
        bench.model.qpos0[:] = start.ravel()
        bench.model.tree_sleep_policy[:] = mujoco.mjtSleepPolicy.mjSLEEP_INIT
        bench.model.tree_sleep_policy[index] = mujoco.mjtSleepPolicy.mjSLEEP_NEVER
        mujoco.mj_resetData(bench.model, bench.data)
        if not self._find_room(bench, row, index, rng):
            return Verdict.PENETRATING
        start = bench.data.qpos.reshape(-1, 7).copy()
        verdict = self._settle(bench, row, index, is_there, start)
        if verdict != Verdict.STABLE:
            return verdict
        before = self.poses[row].copy()
        self.poses[row] = np.where(is_there[:, None], bench.data.qpos.reshape(-1, 7), before)
        is_outside, is_below = self._outside(np.array([row]))
        if (is_below & is_there).any():
            verdict = Verdict.FELL
        elif (is_outside & is_there).any():
            verdict = Verdict.OUTSIDE
        elif not self._is_supported(row, index, is_there, start):
            verdict = Verdict.UNSUPPORTED
        if verdict != Verdict.STABLE:
            self.poses[row] = before
        return verdict

    def _is_supported(self, row: int, index: int, is_there: np.ndarray, start: np.ndarray) -> bool:
        """Whether all that is there has the margin that is asked of it; what did not move had it before."""
        asked = self.asked.margins[row]
        if not np.isfinite(asked[is_there]).any():
            return True
        shift, _ = displacement(np, self.poses[row], start)
        is_moved = is_there & (shift >= MIN_SHIFT)
        is_moved[index] = True
        # One probe serves all threads.
        with self._probing:
            found = self.engine.at_rest(start, self.poses[row], is_there, index, is_moved)
        return found is not None and not (is_there & (found.margin < asked)).any()

    def _find_room(self, bench: Bench, row: int, index: int, rng: np.random.Generator) -> bool:
        """Puts the object where it touches nothing: on a free spot, or lifted over what it touches."""
        own = bench.data.qpos[7 * index : 7 * index + 7]
        crowded = None
        for _ in range(MAX_SPOTS):
            own[:] = self._draw_spot(row, index, rng)
            touches_support, touches_object = self._touches(bench, index)
            if not touches_support and not touches_object:
                return True
            if not touches_support:
                crowded = own.copy()
        if crowded is None:
            return False
        own[:] = crowded
        for _ in range(MAX_LIFTS):
            own[2] += LIFT
            touches_support, touches_object = self._touches(bench, index)
            if touches_support:
                return False
            if not touches_object:
                return True
        return False

    def _draw_spot(self, row: int, index: int, rng: np.random.Generator) -> np.ndarray:
        """f64[7]: upright on the support, at a random turn, within the region."""
        region = self.asked.region[row].astype(np.float64)
        half = self.asked.half_extents[row, index].astype(np.float64)
        yaw = rng.uniform(0, 2 * np.pi)
        turn = np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])
        room = np.maximum(region[7:] - self.asked.whole[row] * reach_of(turn, half)[:2], 0.0)
        local = np.append(rng.uniform(-room, room), 0.0)
        position = region[:3] + rotate(np, region[3:7], local)
        position[2] = self.engine.layout.top + half[2] + RELEASE
        return np.concatenate([position, product(region[3:7], turn)])

    def _touches(self, bench: Bench, index: int) -> tuple[bool, bool]:
        """Whether the object touches the support, and whether another object."""
        mujoco.mj_kinematics(bench.model, bench.data)
        mujoco.mj_comPos(bench.model, bench.data)
        mujoco.mj_collision(bench.model, bench.data)
        pairs = self.engine.layout.geom_object[bench.data.contact.geom]
        pairs = pairs[(pairs == index).any(axis=1)]
        is_support = (pairs == self.engine.layout.num_objects).any(axis=1)
        return bool(is_support.any()), bool((~is_support).any())

    def _settle(
        self, bench: Bench, row: int, index: int, is_there: np.ndarray, start: np.ndarray
    ) -> Verdict:
        """Steps until the object has been quiet for long enough, or cannot be any more."""
        config = self.engine.config
        data = bench.data
        velocity = data.qvel[6 * index : 6 * index + 6]
        is_neighbour = is_there.copy()
        is_neighbour[index] = False
        before = np.zeros(6)
        num_quiet = 0
        for step in range(1, config.max_steps + 1):
            mujoco.mj_step(bench.model, data)
            self.result.num_steps[row] += 1
            self.result.steps[row, index] += 1
            change = (velocity - before) / config.timestep
            before = velocity.copy()
            is_quiet = (
                np.linalg.norm(velocity[:3]) < config.max_speed
                and np.linalg.norm(velocity[3:]) < config.max_angular_speed
                and np.linalg.norm(change[:3]) < config.max_acceleration
                and np.linalg.norm(change[3:]) < config.max_angular_acceleration
            )
            num_quiet = num_quiet + 1 if is_quiet else 0
            is_done = num_quiet == config.quiet_steps
            if not is_done and step % config.quiet_steps:
                continue
            shift, turn = displacement(np, data.qpos.reshape(-1, 7), start)
            moved = (shift > config.max_shift) | (turn > config.max_turn)
            if config.judge_neighbours and (moved & is_neighbour).any():
                return Verdict.DISPLACED
            if is_done:
                return Verdict.STABLE
            if not np.isfinite(data.qpos).all():
                return Verdict.NON_FINITE
        return Verdict.UNSETTLED
