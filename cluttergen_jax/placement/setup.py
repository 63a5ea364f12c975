"""From names and numbers to a setup: the compiled problem, and what every episode begins with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from numbers import Integral
from typing import Any

import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.pool import composed, find_pool
from cluttergen_jax.assets.reach import check_keep_out
from cluttergen_jax.assets.support import Rectangle, SupportAsset
from cluttergen_jax.config import ROBUST_TILT, StabilityConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.physics import engine_of
from cluttergen_jax.placement.config import MAX_SLOTS, PlacementConfig
from cluttergen_jax.placement.problem import (
    Problem,
    ProblemConfig,
    check_number,
    compose,
    keep_out_of,
    make_problem,
    on_device,
)
from cluttergen_jax.placement.region import KeepOut
from cluttergen_jax.placement.types import Start
from cluttergen_jax.placement.world import World

_WHOLE = ("num_objects", "max_attempts", "ruin_after", "budget", "num_threads")
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


def problem_config(given: Mapping[str, Any]) -> ProblemConfig:
    """What `make_sampler`, `make_env` and `generate` are given alike, checked before anything is compiled.

    Args:
      given: the arguments of one of them by name, its `locals()`; what is of no concern here is passed over,
        and rules that are None are those of `PlacementConfig`.

    Raises:
      ConfigError: an argument is of a wrong type, out of range, or contradicts another.
      PoolError: there is no such pool.
    """
    objects, exclude, num_objects = given["objects"], given["exclude"], given["num_objects"]
    check_whole(**{name: given[name] for name in _WHOLE})
    check_names(objects, "objects")
    check_names(exclude, "exclude")
    check_rectangles(given["region"], given["keep_out"])
    pool = composed(given["pool"], exclude)
    available = len(objects) or len(find_pool(pool))
    if num_objects is None:
        num_objects = min(available, MAX_SLOTS)
    check_number(num_objects, available, pool, given["repeat"])
    asked = {name: value for name, value in _fields_in(given, PlacementConfig).items() if value is not None}
    placement = PlacementConfig(**asked | {"num_objects": num_objects})
    found: dict[str, Any] = {
        "pool": pool,
        "objects": tuple(objects),
        "support": str(given["support"]),
        "placement": placement,
    }
    found["stability"] = _stability(given)
    return ProblemConfig(**_fields_in(given, ProblemConfig) | found)


def _stability(given: Mapping[str, Any]) -> StabilityConfig:
    """When what is placed stands: by the paper's rules, or with both detectors where the engine has two."""
    stability = StabilityConfig(robust_tilt=ROBUST_TILT if given["robust"] else 0.0)
    has_two = engine_of(given["engine"], stability) == "native"
    return replace(stability, both_detectors=has_two and given["setting"] != "paper")


def _fields_in(given: Mapping[str, Any], kind: type[PlacementConfig] | type[ProblemConfig]) -> dict[str, Any]:
    return {each.name: given[each.name] for each in fields(kind) if each.name in given}


def check_range(name: str, value: int, least: int, most: int, example: int) -> None:
    """Refuses what is no whole number from `least` to `most`.

    Raises:
      ConfigError: it names the argument.
    """
    check_whole(**{name: value})
    if not least <= value <= most:
        raise ConfigError(f"{name} = {value}", f"{least} to {most}", f"{name}={example}")


def check_whole(**numbers: Any) -> None:
    """Refuses what is no whole number; None is let through."""
    for name, value in numbers.items():
        if value is not None and (isinstance(value, bool) or not isinstance(value, Integral)):
            raise ConfigError(f"{name} = {value!r}", "a whole number")


def check_names(names: Sequence[str], argument: str) -> None:
    """Refuses a single name, whose letters would be taken for names."""
    if isinstance(names, str):
        raise ConfigError(f"{argument} = {names!r}", "a sequence of names", f"{argument}=({names!r},)")


def check_rectangles(region: Rectangle | None, keep_out: Sequence[Rectangle]) -> None:
    """Refuses whatever else is given for the rectangles of `make_sampler`."""
    if region is not None and not isinstance(region, Rectangle):
        raise ConfigError(f"region = {region!r}", "a Rectangle", "Rectangle(half_extents=(0.2, 0.25))")
    if isinstance(keep_out, Rectangle) or not all(isinstance(box, Rectangle) for box in keep_out):
        raise ConfigError(
            f"keep_out = {keep_out!r}", "a sequence of Rectangles", "keep_out=(Rectangle(...),)"
        )
