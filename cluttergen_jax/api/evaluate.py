"""Methods side by side, and suites of tables and figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from cluttergen_jax.api.places import check_folder
from cluttergen_jax.config import (
    Change,
    Engine,
    Method,
    PlacerHead,
    Suite,
    check_names,
    check_whole,
    check_workers,
)
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.numerics import with_own_settings
from cluttergen_jax.spec import EvaluateOptions, SceneSpec, spec_of, takes_spec

if TYPE_CHECKING:
    from cluttergen_jax.evaluation.comparison import Comparison
    from cluttergen_jax.evaluation.studies.study import Result

_TRIALS = 1000
_SUPPORTS = ("table",)


@with_own_settings
@takes_spec(EvaluateOptions, num_objects=10)
def evaluate(
    methods: Sequence[Method] = (),
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
    **options: Unpack[EvaluateOptions],
) -> Comparison:
    """Compares methods: success rates with 95 % intervals, objects placed, effort and speed.

    The arguments that are not explained here are those of `SceneSpec`; they hold for all rows, and where
    rules are not given each method has its own.

    Args:
      methods: "random", "clear", "drop", "spread", "guided", and policies trained for the pool: "policy",
        "beta_free", "normal", "open_loop", "short_memory", or "beta", of which none is embedded. If not
        given: the first five, and "policy" where one is embedded. Of a suite, the rows that are made; all
        if not given.
      pools: names or folders, or several joined by +; dining if not given, and what each study asks for in a
        suite.
      supports: names or folders; "table-0.40x0.50" is a cuboid of that size, all of it the queried region.
      spec: what is asked for; its pool, support and method are rows where `pools`, `supports` and `methods`
        name none.
      trials: scenes per row; 1000 if not given, and what each study asks for in a suite.
      seed: of the scenes.
      change: how the queried region is changed at random in every episode: "none", "translation",
        "rotation", "shrinkage", "expansion" or "all".
      checkpoints: a folder of training runs (POOL-VARIANT, with -attemptsA and -SEED behind it where those
        differ), instead of the embedded ones of single pools.
      fresh: make rows again that are at hand.
      out: where everything goes: the table, and rows, which are not made again. With None a function writes
        nothing of a comparison; the command takes out/evaluation, and a suite out/SUITE.
      cluster: where rows are made: "local", Ray on this machine; "auto", the Ray cluster that this machine
        belongs to; or a cluster's address (extra `ray`). In this process if not given. All machines have to
        see pools and checkpoints that are not embedded under the same path. Of a suite, pictures and what is
        measured of scenes are made here.
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
    """
    from cluttergen_jax.assets.pool import composed
    from cluttergen_jax.cluster import cluster_of
    from cluttergen_jax.evaluation.comparison import compare, open_runner
    from cluttergen_jax.evaluation.studies.rules import with_rules_of
    from cluttergen_jax.evaluation.studies.study import grid
    from cluttergen_jax.evaluation.trial import Trial
    from cluttergen_jax.learning.methods import methods_of

    place = cluster_of(cluster, workers)
    check_folder(out)
    check_whole(trials=trials)
    check_names(methods, "methods")
    check_names(pools, "pools")
    check_names(supports, "supports")
    if not supports:
        raise ConfigError("supports = ()", "one name or more")
    asked = spec_of(evaluate, spec, options, also=("pool", "support", "method"))
    if tuple(supports) == _SUPPORTS:
        supports = (str(asked.support),)
    if not methods and asked.method is not None:
        methods = (asked.method,)
    base = Trial(
        num_objects=10 if asked.num_objects is None else asked.num_objects,
        attempts=asked.max_attempts,
        trials=_TRIALS if trials is None else trials,
        seed=seed,
        repeat=asked.repeat,
        change=change,
        both_detectors=asked.setting != "paper",
    )
    planned = [
        with_rules_of(trial, asked)
        for pool in pools or (asked.pool,)
        for trial in grid(
            base,
            pool=(composed(pool, asked.exclude),),
            support=supports,
            method=methods or methods_of(str(pool)),
        )
    ]
    if asked.height != "rest" and all(trial.method != "random" for trial in planned):
        raise ConfigError(f"height = {asked.height!r} without a row of 'random'", hint="methods=('random',)")
    folder = None if out is None else Path(out)
    runner = open_runner(
        folder, planned, asked.checkpoint, checkpoints, asked.engine, asked.num_threads, fresh
    )
    if place is not None:
        runner.make_on(place, planned)
    return compare(runner, planned, folder)


@with_own_settings
def evaluate_suite(
    suite: Suite,
    *,
    only: Sequence[str] = (),
    quick: bool = False,
    methods: Sequence[Method] = (),
    pools: Sequence[str] = (),
    trials: int | None = None,
    seed: int = 0,
    seeds: int | None = None,
    checkpoint: str | Path | None = None,
    checkpoints: str | Path | None = None,
    engine: Engine = "auto",
    num_threads: int = 0,
    fresh: bool = False,
    out: str | Path | None = None,
    cluster: str | None = None,
    workers: int = 0,
    heads: Sequence[PlacerHead] = (),
    num_pairs: int | None = None,
    bank: str | Path | None = None,
    show: Callable[[Result], None] = lambda result: None,
) -> list[Result]:
    """Makes the tables and figures of a suite, and writes each as it is done (`cluttergen evaluate --suite`).

    The arguments that are not explained here are those of `evaluate`.

    Args:
      suite: "paper" (its tables and figures), "extended" (what it does not ask) or "downstream" (stable
        placement, perception and a robot, without `methods`, checkpoints and `cluster`; `trials` are test
        scenes there, ten queries and one chain each, or views, or episodes); what the studies' own is cannot
        be given then: supports, objects, attempts, rules, repeats and changes.
      only: names of studies of the suite; all of them if not given.
      quick: a few trials a row: the whole paper suite in minutes.
      seeds: training seeds where a table asks for several, 3 if not given, 1 if quick; those without a
        checkpoint are left out, and those of placers are trained.
      heads: of suite "downstream": of the placers that a study trains; the study's own if not given.
      num_pairs: of suite "downstream": the most pairs that a placer learns from.
      bank: of suite "downstream": a bank made by hand, whose row stands in the study `source`.
      show: is given each result as it is done.

    Returns:
      The results as they are stored in NAME.json; `report.tables_of` makes tables of one.

    Raises:
      ConfigError: a setting is outside its range, or there is no such suite, study or method.
      PoolError: there is no such pool.
      MissingExtraError: a study needs an extra that is not installed.
    """
    from cluttergen_jax.api.perception import perception_data, perception_eval
    from cluttergen_jax.api.placer import placer_data
    from cluttergen_jax.api.rearrange import rearrange
    from cluttergen_jax.api.robot import robot_place
    from cluttergen_jax.cluster import cluster_of
    from cluttergen_jax.downstream.studies import study as studies
    from cluttergen_jax.downstream.suite import NAME, run_downstream
    from cluttergen_jax.evaluation.comparison import open_runner
    from cluttergen_jax.evaluation.running import imported_pools, run_suite, suite_folder
    from cluttergen_jax.evaluation.studies.study import Scale
    from cluttergen_jax.evaluation.studies.time import TIME
    from cluttergen_jax.evaluation.suites import find_suite

    place = cluster_of(cluster, workers)
    check_folder(out)
    check_whole(trials=trials, seeds=seeds, num_pairs=num_pairs)
    check_names(only, "only")
    check_names(methods, "methods")
    check_names(pools, "pools")
    check_names(heads, "heads")
    check_workers("num_threads", num_threads)
    if seeds is not None and not 1 <= seeds <= 100:
        raise ConfigError(f"seeds = {seeds}", "1 to 100")
    others: dict[str, object] = {"heads": heads, "num_pairs": num_pairs, "bank": bank}
    if suite == NAME:
        others = {
            "methods": methods,
            "checkpoint": checkpoint,
            "checkpoints": checkpoints,
            "cluster": cluster,
        }
    if wrong := [name for name, value in others.items() if value]:
        raise ConfigError(f"`{wrong[0]}` with suite {suite!r}", hint=f"leaving out `{wrong[0]}`")
    folder = suite_folder(suite, quick) if out is None else Path(out)
    if suite == NAME:
        by_hand = None if bank is None else Path(bank)
        asked = studies.Scale(quick, trials, num_pairs, seeds, tuple(heads), tuple(pools), by_hand, seed)
        calls = studies.ApiCalls(placer_data, perception_data, perception_eval, robot_place, rearrange)
        return run_downstream(calls, folder, only, asked, num_threads, fresh, show)
    scale = Scale(quick, trials, seeds, tuple(pools), tuple(methods), seed, imported_pools())
    planned = find_suite(suite, scale, only)
    rows = [trial for each in planned if each.study is not TIME for trial in each.trials]
    runner = open_runner(folder, rows, checkpoint, checkpoints, engine, num_threads, fresh)
    if place is not None:
        runner.make_on(place, rows)
    return run_suite(runner, suite, planned, scale, folder, show)
