"""Attempts recorded once and given to any engine behind the physics interface, host or MJX."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.errors import MissingExtraError
from cluttergen_jax.physics import make_physics
from cluttergen_jax.physics.native import NativePhysics
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.problem import region_of
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.world import World, geometry_of, make_world
from cluttergen_jax.types import Settling
from studies.benchmarks.bodies import box
from studies.benchmarks.host import TimedPhysics
from studies.benchmarks.sampled import make_block_sampler


@dataclass(frozen=True)
class Attempts:
    """N attempts as `Physics.settle` takes them: poses f32[N, K, 7], is_placed bool[N, K], focus i32[N]."""

    poses: np.ndarray
    is_placed: np.ndarray
    focus: np.ndarray


@dataclass(frozen=True)
class Replay:
    """How one engine fared with recorded attempts.

    Attributes:
      name: the world; engine: which.
      missing: why it did not run, or empty.
      steps_per_second, attempts_per_second: per CPU-second, the compiled program's second run.
      agreement: share of verdicts equal to native's.
      compile_seconds: wall time of the first call.
    """

    name: str
    engine: str
    missing: str = ""
    steps_per_second: float = np.nan
    attempts_per_second: float = np.nan
    agreement: float = np.nan
    compile_seconds: float = np.nan


class _Recorder:
    """A `BatchEngine` that keeps the attempts it is asked for."""

    def __init__(self, engine: NativePhysics) -> None:
        self._engine = engine
        self.config = engine.config
        self.attempts: list[Attempts] = []
        self.stand_batch = engine.stand_batch

    def settle_batch(
        self, poses: np.ndarray, is_placed: np.ndarray, focus: np.ndarray, is_active: np.ndarray
    ) -> Settling:
        self.attempts.append(Attempts(poses[is_active], is_placed[is_active], focus[is_active]))
        return self._engine.settle_batch(poses, is_placed, focus, is_active)


def record(
    pool: str,
    support_name: str,
    stability: StabilityConfig,
    contact: ContactConfig,
    number: int,
    method: str = "clear",
) -> tuple[World, Attempts]:
    """The world of a pool, and `number` attempts of a method in it, early and late ones."""
    support = find_support(support_name)
    world = make_world(find_pool(pool).objects, support, stability, contact)
    physics = TimedPhysics(world.num_objects, stability)
    recorder = _Recorder(NativePhysics(world.layout, stability))
    physics.use(recorder)
    placement = PlacementConfig(num_objects=min(10, world.num_objects), history_stride=0)
    rules = Rules(placement, physics, geometry_of(world), region_of(support.region, support))
    num_scenes = -(-number // placement.num_objects)
    make_block_sampler(rules, method, block_size=num_scenes)(num_scenes, 0)
    parts = recorder.attempts
    return world, Attempts(
        np.concatenate([each.poses for each in parts])[:number],
        np.concatenate([each.is_placed for each in parts])[:number],
        np.concatenate([each.focus for each in parts])[:number],
    )


def small_attempts(
    stability: StabilityConfig, contact: ContactConfig, number: int
) -> tuple[World, Attempts]:
    """Three boxes of one hull each: two stand, the third is let go 1 mm above the table or one of them."""
    sizes = ((0.06, 0.06, 0.01), (0.04, 0.04, 0.03), (0.03, 0.03, 0.05))
    objects = [box(f"box-{index}", size, 0.2) for index, size in enumerate(sizes)]
    world = make_world(objects, cuboid_table(), stability, contact)
    rng = np.random.default_rng(0)
    poses = np.zeros((number, 3, 7), np.float32)
    poses[..., 3] = 1.0
    half = np.array([size[2] for size in sizes])
    poses[:, :, 2] = world.support.top + half
    poses[:, 0, 0] = -0.15
    poses[:, 1, 0] = 0.15
    yaw = rng.uniform(0, 2 * np.pi, number)
    poses[:, 2, :2] = rng.uniform(-0.02, 0.02, (number, 2))
    poses[:, 2, 3] = np.cos(yaw / 2)
    poses[:, 2, 6] = np.sin(yaw / 2)
    # Every other one goes onto the flat box.
    poses[::2, 2, 0] += poses[::2, 0, 0]
    poses[::2, 2, 2] += 2 * half[0]
    poses[:, 2, 2] += 0.001
    return world, Attempts(poses, np.ones((number, 3), bool), np.full(number, 2, np.int32))


def replay(name: str, world: World, engine: str, attempts: Attempts) -> Replay:
    """Runs the attempts side by side on an engine, twice: the second run counts."""
    config = StabilityConfig()
    try:
        physics = make_physics(world.layout, config, engine)
    except MissingExtraError as error:
        return Replay(name, engine, missing=f"not installed: {error}".splitlines()[0])
    settle = jax.jit(jax.vmap(physics.settle))
    everyone = np.ones(len(attempts.focus), bool)
    arrays = [
        jnp.asarray(a) for a in (attempts.poses, attempts.is_placed, attempts.focus, everyone)
    ]
    started = time.perf_counter()
    _run(settle, arrays)
    compile_seconds = time.perf_counter() - started
    started = time.process_time()
    result = _run(settle, arrays)
    seconds = time.process_time() - started
    native = NativePhysics(world.layout, config).settle_batch(
        attempts.poses, attempts.is_placed, attempts.focus, everyone
    )
    return Replay(
        name,
        engine,
        steps_per_second=float(result.num_steps.sum()) / seconds,
        attempts_per_second=len(everyone) / seconds,
        agreement=float((result.verdict == native.verdict).mean()),
        compile_seconds=compile_seconds,
    )


def _run(settle: Any, arrays: list[jax.Array]) -> Settling:
    return jax.device_get(settle(*arrays))
