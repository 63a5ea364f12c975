"""Engines against one another: steps, whole attempts and finished scenes per CPU-second.

Scenes of ten objects by `clear`: native and PyBullet take turns in one process, with the same rules, keys
and method, so that the ratios mean something on a busy machine. Then the same recorded attempts are given to
native, MJX on Warp and MJX on JAX. CPU time is that of the whole process, all threads.

    python -m studies.benchmarks.engines [--rounds N] [--write]
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import tyro

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.physics.host import BatchEngine
from cluttergen_jax.physics.native import NativePhysics
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.problem import region_of
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.world import World, geometry_of, make_world
from studies.benchmarks import bullet
from studies.benchmarks.host import TimedPhysics
from studies.benchmarks.recorded import Replay, record, replay, small_attempts
from studies.benchmarks.sampled import Sampler, make_block_sampler, placed_poses
from studies.benchmarks.section import prose, report, table


@dataclass(frozen=True)
class Engines:
    """Compare engines.

    Attributes:
      pool: name or folder.
      support: where `clear` places the objects.
      num_scenes: scenes of each round and engine; native has them side by side.
      num_clients: PyBullet's clients, each of which takes 30 MB: so many scenes side by side there.
      rounds: how often the engines take turns.
      num_awake: scenes stepped with everything awake.
      num_replayed: attempts given to MJX; 0 leaves MJX out.
      write: renew this program's section of reports/benchmarks.md.
    """

    pool: str = "dining"
    support: str = "table"
    num_scenes: int = 128
    num_clients: int = 16
    rounds: int = 5
    num_awake: int = 16
    num_replayed: int = 64
    write: bool = False


@dataclass(frozen=True)
class Turn:
    """One engine's turn: CPU seconds of the whole program and of the engine alone, and what came of it."""

    program_seconds: float
    settle_seconds: float
    stand_seconds: float
    num_attempts: int
    num_scenes: int
    num_settle_steps: int

    @property
    def attempts(self) -> float:
        """Whole attempts per CPU-second, engine alone."""
        return self.num_attempts / self.settle_seconds

    @property
    def steps(self) -> float:
        """Steps of attempts per CPU-second, engine alone."""
        return self.num_settle_steps / self.settle_seconds

    @property
    def engine_scenes(self) -> float:
        """Finished scenes per CPU-second, last check included, engine alone."""
        return self.num_scenes / (self.settle_seconds + self.stand_seconds)

    @property
    def scenes(self) -> float:
        """Finished scenes per CPU-second of the whole program."""
        return self.num_scenes / self.program_seconds


@dataclass
class Contender:
    """An engine in the comparison, and its turns.

    Attributes:
      engine: behind the physics interface.
      sample: makes scenes with whatever engine is in use, as many side by side as suit this one.
      awake_steps: steps per CPU-second of whole scenes, everything awake.
      success: share of scenes that were finished, over all turns.
    """

    engine: BatchEngine
    sample: Sampler
    turns: list[Turn] = field(default_factory=list)
    awake_steps: float = np.nan
    success: float = np.nan


def main(args: Engines) -> None:
    """Runs the comparison and prints it."""
    contenders = compete(args)
    replays = [] if args.num_replayed == 0 else replay_all(args)
    report("engines", body_of(contenders, replays, args), write=args.write, packages=_PACKAGES)


_PACKAGES = ("mujoco", "mujoco-mjx", "jax", "warp-lang", "pybullet")


def make_contenders(world: World, rules: Rules, args: Engines) -> dict[str, Contender]:
    """Native with one thread comes first: the others are compared with it."""
    stability = rules.physics.config
    contact = ContactConfig()
    sample = make_block_sampler(rules, "clear", block_size=args.num_scenes)
    contenders = {
        "native, 1 thread": Contender(
            NativePhysics(world.layout, stability, num_threads=1), sample
        ),
        "native, all threads": Contender(NativePhysics(world.layout, stability), sample),
    }
    if bullet.pybullet is not None:
        sample = make_block_sampler(
            rules, "clear", block_size=min(args.num_clients, args.num_scenes)
        )
        for tuned in (True, False):
            name = f"PyBullet, {'tuned' if tuned else 'plain'}"
            contenders[name] = Contender(
                bullet.BulletPhysics(world, stability, contact, tuned), sample
            )
    return contenders


def compete(args: Engines) -> dict[str, Contender]:
    """The engines take turns at making scenes."""
    stability = StabilityConfig()
    support = find_support(args.support)
    world = make_world(find_pool(args.pool).objects, support, stability, ContactConfig())
    physics = TimedPhysics(world.num_objects, stability)
    placement = PlacementConfig(num_objects=min(10, world.num_objects), history_stride=0)
    rules = Rules(placement, physics, geometry_of(world), region_of(support.region, support))
    contenders = make_contenders(world, rules, args)
    for contender in contenders.values():
        contender.awake_steps = _awake_steps(contender, physics, args, world)
    for seed in range(1, args.rounds + 1):
        for contender in contenders.values():
            contender.turns.append(_turn(contender, physics, args.num_scenes, seed))
    for contender in contenders.values():
        finished = sum(turn.num_scenes for turn in contender.turns)
        contender.success = finished / (args.num_scenes * args.rounds)
        if isinstance(contender.engine, bullet.BulletPhysics):
            contender.engine.close()
    return contenders


def _turn(contender: Contender, physics: TimedPhysics, num_scenes: int, seed: int) -> Turn:
    physics.use(contender.engine)
    started = time.process_time()
    scenes = contender.sample(num_scenes, seed)
    return Turn(
        program_seconds=time.process_time() - started,
        settle_seconds=physics.settle_seconds,
        stand_seconds=physics.stand_seconds,
        num_attempts=int(scenes.counts.attempts.sum()),
        num_scenes=int(scenes.is_success.sum()),
        num_settle_steps=int(scenes.counts.steps.sum()),
    )


def _awake_steps(contender: Contender, physics: TimedPhysics, args: Engines, world: World) -> float:
    """Steps per CPU-second of filled scenes, everything awake, for the length of the full last check.

    The scenes are made by the engine itself, which compiles what is to be timed later.
    """
    engine = contender.engine
    config = physics.config
    physics.use(engine)
    scenes = contender.sample(args.num_scenes, 0)
    rows = np.flatnonzero(scenes.is_filled)[: args.num_awake]
    if not len(rows):
        return np.nan
    poses, is_placed = placed_poses(scenes, rows, world.num_objects)
    # As long a first stage as the second: nobody stops early.
    engine.config = replace(config, stand_steps=config.stand_full_steps)
    started = time.process_time()
    num_steps = engine.stand_batch(poses, is_placed, np.ones(len(rows), bool)).num_steps.sum()
    seconds = time.process_time() - started
    engine.config = config
    return float(num_steps) / seconds


def replay_all(args: Engines) -> list[Replay]:
    """Recorded attempts, first of three one-hull boxes, then of the pool, on every engine that runs them."""
    stability = StabilityConfig()
    contact = ContactConfig()
    boxes, attempts = small_attempts(stability, contact, args.num_replayed)
    replays = [
        replay("three boxes", boxes, engine, attempts) for engine in ("native", "warp", "jax")
    ]
    world, attempts = record(args.pool, args.support, stability, contact, args.num_replayed)
    replays += [
        replay(f"{args.pool}, ten objects", world, engine, attempts)
        for engine in ("native", "warp")
    ]
    return replays


def body_of(contenders: dict[str, Contender], replays: list[Replay], args: Engines) -> str:
    """The section: two tables."""
    first = f"""{args.num_scenes} scenes of ten objects of {args.pool} on {args.support} by `clear`,
        {args.rounds} rounds in which the engines take turns with the same keys; medians, and the ratio
        of whole attempts per CPU-second to the first row's, taken round by round. An attempt counts
        from the arrays that go into the engine to those that come out, with the resets and the verdict
        (neighbours and overlaps included); steps are those of attempts. The native engine is reset
        before every attempt and is pure; PyBullet keeps its scene between attempts. `PyBullet, plain`:
        multi-bodies, all awake, neighbours watched at every step; `tuned`: rigid bodies, neighbours
        asleep until touched and looked at once, at the end. The last two columns count the whole
        program, with proposals and rules. Tier `standard`."""
    parts = ["## Engines", prose(first), _contenders_table(contenders)]
    if replays:
        second = f"""The same {args.num_replayed} recorded attempts side by side on a CPU, compiled before.
            MJX steps all scenes until the last one is decided; JAX runs one-hull objects only."""
        parts += [prose(second), _replays_table(replays)]
    return "\n\n".join(parts)


def _contenders_table(contenders: dict[str, Contender]) -> str:
    first = next(iter(contenders.values()))
    rows = []
    for name, contender in contenders.items():
        turns = contender.turns
        ratios = [a.attempts / b.attempts for a, b in zip(turns, first.turns, strict=True)]
        rows.append(
            [
                name,
                f"{contender.awake_steps:,.0f}",
                _median(turns, lambda turn: turn.steps),
                _median(turns, lambda turn: turn.attempts),
                f"{np.median(ratios):.2f}",
                _median(turns, lambda turn: turn.engine_scenes, 1),
                _median(turns, lambda turn: turn.scenes, 1),
                f"{100 * contender.success:.0f} %",
            ]
        )
    header = ["per CPU-second", "steps, all awake", "steps, one moves", "whole attempts", "ratio"]
    header += ["finished scenes, engine", "finished scenes, program", "success"]
    return table(header, rows)


def _median(turns: list[Turn], value: Callable[[Turn], float], digits: int = 0) -> str:
    return f"{np.median([value(turn) for turn in turns]):,.{digits}f}"


def _replays_table(replays: list[Replay]) -> str:
    rows = []
    for each in replays:
        if each.missing:
            rows.append([each.name, each.engine, each.missing, "-", "-", "-"])
            continue
        rows.append(
            [
                each.name,
                each.engine,
                f"{each.steps_per_second:,.0f}",
                f"{each.attempts_per_second:,.1f}",
                f"{100 * each.agreement:.0f} %",
                f"{each.compile_seconds:.0f}",
            ]
        )
    header = ["", "engine", "steps per CPU-s", "whole attempts per CPU-s", "verdicts as native's"]
    return table([*header, "first call: s"], rows)


if __name__ == "__main__":
    main(tyro.cli(Engines))
