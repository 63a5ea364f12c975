"""Small decision problems for tests: a made-up physics with known answers, and the trio on the real one."""

from __future__ import annotations

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.physics.host import empty_settling, empty_standing
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.problem import Problem, ProblemConfig, compose
from cluttergen_jax.placement.region import Region, make_region
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.types import Episode, Geometry, Transition
from cluttergen_jax.types import Array, Settling, Standing, Verdict
from tests.helpers.worlds import trio

SINK = 0.01
"""Metres by which the made-up physics lets an object sink, so that settled is not proposed."""


@dataclass(frozen=True)
class HalfTable:
    """What is released at x > 0 settles 1 cm lower in 23 steps; anything else never does."""

    config: StabilityConfig = field(default_factory=StabilityConfig)
    stands: bool = True
    compiling: str = "compiling"

    def settle(self, poses: Array, is_placed: Array, focus: Array, is_active: Array) -> Settling:
        is_stable = poses[focus, 0] > 0
        result = empty_settling(jnp, (), poses.shape[0], self.config)
        return result.replace(
            verdict=jnp.where(is_stable, int(Verdict.STABLE), int(Verdict.UNSETTLED)),
            num_steps=jnp.where(is_stable, 23, 60),
            poses=poses.at[focus, 2].add(-SINK),
            trajectory=result.trajectory.at[0, :7].set(poses[focus]),
            motion_sum=jnp.float32(40.0),
            speed_sum=jnp.float32(10.0),
        )

    def stand(self, poses: Array, is_placed: Array, is_active: Array) -> Standing:
        verdict = Verdict.STABLE if self.stands else Verdict.CREPT
        result = empty_standing(jnp, (), poses.shape[0])
        return result.replace(verdict=jnp.int32(verdict), num_steps=jnp.where(is_active, 60, 0))


def made_up_rules(world_size: int = 6, physics: HalfTable | None = None, **placement) -> Rules:
    """Rules over the made-up physics; object k is 2 (k + 1) cm high, the region 0.6 x 0.4 m and unturned."""
    # In NumPy, of which nothing is compiled.
    height = np.float32(0.01) * (1 + np.arange(world_size, dtype=np.float32))
    geometry = Geometry(
        half_extents=np.stack(
            [np.full(world_size, 0.02), np.full(world_size, 0.03), height], axis=-1
        ),
        center_of_mass=np.zeros((world_size, 3)),
        own_margin=np.full(world_size, 0.02),
        cloud=np.zeros((world_size, 8, 3)),
        column_xy=np.zeros((world_size, 1, 2)),
        column_bottom=-height[:, None],
        is_column=np.ones((world_size, 1), bool),
        surface=np.stack([np.zeros(world_size), np.zeros(world_size), height], axis=-1)[:, None],
        surface_owner=np.arange(world_size),
        boxes=np.array([[0.0, 0.0, 0.35, 0.3, 0.2, 0.35, 0.0]]),
        top=np.float32(0.7),
    )
    return Rules(
        PlacementConfig(**{"num_objects": 4} | placement),
        physics or HalfTable(),
        jax.tree.map(jnp.asarray, geometry),
        region(),
    )


@jax.jit
def try_action(rules: Rules, episode: Episode, action: Array) -> tuple[Episode, Transition]:
    """`Rules.attempt`, compiled once for all rules of equal settings and sizes."""
    return rules.attempt(episode, action)


def region(yaw: float = 0.0) -> Region:
    """0.6 x 0.4 m on a top 0.7 m high."""
    return make_region(jnp.zeros(2), jnp.array([0.3, 0.2]), yaw, 0.7)


def trio_problem(change: str = "none", **placement) -> Problem:
    """The trio of tests.helpers.worlds on the paper's table, native engine."""
    config = ProblemConfig(
        change=change, placement=PlacementConfig(**{"num_objects": 3} | placement)
    )
    return compose(trio(), cuboid_table(), config)
