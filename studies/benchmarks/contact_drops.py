"""Simple bodies dropped upright: do they come to rest by the rule, in float64 and in float32 alike?"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.errors import MissingExtraError
from cluttergen_jax.physics import make_physics
from cluttergen_jax.placement.world import make_world
from cluttergen_jax.types import Verdict
from studies.benchmarks.bodies import box, prism

_NUM_DROPS = 96
_MAX_GAP = 0.02


def drops(contact: ContactConfig, engine: str) -> float:
    """The share of stable drops, boxes and hexagonal prisms in turn; nan if the engine is not installed."""
    objects = [box("box", (0.03, 0.04, 0.05), 0.2), prism("prism", 0.04, 0.03, 0.2)]
    world = make_world(objects, cuboid_table(), StabilityConfig(), contact)
    try:
        physics = make_physics(world.layout, StabilityConfig(), engine)
    except MissingExtraError:
        return math.nan
    rng = np.random.default_rng(0)
    rows = np.arange(_NUM_DROPS)
    focus = (rows % len(objects)).astype(np.int32)
    height = np.array([asset.half_extents[2] for asset in objects])[focus]
    yaw = rng.uniform(0, 2 * np.pi, _NUM_DROPS)
    poses = np.zeros((_NUM_DROPS, len(objects), 7), np.float32)
    poses[..., 3] = 1.0
    poses[rows, focus, 2] = world.support.top + height + rng.uniform(0, _MAX_GAP, _NUM_DROPS)
    poses[rows, focus, 3] = np.cos(yaw / 2)
    poses[rows, focus, 6] = np.sin(yaw / 2)
    is_placed = np.arange(len(objects)) == focus[:, None]
    arrays = map(jnp.asarray, (poses, is_placed, focus, np.ones(_NUM_DROPS, bool)))
    verdict = jax.jit(jax.vmap(physics.settle))(*arrays).verdict
    return float((np.asarray(verdict) == Verdict.STABLE).mean())
