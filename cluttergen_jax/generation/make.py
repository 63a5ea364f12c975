"""From names to a sampler."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Never

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.generation.arguments import check_known
from cluttergen_jax.generation.sampler import Sampler
from cluttergen_jax.learning.methods import (
    Method,
    check_steered,
    choose_method,
    rules_asked,
    sampler_of,
    suited,
)
from cluttergen_jax.numerics import with_own_settings
from cluttergen_jax.placement.observation import ObservationConfig
from cluttergen_jax.placement.problem import ProblemConfig
from cluttergen_jax.placement.setup import Setup, check_range, check_whole, make_setup, problem_config
from cluttergen_jax.scene.bank.reference import read_start

MAX_RETRIES = 10_000


@with_own_settings
def make_sampler(
    pool: str | Path = "dining",
    support: str | Path = "table",
    num_objects: int | None = None,
    method: str | None = None,
    *,
    checkpoint: str | Path | None = None,
    max_retries: int = 0,
    objects: Sequence[str] = (),
    exclude: Sequence[str] = (),
    repeat: bool = False,
    region: Rectangle | None = None,
    keep_out: Sequence[Rectangle] = (),
    start: str | None = None,
    containment: str = "center",
    order: str | None = None,
    max_attempts: int = 5,
    ruin_after: int | None = None,
    budget: int | None = None,
    min_margin: float | None = None,
    robust: bool = False,
    setting: str = "default",
    overhang: str = "any",
    clutter: str | Mapping[str, float] | None = None,
    natural: bool = False,
    tidy: bool = False,
    height: str = "rest",
    num_scene_points: int = 0,
    engine: str = "auto",
    num_threads: int = 0,
    **unknown: Never,
) -> Sampler:
    """A function `sample(key) -> SceneBatch` that may be compiled, mapped, scanned and sharded.

    Nothing random is decided here: equal keys give equal scenes, within the limits that docs/contract.md
    names.

    Args:
      pool: a pool's name or folder, or several joined by "+".
      support: a support's name or folder; "table-0.40x0.50" is a cuboid of that size.
      num_objects: objects per scene, 1 to 40; all of the pool's (40 at most) if not given.
      method: "guided", "spread", "drop", "clear", "random", or a policy trained for the pool: "policy",
        "beta_free", "normal", "open_loop", "short_memory", or "beta", of which none is embedded. If not
        given: the checkpoint's own, else "guided" ("spread" where no checkpoint of it is embedded).
      checkpoint: a policy's folder, such as `cluttergen train` leaves; the embedded one if not given.
      max_retries: a scene that fails is drawn again up to so often, inside the compiled code, until one
        passes; 0 to 10,000.
      objects: names of the pool's objects to use; all of them if empty.
      exclude: names of the pool's objects to leave out; exclude=("mug",) is the same as pool="dining~mug".
      repeat: let objects stand there more than once.
      region: the queried region on the support's top: a `Rectangle` with its centre (world x, y) and half
        extents in metres, its yaw in radians; the support's own if not given.
      keep_out: `Rectangle`s, likewise, that no object may meet once it has settled, seen from above.
      start: a saved scene, "BANK:INDEX", whose objects stand there and count as neighbours.
      containment: what must lie in the region: the bounding box's "center" or the whole "footprint".
      order: in which objects come: "random"; "fixed" to the pool's order; "largest" footprint first; or
        "weighted", mostly but not always so. If not given: the method's own, "random" for most.
      max_attempts: per object, 1 to 10; a policy of poses allows as many as it was trained with at most.
      ruin_after: failed attempts in a row after which some placed objects, with all that leans on them, are
        taken away and placed again; 0 takes nothing away. If not given: the method's own, 0 for most.
      budget: attempts of a scene in all; `max_attempts` for each object if not given.
      min_margin: metres that the centre of mass of what is placed must lie inside its support, in plan; 0
        asks for nothing. If not given: 0.003.
      robust: ask that an object also stands, with whatever it touches, while gravity tilts by 5 degrees,
        friction is 0.7 times as much and contacts are soft; native engine alone.
      setting: what holds of these where they are not given: "default", or "paper" for the paper's rules: a
        random order, nothing taken away, no margin.
      overhang: how much of an object may reach beyond the support's edge once it rests, seen from above:
        "any"; "half", a quarter of its footprint, half of where an even body tips; or "none".
      clutter: what scenes should have, on average (methods "guided", "spread"): stack, objects on others;
        depth, objects below each, summed; contacts, pairs that touch; near, metres to the nearest other
        object, mean; occlusion, mean share of an object that others hide. As text "stack=3,near=0.02"; in
        Python also a mapping.
      natural: prefer wide, flat things below and small ones on them (methods "guided", "spread").
      tidy: keep room instead of spreading objects out: more objects fit, and scenes are more alike (methods
        "guided", "spread").
      height: at which `random` lets go: at "rest", 1 mm above where the object would stand on the bare top;
        or "free", anywhere in the region's range of heights.
      num_scene_points: points of each scene's cloud, up to 200,000; 0 for none.
      engine: "auto", "native", "warp" or "jax".
      num_threads: of the native engine; 0 takes every core.

    Raises:
      ConfigError: a setting is unknown, out of range, or contradicts another.
      PoolError: a pool, an object, a support or a checkpoint cannot be found or read.
      BankError: the scene to start from cannot be read, or does not stand.
    """
    check_known(unknown, make_sampler)
    check_range("max_retries", max_retries, 0, MAX_RETRIES, 5)
    check_whole(num_scene_points=num_scene_points)
    ObservationConfig(num_scene_points=num_scene_points)
    given = locals()
    chosen, setup = set_up(problem_config(given), given)
    return Sampler(
        problem=setup.problem,
        steps=sampler_of(setup, chosen),
        keep_out=setup.keep_out,
        start=setup.start,
        max_retries=max_retries,
        num_scene_points=num_scene_points,
        recipe=partial(make_sampler, **{name: value for name, value in given.items() if name != "unknown"}),
    )


def set_up(config: ProblemConfig, given: Mapping[str, Any]) -> tuple[Method, Setup]:
    """A method, and the problem compiled for it: with its rules, and the history that it looks back on.

    Args:
      given: the arguments of `make_sampler` or `generate` by name, boxes as `Rectangle`s.

    Raises:
      ConfigError, PoolError, BankError: see `make_sampler`.
    """
    placement = config.placement
    chosen = choose_method(given["method"], config.pool, given["checkpoint"])
    check_steered(chosen.name, placement)
    rules = rules_asked(chosen.name, placement.max_attempts, given)
    config = replace(config, placement=suited(replace(placement, **rules), chosen.checkpoint))
    return chosen, make_setup(config, given["keep_out"], read_start(given["start"]))
