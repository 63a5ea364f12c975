"""A robot arm in simulation: grasps of a pool's objects, and objects picked up and put down."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cluttergen_jax.config import check_workers

if TYPE_CHECKING:
    from cluttergen_jax.downstream.robot.grasp_sets import GraspSets

_MOST_GRASPS = 4096
_MOST_SEED = 999_999


def robot_grasps(
    pool: str | Path = "household",
    objects: Sequence[str] = (),
    *,
    num_grasps: int = 64,
    seed: int = 0,
    num_threads: int = 0,
    fresh: bool = False,
    out: str | Path | None = None,
) -> GraspSets:
    """Finds grasps of a pool's objects for the hand of a Franka Panda (`cluttergen robot grasps`).

    Each is tested in MuJoCo: the hand closes, lifts by 15 cm, shakes and turns. What is found is kept for
    each object in the folder `grasps` beside the pools of your own; the same call reads it.

    Args:
      pool: a pool's name or folder, or several joined by +.
      objects: only these of its objects.
      num_grasps: for each object at most, spread over it.
      seed: of what is drawn.
      num_threads: 0 takes every core.
      fresh: make again what is kept.
      out: write all of them to this Parquet file too.

    Returns:
      The grasps of each object; printed, a table that names objects with too few.

    Raises:
      ConfigError: a number is out of range.
      PoolError: there is no such pool or object, or a file of grasps is damaged.
      MissingExtraError: the extra `robot` is not installed.
    """
    from cluttergen_jax.assets.pool import find_pool
    from cluttergen_jax.downstream.robot.grasp_sets import grasp_sets
    from cluttergen_jax.downstream.robot.grasps import write_grasps
    from cluttergen_jax.placement.setup import check_range

    check_workers("num_threads", num_threads)
    check_range("num_grasps", num_grasps, 1, _MOST_GRASPS, 64)
    check_range("seed", seed, 0, _MOST_SEED, 0)
    found = find_pool(pool)
    chosen = tuple(found[name] for name in objects) or found.objects
    sets = grasp_sets(chosen, num_grasps, seed, num_threads, fresh)
    if out is not None:
        write_grasps(Path(out), sets.sets)
    return sets
