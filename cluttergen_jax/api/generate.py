"""A bank of scenes from names and numbers."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cluttergen_jax.config import Containment, Engine, Height, Method, Order, Overhang, Setting
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.numerics import with_own_settings

if TYPE_CHECKING:
    from cluttergen_jax.assets.support import Rectangle
    from cluttergen_jax.generation.generate import GeneratedBank

MAX_SCENES = 2_000_000_000
_MOST = 2**32 - 1


@with_own_settings
def generate(
    out: str | Path = "out",
    *,
    pool: str | Path = "dining",
    num_scenes: int = 20,
    method: Method | None = None,
    checkpoint: str | Path | None = None,
    num_objects: int | None = None,
    objects: Sequence[str] = (),
    exclude: Sequence[str] = (),
    support: str | Path = "table",
    region: Rectangle | str | None = None,
    containment: Containment = "center",
    order: Order | None = None,
    max_attempts: int = 5,
    ruin_after: int | None = None,
    budget: int | None = None,
    min_margin: float | None = None,
    robust: bool = False,
    setting: Setting = "default",
    overhang: Overhang = "any",
    clutter: str | Mapping[str, float] | None = None,
    natural: bool = False,
    tidy: bool = False,
    height: Height = "rest",
    repeat: bool = False,
    start: str | None = None,
    keep_out: Sequence[Rectangle | str] = (),
    seed: int = 0,
    engine: Engine = "auto",
    num_threads: int = 0,
    render: bool = True,
    max_files: int = 1000,
    overwrite: bool = False,
    allow_other_bits: bool = False,
    cluster: str | None = None,
    workers: int = 0,
) -> GeneratedBank:
    """Samples scenes and saves them as a bank, failures included; `cluttergen generate`.

    The same call continues an interrupted one, and mends what is damaged. Scene i of it is what
    `make_sampler` makes of the key `jax.random.fold_in(jax.random.key(seed), i)`.

    Args:
      out: the bank's folder, or a URL such as s3://bucket/name; an interrupted bank is continued.
      pool: a pool's name or folder (`cluttergen list`), or several joined by +: dining+mine.
      num_scenes: scenes to make, failures counted.
      method: how poses are proposed: "guided", "spread", "drop", "clear", "random", or a policy trained for
        the pool: "policy", "beta_free", "normal", "open_loop", "short_memory", or "beta", of which none is
        embedded. If not given: the checkpoint's own, else "guided" ("spread" where no checkpoint of it is
        embedded).
      checkpoint: the policy's folder; the embedded one for the pool if not given.
      num_objects: objects per scene; all of the pool's (40 at most) if not given.
      objects: names of the pool's objects to use; all of them if empty.
      exclude: names of the pool's objects to leave out; exclude=("mug",) is the same as pool="dining~mug".
      support: a support's name or folder; "table-0.40x0.50" is a cuboid of that size.
      region: the queried region, WxD or X,Y,W,D[,YAW] in metres and degrees; the support's own if not given.
        In Python also a `Rectangle`.
      containment: what must lie in the region: the bounding box's "center", or its whole "footprint".
      order: in which objects come: "random"; "fixed" to the pool's order; "largest" footprint first; or
        "weighted", mostly but not always so. If not given: the method's own, "random" for most.
      max_attempts: attempts per object, 1 to 10.
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
      repeat: let objects stand there more than once.
      start: a scene to start from, BANK:INDEX; its objects stay and count as neighbours.
      keep_out: boxes that objects must stay out of, X,Y,W,D[,YAW] each; in Python also `Rectangle`s.
      seed: the same seed makes the same scenes, 0 to 4294967295.
      engine: "auto", "native", "warp" or "jax".
      num_threads: simulation threads of the native engine; 0 takes every core.
      render: draw a picture of each scene that gets a file.
      max_files: the first so many scenes get an MJCF file each (and a picture) if they succeed.
      overwrite: begin anew if the folder holds another bank.
      allow_other_bits: continue a bank even if another processor, other flags of XLA or another jaxlib made
        its scenes, so that the same seed here makes others; its record tells of both.
      cluster: where scenes are made: "local", Ray on this machine; "auto", the Ray cluster that this machine
        belongs to; or a cluster's address (extra `ray`). In this process if not given.
      workers: worker processes on the cluster, of `num_threads` cores each, one if that is 0; 0 takes as many
        as it has room for. Equal machines make the same bank, however many there are.

    Returns:
      The bank; printed, it tells how well it went.

    Raises:
      ConfigError, PoolError: as `make_sampler`.
      BankError: the folder holds something else, cannot be written, or is being written by another process;
        or the scene to start from cannot be read.
      MissingExtraError: a cluster without the extra `ray`.
    """
    from cluttergen_jax.assets.rectangle_text import parse_boxes, parse_region
    from cluttergen_jax.assets.support_file import find_support
    from cluttergen_jax.cluster import cluster_of
    from cluttergen_jax.generation.generate import recipe_of, write_bank
    from cluttergen_jax.generation.make import set_up
    from cluttergen_jax.placement.setup import check_range, problem_config

    check_range("num_scenes", num_scenes, 1, MAX_SCENES, 20)
    check_range("seed", seed, 0, _MOST, 0)
    if max_files < 0:
        raise ConfigError(f"max_files = {max_files}", "0 or more", "max_files=0 for none")
    boxes = parse_boxes(keep_out, "keep_out")
    if isinstance(region, str):
        region = parse_region(region, find_support(support).region)
    place = cluster_of(cluster, workers)
    given = locals() | {"keep_out": boxes}
    chosen, setup = set_up(problem_config(given), given)
    recipe = recipe_of(setup.problem, chosen) | {
        "start": start,
        "keep_out": [box if isinstance(box, str) else dataclasses.asdict(box) for box in keep_out],
        "checkpoint": None if checkpoint is None else str(checkpoint),
        "seed": seed,
    }
    return write_bank(
        out, setup, chosen, recipe, num_scenes, render, max_files, overwrite, place, allow_other_bits
    )
