"""What a contact configuration does to real objects: alone, and in scenes left for ten seconds."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.importing.solo_stability import solo_poses
from cluttergen_jax.physics.native import NativePhysics
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.problem import region_of
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.world import World, geometry_of, make_world
from cluttergen_jax.types import Verdict
from studies.benchmarks.host import TimedPhysics
from studies.benchmarks.sampled import make_block_sampler, placed_poses

_WATCH_STEPS = 2400


@dataclass(frozen=True)
class Solo:
    """Placements alone on the table.

    Attributes:
      rate: share that was stable; worst: the lowest share of any one object, and its name.
      steps: mean of the stable ones.
      penetration: the deepest overlap at rest, metres, median over placements.
    """

    rate: float
    worst: tuple[float, str]
    steps: float
    penetration: float


@dataclass(frozen=True)
class Creep:
    """Finished scenes left alone for ten seconds, everything awake.

    Attributes:
      success: share of scenes that the method finished; attempts: mean per scene.
      moved: f64[N], the largest movement in each finished scene, metres.
      steps_per_second: of a whole scene per CPU-second.
    """

    success: float
    attempts: float
    moved: np.ndarray
    steps_per_second: float


def solo(world: World, trials: int) -> Solo:
    """Places every object alone (contract.md's rule), random yaw, 0 to 3 mm above the top."""
    engine = NativePhysics(world.layout, StabilityConfig(), num_threads=1, max_simulations=32)
    rates = []
    steps = []
    depths = []
    everywhere = np.ones(trials, bool)
    for index, asset in enumerate(world.objects):
        poses = np.zeros((trials, world.num_objects, 7), np.float32)
        poses[..., 3] = 1.0
        poses[:, index] = solo_poses(asset, world.support.top, trials, seed=index)[:, 0]
        is_placed = np.broadcast_to(
            np.arange(world.num_objects) == index, (trials, world.num_objects)
        )
        result = engine.settle_batch(poses, is_placed, np.full(trials, index, np.int32), everywhere)
        is_stable = result.verdict == Verdict.STABLE
        rates.append(float(is_stable.mean()))
        steps.extend(result.num_steps[is_stable])
        depths.extend(result.penetration[is_stable])
    worst = int(np.argmin(rates))
    return Solo(
        float(np.mean(rates)),
        (rates[worst], world.names[worst]),
        float(np.mean(steps)) if steps else np.nan,
        float(np.median(depths)) if depths else np.nan,
    )


class SceneMaker:
    """Scenes of one method on one support, compiled once for all contact configurations."""

    def __init__(
        self, objects: tuple[ObjectAsset, ...], support: SupportAsset, method: str
    ) -> None:
        self._objects = objects
        self._support = support
        config = StabilityConfig()
        world = make_world(objects, support, config, ContactConfig())
        self._physics = TimedPhysics(world.num_objects, config)
        rules = Rules(
            PlacementConfig(num_objects=min(10, world.num_objects), history_stride=0),
            self._physics,
            geometry_of(world),
            region_of(support.region, support),
        )
        self._sample = make_block_sampler(rules, method, block_size=64)

    def creep(self, contact: ContactConfig, num_scenes: int) -> Creep:
        """Makes scenes under `contact` and watches those that were filled."""
        world = make_world(self._objects, self._support, self._physics.config, contact)
        self._physics.use(NativePhysics(world.layout, self._physics.config, num_threads=1))
        scenes = self._sample(num_scenes, 0)
        done = np.flatnonzero(scenes.is_filled)
        poses, is_placed = placed_poses(scenes, done, world.num_objects)
        watch = replace(
            self._physics.config, stand_steps=_WATCH_STEPS, stand_full_steps=_WATCH_STEPS
        )
        engine = NativePhysics(world.layout, watch, num_threads=1)
        started = time.process_time()
        standing = engine.stand_batch(poses, is_placed, np.ones(len(done), bool))
        seconds = time.process_time() - started
        return Creep(
            success=float(scenes.is_success.mean()),
            attempts=float(scenes.counts.attempts.sum(-1).mean()),
            moved=standing.shift.max(-1),
            steps_per_second=float(standing.num_steps.sum()) / seconds if len(done) else np.nan,
        )
