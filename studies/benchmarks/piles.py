"""Piles in a bin, made by this package and by the same loop on PyBullet, side by side in one run.

python -m studies.benchmarks.piles [--support bin] [--num-objects 15] [--num-scenes 32] [--write]

PyBullet gets the loop of `physics.piles` word for word: the same objects, draws, walls of air, rounds and
limits, and the staged last check. It is made as fast as its interface allows: rigid bodies, one call a step
and nothing read between steps, what waits is asleep. It has one detector, so that the round and the check
with a second one fall away. Both have one thread; counted are the CPU-seconds of the process.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import tyro

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.config import PILE_NOSLIP, ContactConfig, StabilityConfig
from cluttergen_jax.geometry import rotate
from cluttergen_jax.physics.native import NativePhysics
from cluttergen_jax.physics.piles import DRAG, FRICTION, TURNING_DRAG, Piler, PileRequest
from cluttergen_jax.placement.world import World, make_world
from cluttergen_jax.types import Piling, Standing, Verdict
from studies.benchmarks.bullet import BulletPhysics, pybullet
from studies.benchmarks.section import prose, report, table
from studies.measures.bullet_world import object_friction, support_friction

_MAX_ATTEMPTS = 5


@dataclass(frozen=True)
class Piles:
    """Make the same piles with both.

    Attributes:
      pool: of the objects.
      max_radius: metres; larger objects are left out.
      support: what they are piled into.
      num_objects: of a pile.
      num_scenes: of each contender.
      seed: of the draws.
      write: renew this program's section of reports/benchmarks.md.
    """

    pool: str = "all"
    max_radius: float = 0.11
    support: str = "bin"
    num_objects: int = 15
    num_scenes: int = 32
    seed: int = 0
    write: bool = False

    def run(self) -> None:
        """Prints the table."""
        report("piles", body_of(compete(self), self), write=self.write)


@dataclass(frozen=True)
class Turn:
    """What a contender did.

    Attributes:
      piling: of all scenes; seconds: of the process's CPU time.
    """

    piling: Piling
    seconds: float

    @property
    def rate(self) -> float:
        """Piles that stand, by its own check, per CPU-second."""
        return self.num_stable / self.seconds

    @property
    def num_stable(self) -> int:
        """How many stand."""
        return int((self.piling.verdict == int(Verdict.STABLE)).sum())


def compete(args: Piles) -> dict[str, Turn]:
    """Both contenders, block by block in turn, so that what else the machine does troubles both alike."""
    objects = [each for each in find_pool(args.pool).objects if each.radius <= args.max_radius]
    support = find_support(args.support)
    contact = ContactConfig(noslip_iterations=PILE_NOSLIP)
    both = StabilityConfig(both_detectors=True)
    world = make_world(objects, support, both, contact)
    ours = NativePhysics(world.layout, both, num_threads=1)
    theirs = BulletPiles(world, replace(both, both_detectors=False), contact)
    asked = draw_requests(world, args)
    parts: dict[str, list[Piling]] = {"cluttergen_jax": [], "PyBullet": []}
    seconds = dict.fromkeys(parts, 0.0)
    # The first of each compiles and allocates what it keeps.
    ours.make_batch("pile", *_rows(asked, slice(0, 1)))
    theirs.pile_batch(_rows(asked, slice(0, 1)))
    for start in range(0, args.num_scenes, 8):
        rows = _rows(asked, slice(start, start + 8))
        for name, make in (
            ("cluttergen_jax", lambda r: ours.make_batch("pile", *r)),
            ("PyBullet", theirs.pile_batch),
        ):
            began = time.process_time()
            parts[name].append(make(rows))
            seconds[name] += time.process_time() - began
    theirs.close()
    return {name: Turn(_joined(parts[name]), seconds[name]) for name in parts}


def draw_requests(world: World, args: Piles) -> list[np.ndarray]:
    """The arrays of a `PileRequest`, and that all scenes are active."""
    rng = np.random.default_rng(args.seed)
    num = args.num_scenes
    num_objects = world.num_objects
    region = world.support.region
    support = world.support
    shape = (num, _MAX_ATTEMPTS, args.num_objects)
    place = (*region.center, support.top, 1, 0, 0, 0, *region.half_extents)
    half = np.stack([asset.half_extents for asset in world.objects])
    return [
        np.stack([rng.permutation(num_objects)[: args.num_objects] for _ in range(num)]).astype(
            np.int32
        ),
        np.concatenate([rng.normal(size=(*shape, 4)), rng.uniform(-1, 1, (*shape, 2))], -1).astype(
            np.float32
        ),
        np.tile(np.array(place, np.float32), (num, 1)),
        np.tile(half.astype(np.float32), (num, 1, 1)),
        np.zeros(num, np.float32),
        np.full(num, _MAX_ATTEMPTS * args.num_objects, np.int32),
        np.ones(num, bool),
    ]


def _rows(asked: Sequence[np.ndarray], rows: slice) -> list[np.ndarray]:
    return [each[rows] for each in asked]


def _joined(parts: list[Piling]) -> Piling:
    names = Piling.__dataclass_fields__
    return Piling(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    )


class BulletPiles:
    """An engine for `Piler` on PyBullet."""

    def __init__(self, world: World, config: StabilityConfig, contact: ContactConfig) -> None:
        self.layout = world.layout
        self.config = config
        self.probe = _NoProbe(world.num_objects)
        self._plain = BulletSimulations(world, config, contact)
        self._walled = BulletSimulations(world, config, contact, is_walled=True)

    def pile_batch(self, arrays: Sequence[np.ndarray]) -> Piling:
        """As `NativePhysics.pile_batch`."""
        return Piler(self, self._walled, PileRequest(*arrays[:-1])).run()  # type: ignore[arg-type]

    def simulations(self, num_scenes: int) -> BulletSimulations:
        """See `NativePhysics`."""
        return self._plain

    def stand_block(
        self,
        poses: np.ndarray,
        is_placed: np.ndarray,
        is_active: np.ndarray,
        is_brief: bool = False,
    ) -> Standing:
        """See `NativePhysics`; nothing here is brief."""
        assert not is_brief
        return self._plain.stand_batch(poses, is_placed, is_active)

    def close(self) -> None:
        """Ends both."""
        self._plain.close()
        self._walled.close()


class BulletSimulations(BulletPhysics):
    """`physics.simulations.Simulations` on PyBullet, as far as piles need them."""

    def __init__(
        self, world: World, config: StabilityConfig, contact: ContactConfig, is_walled: bool = False
    ) -> None:
        super().__init__(world, config, contact, tuned=True)
        self._is_walled = is_walled
        self._walls = (np.zeros((0, 4, 3)), np.zeros((0, 4, 4)))
        self._bodies: dict[int, list[int]] = {}

    def release(
        self,
        poses: np.ndarray,
        is_placed: np.ndarray,
        never_sleeps: np.ndarray,
        parked: np.ndarray | None = None,
    ) -> np.ndarray:
        """See `Simulations`."""
        self._make_room(len(poses))
        for row, client in enumerate(self._clients[: len(poses)]):
            # What is where it should be may still move.
            client.poses[is_placed[row]] = np.nan
            self._arrange(client, poses[row], is_placed[row])
            self._activate(
                client, np.flatnonzero(is_placed[row]).tolist(), pybullet.ACTIVATION_STATE_WAKE_UP
            )
            if self._is_walled:
                self._put_walls(client.id, row)
        return poses

    def rouse(self, ids: np.ndarray, objects: np.ndarray, poses: np.ndarray) -> None:
        """See `Simulations`."""
        for row, index, pose in zip(ids.tolist(), objects.tolist(), poses, strict=True):
            self._put(self._clients[row], [index], pose[None])
            self._activate(self._clients[row], [index], pybullet.ACTIVATION_STATE_WAKE_UP)

    def planes(self, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """See `Simulations`."""
        self._walls = np.zeros((64, len(names), 3)), np.zeros((64, len(names), 4))
        return self._walls

    def _put_walls(self, client: int, row: int) -> None:
        for body in self._bodies.pop(client, []):
            pybullet.removeBody(body, physicsClientId=client)
        self._bodies[client] = []
        for position, quaternion in zip(*(each[row] for each in self._walls), strict=True):
            normal = rotate(np, quaternion, np.array([0.0, 0.0, 1.0])).tolist()
            shape = pybullet.createCollisionShape(
                pybullet.GEOM_PLANE, planeNormal=normal, physicsClientId=client
            )
            body = pybullet.createMultiBody(0, shape, -1, position.tolist(), physicsClientId=client)
            pybullet.changeDynamics(body, -1, lateralFriction=0.0, physicsClientId=client)
            self._bodies[client].append(body)

    def advance(self, ids: np.ndarray, num_steps: int) -> None:
        """See `Simulations`."""
        step = pybullet.stepSimulation
        for row in ids.tolist():
            client = self._clients[row].id
            for _ in range(num_steps):
                step(physicsClientId=client)

    def poses(self, ids: np.ndarray) -> np.ndarray:
        """See `Simulations`."""
        for row in ids.tolist():
            self._find(self._clients[row], list(range(self._world.num_objects)))
        return np.stack([self._clients[row].poses for row in ids.tolist()]).astype(np.float64)

    def failures(self, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Simulations`."""
        return np.zeros(len(ids), bool), np.isfinite(self.poses(ids)).all((1, 2))

    @contextmanager
    def eased(self, friction: float, drag: float, turning_drag: float) -> Iterator[None]:
        """See `Simulations`."""
        self._ease(friction, drag, turning_drag)
        try:
            yield
        finally:
            self._ease(1.0, 0.0, 0.0)

    def _ease(self, friction: float, drag: float, turning_drag: float) -> None:
        """PyBullet multiplies the coefficients of two bodies: the objects have the root of the factor."""
        scale = float(np.sqrt(friction))
        for client in self._clients:
            for body, asset in zip(client.bodies, self._world.objects, strict=True):
                # Its damping is a share of the velocity that is lost in a second.
                pybullet.changeDynamics(
                    body,
                    -1,
                    lateralFriction=scale * object_friction(asset, self._contact),
                    linearDamping=1 - np.exp(-drag),
                    angularDamping=1 - np.exp(-turning_drag),
                    physicsClientId=client.id,
                )
            pybullet.changeDynamics(
                0,
                -1,
                lateralFriction=scale * support_friction(self._contact),
                physicsClientId=client.id,
            )

    def _new_client(self) -> Any:
        client = super()._new_client()
        for body, asset in zip(client.bodies, self._world.objects, strict=True):
            # PyBullet's own damping, 0.04, is none of the recipe.
            drag, turning, friction = (
                (DRAG, TURNING_DRAG, FRICTION) if self._is_walled else (0.0, 0.0, 1.0)
            )
            pybullet.changeDynamics(
                body,
                -1,
                linearDamping=1 - np.exp(-drag),
                angularDamping=1 - np.exp(-turning),
                lateralFriction=friction * object_friction(asset, self._contact),
                physicsClientId=client.id,
            )
        return client


class _NoProbe:
    """Contacts of piles that stand: PyBullet's are not asked for."""

    def __init__(self, num_objects: int) -> None:
        self._none = np.zeros((num_objects + 1, num_objects + 1))

    def depths(self, poses: np.ndarray, is_placed: np.ndarray) -> np.ndarray:
        """See `OverlapProbe`."""
        return self._none

    def bearers(self, index: int) -> np.ndarray:
        """See `OverlapProbe`."""
        return self._none[0, :-1] > 0


_HEADER = (
    "engine",
    "stand",
    "verdicts",
    "steps",
    "CPU-s a scene",
    "piles that stand per CPU-second",
    "ratio",
)
_TEXT = prose(
    """The same loop on both engines: `physics.piles`, the same objects, draws, walls of air, rounds and
    limits; each judged by its own last check. One thread each, block by block in turn in one run, CPU time of
    the process. PyBullet: rigid bodies, one call a step, nothing read between steps."""
)


def body_of(turns: dict[str, Turn], args: Piles) -> str:
    """The section."""
    rows = []
    for name, turn in turns.items():
        verdicts = Counter(Verdict(int(each)).label for each in turn.piling.verdict)
        steps = float((turn.piling.num_steps + turn.piling.check_steps).mean())
        rows.append(
            [
                name,
                f"{turn.num_stable} of {args.num_scenes}",
                ", ".join(f"{number} {label}" for label, number in verdicts.most_common()),
                f"{steps:.0f}",
                f"{turn.seconds / args.num_scenes:.2f}",
                f"{turn.rate:.2f}",
                f"{turn.rate / turns['PyBullet'].rate:.1f}"
                if turns["PyBullet"].num_stable
                else "-",
            ]
        )
    which = f"pool {args.pool} up to {args.max_radius:g} m in radius"
    what = f"{args.num_objects} objects of {which}, {args.support}."
    return "\n\n".join(["## Piles", _TEXT, what, table(_HEADER, rows)])


if __name__ == "__main__":
    tyro.cli(Piles).run()
