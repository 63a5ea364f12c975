"""From names and numbers to a setup: the compiled world, what every episode begins with, and the method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.pool import composed, find_pool
from cluttergen_jax.assets.reach import check_keep_out
from cluttergen_jax.assets.support import Rectangle, SupportAsset
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.generation.arguments import check_names, check_rectangles, check_whole
from cluttergen_jax.learning.methods import choose_method, proposer_of, suited
from cluttergen_jax.learning.policies.checkpoint import Checkpoint
from cluttergen_jax.placement.config import MAX_SLOTS, PlacementConfig
from cluttergen_jax.placement.problem import (
    Problem,
    ProblemConfig,
    check_number,
    compose,
    keep_out_of,
    make_problem,
)
from cluttergen_jax.placement.region import KeepOut
from cluttergen_jax.placement.rollout import BlockSampler
from cluttergen_jax.placement.types import Start
from cluttergen_jax.scene.bank.reference import read_start, start_of


@dataclass(frozen=True)
class Method:
    """A method by name, and its checkpoint; None for a baseline."""

    name: str
    checkpoint: Checkpoint | None = None


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

    def sampler(self, method: Method) -> BlockSampler:
        """Episodes of a method, which looks back on as much as it was trained with.

        Raises:
          PoolError, ConfigError: its checkpoint cannot be read, or is of another problem.
        """
        rules = self.problem.rules
        rules = replace(rules, config=suited(rules.config, method.checkpoint))
        propose = proposer_of(method.name, method.checkpoint, rules)
        return BlockSampler(rules, propose, self.keep_out, self.start)


def make_setup(
    config: ProblemConfig,
    keep_out: Sequence[Rectangle] = (),
    start: str | None = None,
    assets: tuple[Sequence[ObjectAsset], SupportAsset] | None = None,
) -> Setup:
    """Compiles the problem, around a saved scene if `start` names one ("BANK:INDEX").

    Args:
      assets: objects and a support that are at hand, in place of those that `config` names.

    Raises:
      ConfigError: a box cannot meet the region, or `make_problem` refuses.
      PoolError, BankError: something cannot be found or read.
    """
    standing, poses = read_start(start)
    problem = compose(*assets, config, standing) if assets else make_problem(config, standing)
    check_keep_out(keep_out, problem.region)
    return Setup(problem, keep_out_of(keep_out), start_of(problem.world, standing, poses))


def find_method(name: str | None, checkpoint: str | Path | None, config: ProblemConfig) -> Method:
    """The method of that name; the one that fits the problem best if none is named.

    Raises:
      ConfigError, PoolError: see `learning.methods.choose_method`.
    """
    return Method(*choose_method(name, config.pool, config.support, config.placement.num_objects, checkpoint))


def problem_config(
    *,
    pool: str | Path,
    support: str | Path,
    num_objects: int | None,
    objects: Sequence[str],
    exclude: Sequence[str],
    repeat: bool,
    region: Rectangle | None,
    keep_out: Sequence[Rectangle],
    max_attempts: int,
    engine: str,
    num_threads: int,
    change: str = "none",
    **placement: Any,
) -> ProblemConfig:
    """What `make_sampler`, `make_env` and `generate` are given alike, checked before anything is compiled.

    Raises:
      ConfigError: an argument is of a wrong type, out of range, or contradicts another.
      PoolError: there is no such pool.
    """
    check_whole(num_objects=num_objects, max_attempts=max_attempts, num_threads=num_threads)
    check_names(objects, "objects")
    check_names(exclude, "exclude")
    check_rectangles(region, keep_out)
    name = composed(pool, exclude)
    available = len(objects) or len(find_pool(name))
    if num_objects is None:
        num_objects = min(available, MAX_SLOTS)
    check_number(num_objects, available, name, repeat)
    return ProblemConfig(
        pool=name,
        objects=tuple(objects),
        repeat=repeat,
        support=str(support),
        region=region,
        change=change,
        engine=engine,
        num_threads=num_threads,
        placement=PlacementConfig(num_objects=num_objects, max_attempts=max_attempts, **placement),
    )


def check_range(name: str, value: int, least: int, most: int, example: int) -> None:
    """Refuses what is no whole number from `least` to `most`.

    Raises:
      ConfigError: it names the argument.
    """
    check_whole(**{name: value})
    if not least <= value <= most:
        raise ConfigError(f"{name} = {value}", f"{least} to {most}", f"{name}={example}")
