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
    from cluttergen_jax.evaluation.records import Result


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
    """Makes the tables and figures of a suite, and writes each as it is done (`cluttergen evaluate --suite`).

    The arguments that are not explained here are those of `evaluate`.

    Args:
      suite: "paper" (its tables and figures), "extended" (what it does not ask) or "downstream" (stable
        placement, perception and a robot, without `methods`, checkpoints and `cluster`; `trials` are test
        scenes there, ten queries and one chain each, or views, or episodes); what the studies' own is cannot
        be given then: supports, objects, attempts, rules, repeats and changes.
      only: names of studies of the suite; all of them if not given.
      quick: every table at some of its rows, a few trials each: the whole paper suite in minutes. Its figures
        say nothing. For suites of methods XLA optimises little, and compiled programs of this process are
        dropped at the end.
      seeds: training seeds where a table asks for several, 3 if not given, 1 if quick; those without a
        checkpoint are left out, and those of placers are trained.
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
    from cluttergen_jax.downstream.studies.study import DownstreamScale
    from cluttergen_jax.downstream.suite import NAME, run_downstream
    from cluttergen_jax.evaluation.running import make_suite, suite_folder
    from cluttergen_jax.evaluation.studies.study import Scale
    from cluttergen_jax.scene.bank.remote import bank_folder

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
    with hold_folder(folder):
        if suite == NAME:
            scale = DownstreamScale(
                quick=quick,
                trials=trials,
                seeds=seeds,
                pools=tuple(pools),
                seed=seed,
                num_pairs=num_pairs,
                heads=tuple(heads),
                bank=None if bank is None else bank_folder(bank),
            )
            return run_downstream(folder, only, scale, num_threads, fresh, show)
        return make_suite(
            suite,
            only,
            Scale(quick, trials, seeds, tuple(pools), tuple(methods), seed),
            folder,
            checkpoint=checkpoint,
            checkpoints=checkpoints,
            engine=engine,
            place=place,
            num_threads=num_threads,
            fresh=fresh,
            show=show,
        )
