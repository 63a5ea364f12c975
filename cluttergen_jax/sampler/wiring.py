"""What everything that takes a pool and a support by name has in common: from settings to a bound world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.reach import check_keep_out
from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.bank.reference import read_start, start_of
from cluttergen_jax.placement.config import MAX_SLOTS
from cluttergen_jax.placement.region import KeepOut
from cluttergen_jax.placement.types import Start
from cluttergen_jax.problem import Problem, ProblemConfig, check_number, keep_out_of, make_problem


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


def number_of(num_objects: int | None, pool: str, objects: Sequence[str], repeat: bool) -> int:
    """The number of objects: as many as are named, or as the pool has, where none is asked for.

    Raises:
      ConfigError: more are asked for than there are.
    """
    available = len(objects) or len(find_pool(pool))
    if num_objects is None:
        return min(available, MAX_SLOTS)
    check_number(num_objects, available, pool, repeat)
    return num_objects
