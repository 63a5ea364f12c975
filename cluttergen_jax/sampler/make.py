"""From names to a sampler."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Never

from cluttergen_jax.assets.pool import composed
from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.methods import choose_method, proposer_of, suited
from cluttergen_jax.placement.config import MIN_MARGIN, PlacementConfig
from cluttergen_jax.placement.observation import ObservationConfig
from cluttergen_jax.problem import ProblemConfig
from cluttergen_jax.sampler.arguments import check_known, check_names, check_rectangles, check_whole
from cluttergen_jax.sampler.sampler import Sampler
from cluttergen_jax.sampler.wiring import bind, number_of
from cluttergen_jax.sampling import BlockSampler

MAX_RETRIES = 10_000


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
    order: str = "random",
    max_attempts: int = 5,
    min_margin: float = MIN_MARGIN,
    num_scene_points: int = 0,
    engine: str = "auto",
    num_threads: int = 0,
    **unknown: Never,
) -> Sampler:
    """A function `sample(key) -> SampledScene` that may be compiled, mapped, scanned and sharded.

    Nothing random is decided here: equal keys give equal scenes, within the limits that docs/contract.md
    names.

    Args:
      pool: a pool's name or folder, or several joined by "+".
      support: a support's name or folder; "table-0.40x0.50" is a cuboid of that size.
      num_objects: objects per scene, 1 to 40; all of the pool's (40 at most) if not given.
      method: "random", "clear", "drop", or a trained policy. If not given: the checkpoint's own; else
        "policy" where a good one is embedded for this pool, support and number of objects, else "clear".
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
      order: "random", or "fixed" to the pool's order.
      max_attempts: per object, 1 to 10; a policy of poses allows as many as it was trained with at most.
      min_margin: metres that the centre of mass of what is placed must lie inside its support, in plan; 0
        asks for nothing, as the paper does.
      num_scene_points: points of each scene's cloud, up to 200,000; 0 for none.
      engine: "auto", "native", "warp" or "jax".
      num_threads: of the native engine; 0 takes every core.

    Raises:
      ConfigError: a setting is unknown, out of range, or contradicts another.
      PoolError: a pool, an object, a support or a checkpoint cannot be found or read.
      BankError: the scene to start from cannot be read, or does not stand.
    """
    check_known(unknown, make_sampler)
    check_whole(
        num_objects=num_objects,
        max_retries=max_retries,
        max_attempts=max_attempts,
        num_scene_points=num_scene_points,
        num_threads=num_threads,
    )
    check_names(objects, "objects")
    check_names(exclude, "exclude")
    check_rectangles(region, keep_out)
    if not 0 <= max_retries <= MAX_RETRIES:
        raise ConfigError(f"max_retries = {max_retries}", f"0 to {MAX_RETRIES}", "max_retries=5")
    ObservationConfig(num_scene_points=num_scene_points)
    pool = composed(pool, exclude)
    num_objects = number_of(num_objects, pool, objects, repeat)
    method, policy = choose_method(method, pool, str(support), num_objects, checkpoint)
    placement = PlacementConfig(
        num_objects=num_objects,
        max_attempts=max_attempts,
        containment=containment,
        order=order,
        min_margin=min_margin,
    )
    config = ProblemConfig(
        pool=pool,
        objects=tuple(objects),
        repeat=repeat,
        support=str(support),
        region=region,
        engine=engine,
        num_threads=num_threads,
        placement=suited(placement, policy),
    )
    bound = bind(config, keep_out, start)
    rules = bound.problem.rules
    return Sampler(
        problem=bound.problem,
        steps=BlockSampler(rules, proposer_of(method, policy, rules)),
        keep_out=bound.keep_out,
        start=bound.start,
        max_retries=max_retries,
        num_scene_points=num_scene_points,
    )
