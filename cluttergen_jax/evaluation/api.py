"""Methods side by side, and stability certificates of the scenes of a bank."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from cluttergen_jax.config import (
    DETECTORS,
    PILE,
    Change,
    Detector,
    Method,
    check_names,
    check_range,
    check_seconds,
    check_whole,
    check_workers,
)
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import check_folder
from cluttergen_jax.kept_folder import hold_folder
from cluttergen_jax.numerics import with_kept_programs
from cluttergen_jax.spec import SceneOptions, SceneSpec, spec_of, takes_spec

if TYPE_CHECKING:
    import numpy as np

    from cluttergen_jax.evaluation.certify import Certification
    from cluttergen_jax.evaluation.comparison import Comparison
    from cluttergen_jax.evaluation.judging.report import JudgeReport
    from cluttergen_jax.scene.bank import Bank

_TRIALS = 1000
_SUPPORTS = ("table",)
_ROWS = {
    name: f"each row has its own: {name}s=(...), or a `spec` for all rows"
    for name in ("pool", "support", "method")
}
"""Fields of a `SceneSpec` that are no keywords of `evaluate`, and why."""


@with_kept_programs
@takes_spec(_ROWS, num_objects=10)
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
    **options: Unpack[SceneOptions],
) -> Comparison:
    """Compares methods: success rates with 95 % intervals, objects placed, effort and speed.

    The arguments that are not explained here are those of `SceneSpec`; they hold for all rows, and where
    rules are not given each method has its own.

    Args:
      methods: "random", "clear", "drop", "spread", "guided", and policies trained for the pool: "policy",
        "beta_free", "normal", "open_loop" or "short_memory". If not given: the first five, and "policy"
        where one is embedded, of these all that can make what is asked for. Of a suite, the rows that are
        made; all if not given.
      pools: names or folders, or several joined by +; dining if not given, and what each study asks for in a
        suite.
      supports: names or folders; "table-0.40x0.50" is a cuboid of that size, all of it the queried region.
      spec: what is asked for; its pool, support and method are rows where `pools`, `supports` and `methods`
        name none.
      trials: scenes per row; 1000 if not given, and what each study asks for in a suite.
      seed: for the scenes.
      change: how the queried region is changed at random in every episode: "none", "translation",
        "rotation", "shrinkage", "expansion" or "all".
      checkpoints: a folder of training runs (POOL-VARIANT, with -attemptsA and -SEED behind it where those
        differ), instead of the embedded ones of single pools.
      fresh: compute rows again that are stored.
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
      BankError: another process writes to `out`.
    """
    from cluttergen_jax.cluster import cluster_of
    from cluttergen_jax.evaluation.comparison import compare, open_runner
    from cluttergen_jax.evaluation.trial import Trial

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
    if PILE in methods:
        raise ConfigError(
            f"method {PILE!r}, which places no objects that could be counted one by one",
            "methods that place one object after another",
            f"generate(method={PILE!r}), which tells how many scenes succeed",
        )
    if asked.num_objects is None:
        asked = replace(asked, num_objects=10)
    number = _TRIALS if trials is None else trials
    planned = [
        Trial(spec, trials=number, seed=seed, change=change)
        for spec in _specs_of_rows(asked, methods, pools, supports)
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
    asked: SceneSpec, methods: Sequence[Method], pools: Sequence[str], supports: Sequence[str]
) -> list[SceneSpec]:
    """What each row asks for: every pool on every support by every method.

    Raises:
      ConfigError: a method cannot make what is asked for; or, where none is named, no method can.
    """
    from cluttergen_jax.learning.methods import methods_of

    specs: list[SceneSpec] = []
    refused: list[ConfigError] = []
    for pool in pools or (str(asked.pool),):
        for support in supports:
            for method in methods or methods_of(pool):
                # A height is asked of `random` alone.
                height = asked.height if method == "random" else "rest"
                spec = replace(asked, pool=pool, support=support, method=method, height=height)  # type: ignore[arg-type]
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
    if asked.height != "rest" and all(spec.method != "random" for spec in specs):
        raise ConfigError(
            f"height = {asked.height!r} without a row of 'random'", hint="methods=('random',)"
        )
    return specs


def certify(
    bank: Bank | str | Path,
    *,
    seconds: float = 2.0,
    jobs: int = 0,
    force: bool = False,
    cluster: str | None = None,
    workers: int = 0,
) -> Certification:
    """Adds a stability certificate to each successful scene of a bank: a column for each measure.

    Args:
      bank: a bank's folder; in Python also a `Bank`.
      seconds: the horizon over which drift is measured, 3600 at most.
      jobs: scenes simulated at a time; 0 takes every core.
      force: measure again what has a certificate.
      cluster: where it is done: "local", Ray on this machine; "auto", the Ray cluster that this machine
        belongs to; or a cluster's address (extra `ray`). In this process if not given.
      workers: worker processes on the cluster; 0 takes as many as it has room for.
        Each has `jobs` cores, one if that is 0.

    Raises:
      BankError: the bank cannot be read or written, another process writes it, or it holds no success.
      ConfigError: a setting is outside its range.
      MissingExtraError: a cluster without the extra `ray`.
    """
    from cluttergen_jax.cluster import cluster_of
    from cluttergen_jax.evaluation.certify import certify_bank
    from cluttergen_jax.scene.bank import Bank, read_bank

    check_seconds("seconds", seconds)
    check_workers("jobs", jobs)
    bank = bank if isinstance(bank, Bank) else read_bank(bank)
    return certify_bank(bank, seconds, jobs, force, cluster_of(cluster, workers))


_MOST_STARTS = 1_000_000


def judge(
    paths: str | Path | Sequence[str | Path],
    states: str | Path | np.ndarray | None = None,
    *,
    out: str | Path | None = None,
    seconds: Sequence[float] = (1.0, 10.0, 60.0),
    max_shift: float = 0.005,
    max_turn_deg: float = 5.0,
    max_penetration: float = 0.001,
    hold_joints: bool = False,
    detectors: Sequence[Detector] = DETECTORS,
    max_starts: int = 50,
    jobs: int = 0,
) -> JudgeReport:
    """Judges anybody's scenes by one strict rule (`cluttergen judge`).

    Each free body of each start is simulated in the installed MuJoCo from rest, everything awake, with the
    file's own options; nothing is repaired. It is told what moves up to each horizon, what overlaps (by
    geometry, also where the file leaves contacts out) and what nothing carries at the start, and what falls;
    a simulation that diverges counts as moved. What is noted, such as a missing picture, is in `notes`.

    Args:
      paths: files of scenes (MJCF, URDF, MJB, SDF worlds; USD with the extra `usd`) and folders of them. An
        MJCF file starts at each of its keyframes, or where its bodies are; or at the states in an array of
        the same name beside it (scene.npz or scene.npy beside scene.xml).
      states: starts of a single file: an array, or its npz or npy file. Rows are qpos, or qpos and qvel,
        with or without the time before them; velocities count as zero. Numbers are real and finite,
        quaternions of unit length to within 0.01.
      out: a folder for report.csv, report.parquet and a picture of the worst scene; nothing is written if
        not given.
      seconds: horizons, ascending.
      max_shift: metres by which a body's centre of mass may be away from its start at any time.
      max_turn_deg: degrees that a body may have turned.
      max_penetration: metres by which two bodies may overlap at the start.
      hold_joints: keep joints other than free ones where they start. If not, actuators hold their initial
        controls, and an arm whose motors are given no torque falls.
      detectors: of MuJoCo's detectors of convex collisions: "native", "libccd", or both.
      max_starts: of a file that has more starts, so many are judged, evenly spread.
      jobs: simulations at a time; 0 takes every core.

    Returns:
      The report; printed, a table and the worst scenes. What cannot be read is in `unread`, with the reason.

    Raises:
      ConfigError: a setting is outside its range, a path does not exist, or no file is a scene.
      BankError: another process writes to `out`.
    """
    from cluttergen_jax.evaluation.judging.judge import judge_scenes
    from cluttergen_jax.evaluation.judging.rule import JudgeConfig
    from cluttergen_jax.evaluation.judging.scene_files import find_scenes

    check_workers("jobs", jobs)
    check_folder(out)
    check_range("max_starts", max_starts, 1, _MOST_STARTS, 50)
    check_names(detectors, "detectors")
    if not detectors or set(detectors) - set(DETECTORS):
        raise ConfigError(
            f"detectors = {tuple(detectors)}", " ".join(DETECTORS), "detectors=('native',)"
        )
    paths = [paths] if isinstance(paths, str | Path) else list(paths)
    config = JudgeConfig(tuple(seconds), max_shift, max_turn_deg, max_penetration, hold_joints)
    if states is not None and len(find_scenes(paths)[0]) > 1:
        raise ConfigError(
            "`states` of several files", "of one file", "arrays of their names beside them"
        )
    with hold_folder(None if out is None else Path(out)):
        report = judge_scenes(paths, states, config, tuple(detectors), max_starts, jobs)
        return (
            report
            if out is None
            else replace(report, notes=(*report.notes, report.write(Path(out))))
        )
