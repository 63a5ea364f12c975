"""Methods side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from cluttergen_jax.config import (
    Change,
    Method,
    check_names,
    check_whole,
)
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import check_folder
from cluttergen_jax.kept_folder import hold_folder
from cluttergen_jax.numerics import with_kept_programs
from cluttergen_jax.spec import SceneOptions, SceneSpec, in_groups, spec_of, takes_spec

if TYPE_CHECKING:
    from cluttergen_jax.evaluation.comparison import Comparison
    from cluttergen_jax.spec import OwnProposer

_TRIALS = 1000
_SUPPORTS = ("table",)
_ROWS = {
    name: f"each row has its own: {name}s=(...), or a `spec` for all rows"
    for name in ("pool", "support", "method")
} | {"sets": "which scenes of a bank have"}
"""Fields of a `SceneSpec` that are no keywords of `evaluate`, and why."""


@with_kept_programs
@takes_spec(_ROWS, num_objects=10)
@in_groups(
    what="pools",
    where="supports change",
    how_many="trials seed",
    files="checkpoints fresh out",
    machine="cluster workers",
)
def evaluate(
    methods: Sequence[Method | OwnProposer | str] = (),
    pools: Sequence[str] = (),
    supports: Sequence[str] = _SUPPORTS,
    spec: SceneSpec | None = None,
    *,
    trials: int | None = None,
    seed: int = 0,
    change: Change = "none",
    checkpoints: str | Path | None = None,
    fresh: bool = False,
    out: str | Path | None = None,
    cluster: str | None = None,
    workers: int = 0,
    **options: Unpack[SceneOptions],
) -> Comparison:
    """Compares methods: success rates with 95 % intervals, objects placed, effort and speed.

    The arguments that are not explained here are those of `SceneSpec`; they hold for all rows, and where
    rules are not given each method has its own.

    Args:
      methods: "random", "settle", "clear", "drop", "spread", "guided", "packed", "pile", and policies
        trained for the pool: "policy", "beta_free", "normal", "open_loop" or "short_memory"; or your own, as
        the `method` of a `SceneSpec`. If not given: the first six, and "policy" where one is embedded, of
        these all that can make what is asked for.
      pools: names or folders, or several joined by +; dining if not given.
      supports: names or folders; "table-0.40x0.50" is a cuboid of that size, all of it the queried region.
      spec: what is asked for; its pool, support and method are rows where `pools`, `supports` and `methods`
        name none.
      trials: scenes per row; 1000 if not given.
      seed: for the scenes.
      change: how the queried region is changed at random in every episode: "none", "translation",
        "rotation", "shrinkage", "expansion" or "all".
      checkpoints: a folder of training runs (POOL-VARIANT, with -attemptsA and -SEED behind it where those
        differ), instead of the embedded ones of single pools.
      fresh: compute rows again that are stored.
      out: where everything goes: the table, and rows, which are not made again. With None a function writes
        nothing; the command takes out/evaluation.
      cluster: where rows are made: "local", Ray on this machine; "auto", the Ray cluster that this machine
        belongs to; or a cluster's address (extra `ray`). In this process if not given. All machines have to
        see pools and checkpoints that are not embedded under the same path.
      workers: worker processes on the cluster, of `num_threads` cores each, one if that is 0; 0 takes as many
        as it has room for.
      options: fields of `SceneSpec`, in place of those of `spec`; a `checkpoint` is for the rows of the
        method that it was trained as, other learned methods have the embedded ones.

    Returns:
      The table and its rows. One that cannot be made (no policy, too few objects in a pool) has no figures
      and says why in `missing`.

    Raises:
      ConfigError: a setting is outside its range, there is no such method, or no row asks the `checkpoint`.
      PoolError: there is no such pool or support.
      ClutterGenError: no row can be made.
      BankError: another process writes to `out`.
    """
    from cluttergen_jax.cluster import cluster_of
    from cluttergen_jax.evaluation.comparison import compare
    from cluttergen_jax.evaluation.runner import open_runner
    from cluttergen_jax.evaluation.trial import Trial
    from cluttergen_jax.placement.methods.table import find_method

    place = cluster_of(cluster, workers)
    check_folder(out)
    check_whole(trials=trials)
    check_names(methods, "methods")
    check_names(pools, "pools")
    check_names(supports, "supports")
    if not supports:
        raise ConfigError("supports = ()", "one name or more")
    asked = spec_of(evaluate, spec, options, also=("pool", "support", "method"))
    # Not given, where it is the default itself: a table that is named stays.
    if supports is _SUPPORTS:
        supports = (str(asked.support),)
    if not methods and asked.method is not None:
        methods = (asked.method,)
    chosen = tuple(find_method(each) for each in methods)
    if asked.num_objects is None:
        asked = replace(asked, num_objects=10)
    number = _TRIALS if trials is None else trials
    planned = [
        Trial(spec, trials=number, seed=seed, change=change)
        for spec in _specs_of_rows(asked, chosen, pools, supports)
    ]
    folder = None if out is None else Path(out)
    with hold_folder(folder):
        runner = open_runner(
            folder, planned, asked.checkpoint, checkpoints, asked.engine, asked.num_threads, fresh
        )
        if place is not None:
            runner.make_on(place, planned)
        return compare(runner, planned, folder)


def _specs_of_rows(
    asked: SceneSpec, methods: Sequence[str], pools: Sequence[str], supports: Sequence[str]
) -> list[SceneSpec]:
    """What each row asks for: every pool on every support by every method.

    Raises:
      ConfigError: a method cannot make what is asked for; or, where none is named, no method can.
    """
    from cluttergen_jax.learning.methods import methods_of
    from cluttergen_jax.placement.methods.table import entry_of, takers

    specs: list[SceneSpec] = []
    refused: list[ConfigError] = []
    for pool in pools or (str(asked.pool),):
        for support in supports:
            for method in methods or methods_of(pool):
                # Of the others a height is not asked.
                height = asked.height if "height" in entry_of(method).takes else "rest"
                spec = replace(asked, pool=pool, support=support, method=method, height=height)
                try:
                    spec.check_method(method)
                except ConfigError as error:
                    if methods:
                        raise
                    refused.append(error)
                else:
                    specs.append(spec)
    if not specs:
        raise refused[0]
    if asked.height != "rest" and all(spec.height == "rest" for spec in specs):
        free = takers("height")
        raise ConfigError(
            f"height = {asked.height!r} without a row of {free[0]!r}", hint=f"methods={free}"
        )
    return specs
