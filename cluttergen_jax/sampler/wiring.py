"""What everything that takes a pool and a support by name has in common: from settings to a bound world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.reach import check_keep_out
from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.bank.start import read_start, start_of
from cluttergen_jax.placement.config import MAX_SLOTS
from cluttergen_jax.placement.region import KeepOut
from cluttergen_jax.placement.types import Start
from cluttergen_jax.problem import Problem, ProblemConfig, keep_out_of, make_problem


@dataclass(frozen=True, eq=False)
class Bound:
    """A compiled problem, with what every episode begins with.

    Attributes:
      problem: the world, its rules and its queried region.
      keep_out: where no object may come to lie.
      start: what stands there already.
    """

    problem: Problem
    keep_out: KeepOut
    start: Start


def bind(config: ProblemConfig, keep_out: Sequence[Rectangle], start: str | None) -> Bound:
    """Compiles the problem, around a saved scene if `start` names one ("BANK:INDEX").

    Raises:
      ConfigError: a box cannot meet the region, or `make_problem` refuses.
      PoolError, BankError: something cannot be found or read.
    """
    standing, poses = read_start(start)
    problem = make_problem(config, standing)
    check_keep_out(keep_out, problem.region)
    return Bound(problem, keep_out_of(keep_out), start_of(problem.world, standing, poses))


def usual_number(pool: str, objects: Sequence[str]) -> int:
    """The number of objects where none is asked for: as many as are named, or as the pool has."""
    return min(len(objects) or len(find_pool(pool)), MAX_SLOTS)
