"""From names and numbers to a setup: the compiled problem, and what every episode begins with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import Rectangle, SupportAsset
from cluttergen_jax.assets.support_map import check_keep_out
from cluttergen_jax.placement.problem import (
    Problem,
    ProblemConfig,
    compose,
    keep_out_of,
    make_problem,
    on_device,
)
from cluttergen_jax.placement.region import KeepOut
from cluttergen_jax.placement.types import Start
from cluttergen_jax.placement.world import World

Standing = tuple[Sequence[ObjectAsset], np.ndarray]
"""Objects that stand there when an episode begins, and their world poses f32[N, 7], metres, wxyz."""


@dataclass(frozen=True, eq=False)
class Setup:
    """A compiled problem, with what every episode begins with.

    Attributes:
      problem: the world, its rules and its queried region.
      keep_out: where no object may come to lie.
      start: what stands there already.
    """

    problem: Problem
    keep_out: KeepOut
    start: Start


def make_setup(
    config: ProblemConfig,
    keep_out: Sequence[Rectangle] = (),
    standing: Standing | None = None,
    assets: tuple[Sequence[ObjectAsset], SupportAsset] | None = None,
) -> Setup:
    """Compiles the problem, around objects that stand there already if there are any.

    Args:
      assets: objects and a support that are at hand, in place of those that `config` names.

    Raises:
      ConfigError: a box cannot meet the region, or `make_problem` refuses.
      PoolError: something cannot be found or read.
    """
    objects, poses = standing or ((), np.zeros((0, 7), np.float32))
    problem = compose(*assets, config, objects) if assets else make_problem(config, objects)
    check_keep_out(keep_out, problem.region)
    return Setup(problem, keep_out_of(keep_out), _start_of(problem.world, poses))


def _start_of(world: World, poses: np.ndarray) -> Start:
    """The start of episodes in a world whose last N objects stand at `poses` f32[N, 7]."""
    is_placed = np.arange(world.num_objects) >= world.num_objects - len(poses)
    everyone = np.tile(np.eye(7)[3], (world.num_objects, 1))
    everyone[is_placed] = poses
    return on_device(Start(everyone, is_placed))
