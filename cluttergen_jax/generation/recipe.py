"""Recipes of banks: what decides their scenes, as it is recorded, and the problem that is read of it again.

`SceneSpec.from_recipe` reads what was asked for.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from cluttergen_jax.assets.sense import read_sense
from cluttergen_jax.assets.support import Rectangle, recorded_rectangle, recorded_ring
from cluttergen_jax.config import ContactConfig, StabilityConfig, stability_record
from cluttergen_jax.learning.methods import Method
from cluttergen_jax.physics import engine_of
from cluttergen_jax.placement.config import PlacementConfig, placement_record
from cluttergen_jax.placement.methods.table import OwnMethod, entry_of
from cluttergen_jax.placement.problem import Problem, ProblemConfig
from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.scene.bank.record import Recipe, config_of
from cluttergen_jax.schema import Record


def recipe_of(
    problem: Problem,
    method: Method,
    seed: int | None,
    keep_out: Sequence[Rectangle | str] = (),
    start: str | None = None,
    checkpoint: str | Path | None = None,
    names: Sequence[str] | None = None,
) -> Record:
    """What decides the scenes of a bank; two equal recipes make equal scenes on one machine.

    Args:
      keep_out, start, checkpoint: as they were asked for (`SceneSpec`).
      names: of all objects, where the problem is of some that were drawn from them.
    """
    config = dataclasses.asdict(problem.config)
    # None decides a scene: threads do not, every scene of a bank has the same region, and the method is told.
    for name in ("num_threads", "change", "is_whole", "is_piled", "named"):
        config.pop(name)
    # Nor is anything drawn where there is no shelf, as in banks of before there were any.
    for name in ("shelf", "weights", "balance", "surface", "polygon"):
        if not config[name]:
            config.pop(name)
    return {
        **config,
        # The engine that "auto" stands for: engines make different scenes.
        "engine": engine_of(problem.config.engine, problem.config.stability),
        "placement": placement_record(problem.config.placement),
        "stability": stability_record(problem.config.stability),
        "region": dataclasses.asdict(problem.region),
        "method": str(method.name),
        **({"method_digest": method.name.digest} if isinstance(method.name, OwnMethod) else {}),
        **_sense_of(problem.config.placement),
        "checkpoint_hash": method.checkpoint and method.checkpoint.hash,
        "block_size": BLOCK_SIZE,
        "names": problem.world.names if names is None else names,
        "versions": {name: version(name) for name in ("cluttergen_jax", "mujoco", "jax")},
        "start": start,
        "keep_out": [box if isinstance(box, str) else dataclasses.asdict(box) for box in keep_out],
        "checkpoint": None if checkpoint is None else str(checkpoint),
        "seed": seed,
    }


def _sense_of(config: PlacementConfig) -> Record:
    """Which table natural scenes were made by."""
    is_used = config.natural or (config.sense and config.arrangements)
    return {"sense_digest": read_sense(config.sense).digest} if is_used else {}


def problem_of_recipe(recipe: Recipe, path: Path) -> ProblemConfig:
    """The problem that the scenes of a recipe solve, to the last number.

    Args:
      path: of the bank, for errors.

    Raises:
      KeyError, TypeError, ValueError: the recipe does not say it whole, as of banks of early versions.
    """
    entry = entry_of(recipe.get("method"))
    return ProblemConfig(
        pool=recipe["pool"],
        repeat=True,
        shelf=recipe.get("shelf", 0),
        weights=tuple((str(name), float(weight)) for name, weight in recipe.get("weights", ())),
        balance=recipe.get("balance", ""),
        region=recorded_rectangle(recipe["region"]),
        polygon=recorded_ring(recipe.get("polygon", ())),
        is_whole=entry.is_whole,
        is_piled=entry.is_heap,
        engine=recipe.get("engine", "auto"),
        placement=config_of(PlacementConfig, recipe["placement"], path),
        stability=config_of(StabilityConfig, recipe["stability"], path),
        contact=config_of(ContactConfig, recipe["contact"], path),
    )
