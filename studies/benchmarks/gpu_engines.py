"""Parts of `benchmarks.gpu` about simulation: agreement with native, steps, and scenes per second."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.generation import make_sampler
from cluttergen_jax.physics.mjx import MjxPhysics, WarpOptions
from cluttergen_jax.physics.native import NativePhysics
from cluttergen_jax.placement.rollout import BLOCK_SIZE, BlockSampler, Rollout
from cluttergen_jax.placement.world import World
from cluttergen_jax.types import Verdict
from studies.benchmarks.recorded import Attempts, record
from studies.benchmarks.rows import Cases, Row
from studies.benchmarks.sampled import placed_poses

WARP = {
    "warp": WarpOptions(),
    "warp, not compacted": WarpOptions(least_batch=0),
    # `room_for` gives 214 contacts and 1,284 rows to the objects of dining; kernels run over all of them.
    "warp, half the room": WarpOptions(num_contacts=107, num_rows=642),
}
"""Ways to simulate with Warp, by name; `native` is measured beside them."""


@dataclass(frozen=True)
class Scale:
    """How much is measured.

    Attributes:
      pool: name or folder; support: name.
      num_objects: of a scene.
      num_attempts: recorded of each method for the agreement of engines; block: compared in one row.
      lanes: scenes side by side; begun: scenes begun for each of them.
      engines: names of `WARP`, and native; compared: those of them that fill scenes and are compared.
      cases: who fills scenes, and which of `CHECKS` they have to pass.
      awake_steps: of everything awake.
    """

    pool: str = "dining"
    support: str = "table"
    num_objects: int = 10
    num_attempts: int = 1280
    block: int = 640
    lanes: tuple[int, ...] = (512, 2048, 8192, 16384)
    begun: int = 3
    engines: tuple[str, ...] = ("native", *WARP)
    compared: tuple[str, ...] = ("native", "warp")
    cases: tuple[tuple[str, str], ...] = (
        ("clear", "whole check"),
        ("clear", "no check"),
        ("guided", "whole check"),
    )
    awake_steps: int = 60


@cache
def recorded(scale: Scale, method: str) -> tuple[World, Attempts]:
    """The world, and attempts of a method in it."""
    return record(
        scale.pool,
        scale.support,
        StabilityConfig(),
        ContactConfig(),
        scale.num_attempts,
        method=method,
    )


def physics_of(engine: str, world: World, stability: StabilityConfig) -> Any:
    """The engine by its name among `Scale.engines`."""
    if engine == "native":
        return NativePhysics(world.layout, stability)
    return MjxPhysics(world.layout, stability, "warp", WARP[engine])


def agreement(scale: Scale) -> Cases:
    """Verdicts and resting poses of recorded attempts, against native's."""
    for engine in scale.compared:
        for method in ("clear", "random") if engine != "native" else ():
            for first in range(0, scale.num_attempts, scale.block):
                yield (
                    f"{engine}, {method} {first}",
                    partial(_agreement, scale, method, engine, first),
                )


@cache
def _settle(scale: Scale, engine: str) -> Any:
    """Attempts of the recorded world, compiled."""
    world, _ = recorded(scale, "clear")
    return jax.jit(jax.vmap(physics_of(engine, world, StabilityConfig()).settle))


def _agreement(scale: Scale, method: str, engine: str, first: int) -> Row:
    world, attempts = recorded(scale, method)
    chosen = slice(first, first + scale.block)
    arrays = attempts.poses[chosen], attempts.is_placed[chosen], attempts.focus[chosen]
    everyone = np.ones(len(arrays[2]), bool)
    native = NativePhysics(world.layout, StabilityConfig()).settle_batch(*arrays, everyone)
    ours = jax.device_get(_settle(scale, engine)(*arrays, everyone))
    is_equal = ours.verdict == native.verdict
    rests = is_equal & (native.verdict == Verdict.STABLE)
    apart = np.linalg.norm(ours.poses[..., :3] - native.poses[..., :3], axis=-1) * arrays[1]
    moved = 1000 * apart.max(axis=1)[rests] if rests.any() else np.zeros(1)
    others = [
        f"{Verdict(int(theirs)).label} > {Verdict(int(mine)).label}"
        for theirs, mine in zip(native.verdict[~is_equal], ours.verdict[~is_equal], strict=True)
    ]
    return {
        "attempts": len(is_equal),
        "equal": int(is_equal.sum()),
        "overflow": int((ours.verdict == Verdict.OVERFLOW).sum()),
        "median mm": float(np.median(moved)),
        "99 % mm": float(np.percentile(moved, 99)),
        "others": {name: others.count(name) for name in sorted(set(others))},
    }


def timed(function: Callable[..., Any], *args: Any) -> tuple[Any, float, float, float]:
    """The result on the host, seconds of the second call, of compilation, and megabytes it works in."""
    started = time.monotonic()
    compiled = jax.jit(function).lower(*args).compile()
    compile_seconds = time.monotonic() - started
    sizes = compiled.memory_analysis()
    megabytes = (
        0.0 if sizes is None else (sizes.temp_size_in_bytes + sizes.output_size_in_bytes) / 1e6
    )
    jax.block_until_ready(compiled(*args))
    started = time.monotonic()
    result = jax.block_until_ready(compiled(*args))
    return jax.device_get(result), time.monotonic() - started, compile_seconds, megabytes


def steps(scale: Scale) -> Cases:
    """Simulated steps per second: everything awake, and as attempts have them."""
    for engine in scale.engines:
        for lanes in scale.lanes:
            yield f"{engine}, {lanes}", partial(_steps, scale, engine, lanes)


def _steps(scale: Scale, engine: str, lanes: int) -> Row:
    world, attempts = recorded(scale, "clear")
    chosen = np.resize(np.arange(len(attempts.focus)), lanes)
    everyone = np.ones(lanes, bool)
    arrays = [
        jnp.asarray(each[chosen]) for each in (attempts.poses, attempts.is_placed, attempts.focus)
    ]
    config = StabilityConfig()
    settle = jax.vmap(physics_of(engine, world, config).settle)
    settled, seconds, compiling, megabytes = timed(
        lambda *args: _counted(settle(*args)), *arrays, jnp.asarray(everyone)
    )
    awake = replace(config, stand_steps=scale.awake_steps, stand_full_steps=scale.awake_steps)
    stand = jax.vmap(physics_of(engine, world, awake).stand)
    poses, is_placed = _whole_scenes(scale, lanes)
    stood, awake_seconds, _, _ = timed(stand, jnp.asarray(poses), jnp.asarray(is_placed), everyone)
    return {
        "lanes": lanes,
        "attempts/s": lanes / seconds,
        "steps/s as used": float(settled[0].sum()) / seconds,
        "longest": int(settled[0].max()),
        "steps/s awake": float(stood.num_steps.sum()) / awake_seconds,
        "overflow": int(
            (settled[1] == Verdict.OVERFLOW).sum() + (stood.verdict == Verdict.OVERFLOW).sum()
        ),
        "compile s": compiling,
        "MB": megabytes,
    }


def _counted(settling: Any) -> tuple[Any, Any]:
    """What scenes are made of; nobody reads the trajectory."""
    return settling.num_steps, settling.verdict, settling.poses, settling.margin


@cache
def _filled(scale: Scale) -> tuple[np.ndarray, np.ndarray]:
    sampler = sampler_with(scale, "clear", "native", StabilityConfig())
    number = min(max(scale.lanes), BLOCK_SIZE)
    found = Rollout().run_all(sampler, jax.random.key(0), number, number)
    rows = np.flatnonzero(found.is_filled)
    return placed_poses(found, rows, sampler.rules.geometry.num_objects)


def _whole_scenes(scale: Scale, lanes: int) -> tuple[np.ndarray, np.ndarray]:
    """Filled scenes as `Physics.stand` takes them, over again until there are so many."""
    poses, is_placed = _filled(scale)
    chosen = np.resize(np.arange(len(poses)), lanes)
    return poses[chosen], is_placed[chosen]


def sampler_with(
    scale: Scale, method: str, engine: str, stability: StabilityConfig
) -> BlockSampler:
    """Episodes as `generate` makes them, on an engine of `Scale.engines`."""
    made = make_sampler(
        pool=scale.pool,
        support=scale.support,
        num_objects=scale.num_objects,
        method=method,
        engine="native",
    )
    physics = physics_of(engine, made.problem.world, stability)
    return replace(made.steps, rules=replace(made.steps.rules, physics=physics))


CHECKS = {
    "whole check": StabilityConfig(),
    "no check": StabilityConfig(stand_steps=1, stand_full_steps=1),
}
"""The last check of finished scenes, or one step in its place."""


def scenes(scale: Scale) -> Cases:
    """Attempts and finished scenes per second, with and without the last check."""
    for method, check in scale.cases:
        for engine in scale.compared:
            for lanes in scale.lanes if engine != "native" else scale.lanes[:1]:
                name = f"{engine}, {method}, {check}, {lanes}"
                yield name, partial(_scenes, scale, engine, method, check, lanes)


def _scenes(scale: Scale, engine: str, method: str, check: str, lanes: int) -> Row:
    sampler = sampler_with(scale, method, engine, CHECKS[check])
    rollout = Rollout()
    key = jax.random.key(0)
    started = time.monotonic()
    rollout.compile(sampler, key, np.arange(lanes))
    compiled = time.monotonic()
    found = rollout.run_all(sampler, key, scale.begun * lanes, lanes)
    seconds = time.monotonic() - compiled
    memory = jax.devices()[0].memory_stats() or {}
    return {
        "lanes": lanes,
        "begun": len(found.is_success),
        "success": float(found.is_success.mean()),
        "attempts/s": int(found.counts.attempts.sum()) / seconds,
        "steps/s": int(found.counts.simulated_steps.sum()) / seconds,
        "finished scenes/s": int(found.is_success.sum()) / seconds,
        "compile s": compiled - started,
        "MB at most": memory.get("peak_bytes_in_use", 0) / 1e6,
    }
