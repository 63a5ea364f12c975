"""Suites of tables and figures: of methods, and of what scenes are used for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cluttergen_jax.config import Engine, Method, Suite, check_names, check_whole, check_workers
from cluttergen_jax.downstream.words import PlacerHead
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import check_folder
from cluttergen_jax.kept_folder import hold_folder
from cluttergen_jax.numerics import with_kept_programs

if TYPE_CHECKING:
    from studies.results import Result


@with_kept_programs
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
    """Makes the tables and figures of a suite, and writes each as it is done (`evaluate.py --suite`).

    Args:
      suite: "paper" (its tables and figures), "extended" (what it does not ask) or "downstream" (stable
        placement, perception and a robot, without `methods`, checkpoints and `cluster`; `trials` are test
        scenes there, ten queries and one chain each, or views, or episodes); what the studies' own is cannot
        be given: supports, objects, attempts, rules, repeats and changes.
      only: names of studies of the suite; all of them if not given.
      quick: every table at some of its rows, a few trials each: the whole paper suite in minutes. Its figures
        say nothing. For suites of methods XLA optimises little, and compiled programs of this process are
        dropped at the end.
      methods: whose rows are made; all if not given.
      pools: names or folders, or several joined by +; what each study asks for if not given.
      trials: scenes per row; what each study asks for if not given.
      seed: for the scenes.
      seeds: training seeds where a table asks for several, 3 if not given, 1 if quick; those without a
        checkpoint are left out, and those of placers are trained.
      checkpoint: for the rows of the method that it was trained as.
      checkpoints: a folder of training runs (POOL-VARIANT, with -attemptsA and -SEED behind it where those
        differ), instead of the embedded ones of single pools.
      engine, num_threads: as `cluttergen_jax.evaluate` has them.
      fresh: compute rows again that are stored.
      out: where everything goes; out/SUITE if not given.
      cluster, workers: as `cluttergen_jax.evaluate` has them; pictures and what is measured of scenes are
        made here.
      heads: of suite "downstream": of the placers that a study trains; the study's own if not given.
      num_pairs: of suite "downstream": the most pairs that a placer learns from.
      bank: of suite "downstream": a hand-made bank, for a row of its own in the study `source`.
      show: is given each result as it is done.

    Returns:
      The results as they are stored in NAME.json; `report.tables_of` makes tables of one.

    Raises:
      ConfigError: a setting is outside its range, or there is no such suite, study or method.
      PoolError: there is no such pool.
      MissingExtraError: a study needs an extra that is not installed.
      BankError: another process writes to `out`.
    """
    from cluttergen_jax.cluster import cluster_of
    from cluttergen_jax.evaluation.runner import open_runner
    from cluttergen_jax.numerics import fast_compilation
    from cluttergen_jax.scene.bank.remote import bank_folder
    from studies.downstream.suite_folder import DownstreamScale, SuiteFolder, need_extras
    from studies.methods.time import TIME
    from studies.running import imported_pools, make_suite, suite_folder
    from studies.study import Scale
    from studies.suites import DOWNSTREAM, find_suite

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
    if suite == DOWNSTREAM:
        others = {
            "methods": methods,
            "checkpoint": checkpoint,
            "checkpoints": checkpoints,
            "cluster": cluster,
        }
    if wrong := [name for name, value in others.items() if value]:
        raise ConfigError(f"`{wrong[0]}` with suite {suite!r}", hint=f"leaving out `{wrong[0]}`")
    folder = suite_folder(suite, quick) if out is None else Path(out)
    hand_made = None if bank is None else bank_folder(bank)
    options = {
        "quick": quick,
        "methods": tuple(methods),
        "checkpoint": checkpoint,
        "checkpoints": checkpoints,
        "pools": tuple(pools),
        "heads": tuple(heads),
        "trials": trials,
        "num-pairs": num_pairs,
        "seeds": seeds,
        "bank": hand_made and hand_made.name,
        "seed": seed,
        "engine": None if engine == "auto" else engine,
        "threads": num_threads,
    }
    with hold_folder(folder):
        if suite == DOWNSTREAM:
            asked = DownstreamScale(
                quick=quick,
                trials=trials,
                seeds=seeds,
                pools=tuple(pools),
                seed=seed,
                num_pairs=num_pairs,
                heads=tuple(heads),
                bank=hand_made,
            )
            planned = find_suite(suite, asked, only)
            need_extras(each.study for each in planned)
            maker = SuiteFolder(folder, asked, num_threads, fresh)
            return make_suite(suite, planned, maker, folder, options, show)
        scale = Scale(quick, trials, seeds, tuple(pools), tuple(methods), seed, imported_pools())
        planned = find_suite(suite, scale, only)
        rows = [trial for each in planned if each.study is not TIME for trial in each.trials]
        runner = open_runner(folder, rows, checkpoint, checkpoints, engine, num_threads, fresh)
        if place is not None:
            runner.make_on(place, rows)
        with fast_compilation(quick):
            return make_suite(suite, planned, runner, folder, options, show)
