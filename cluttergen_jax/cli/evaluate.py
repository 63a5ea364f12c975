"""`cluttergen evaluate`: methods side by side, or a whole suite of tables and figures."""

from __future__ import annotations

import csv
import dataclasses
import io
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cluttergen_jax.assets.pool import composed, find_pool, list_pools
from cluttergen_jax.bank.disk import write_atomically
from cluttergen_jax.baselines import METHODS as BASELINES
from cluttergen_jax.cli.parse import refuse_given
from cluttergen_jax.config import check_workers
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.evaluation.checkpoints import Checkpoints
from cluttergen_jax.evaluation.document import document
from cluttergen_jax.evaluation.lab import Lab
from cluttergen_jax.evaluation.progress import Progress
from cluttergen_jax.evaluation.published import IMPORTED, OBJECTS
from cluttergen_jax.evaluation.report import markdown as study_markdown
from cluttergen_jax.evaluation.report import write_report
from cluttergen_jax.evaluation.store import Store, json_bytes
from cluttergen_jax.evaluation.studies import run_study
from cluttergen_jax.evaluation.suites import Scale, Study, find_suite
from cluttergen_jax.evaluation.tables import Table, interval, missing, number, share
from cluttergen_jax.evaluation.trial import Trial

_DEFAULT_TRIALS = 1000
_OF_SUITES = ("only", "quick", "seeds")
_OF_COMPARISONS = ("exclude", "supports", "num_objects", "attempts", "repeat", "change")


@dataclass(frozen=True)
class Evaluate:
    """Compare methods on pools and supports, or make a suite of tables and figures (`--suite`).

    A comparison writes table.md, table.csv, table.tex and results.json; a suite writes Markdown, CSV, LaTeX,
    JSON and pictures for each of its studies. Every row is kept under `results` in that folder: the same
    command takes an interrupted one up again.

    Attributes:
      methods: random, clear, drop (these three if not given), and trained policies: policy, policy-clear,
        ranked, beta, normal, open_loop, short_memory. Of a suite, the rows that are made; all if not given.
      checkpoint: the policy's folder, for learned methods; else the embedded ones are taken.
      checkpoints: a folder of training runs, POOL-VARIANT[-attemptsA][-SEED], instead of the embedded ones.
      pools: names or folders, or several joined by +; dining if not given, and what each study asks for in a
        suite.
      exclude: names of objects to leave out of each pool; --exclude mug is the same as --pools dining~mug.
      supports: names or folders; table-0.40x0.50 is a cuboid of that size, all of it the queried region.
      num_objects: objects per scene.
      trials: scenes per row; 1000 if not given, and what each study asks for in a suite.
      seed: of the scenes.
      attempts: per object.
      repeat: let objects stand there more than once.
      change: how the queried region is changed at random in every episode: none, translation, rotation,
        shrinkage, expansion or all.
      suite: paper (its tables and figures) or honest (what it does not ask); supports, num_objects, attempts,
        repeat and change are then the studies' own.
      only: names of studies of the suite; all of them if not given.
      quick: a few trials a row: the whole paper suite in minutes.
      seeds: training seeds where a table asks for several, 3 if not given, 1 if quick; those without a
        checkpoint are left out.
      engine: auto, native, warp or jax.
      threads: simulation threads; 0 takes every core.
      fresh: make rows again that are at hand.
      out: where everything goes; out/evaluation, or out/SUITE, if not given.
    """

    methods: tuple[str, ...] = ()
    checkpoint: str | None = None
    checkpoints: str | None = None
    pools: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    supports: tuple[str, ...] = ("table",)
    num_objects: int = 10
    trials: int | None = None
    seed: int = 0
    attempts: int = 5
    repeat: bool = False
    change: str = "none"
    suite: str | None = None
    only: tuple[str, ...] = ()
    quick: bool = False
    seeds: int | None = None
    engine: str = "auto"
    threads: int = 0
    fresh: bool = False
    out: str | None = None

    def run(self) -> int:
        """Runs the command; the exit status."""
        if self.trials is not None and not 1 <= self.trials <= 1_000_000:
            raise ConfigError(f"--trials {self.trials}", "1 to 1000000")
        if self.seeds is not None and not 1 <= self.seeds <= 100:
            raise ConfigError(f"--seeds {self.seeds}", "1 to 100")
        check_workers("--threads", self.threads)
        if self.suite is None:
            refuse_given(self, _OF_SUITES, "without a suite", "--suite paper or --suite honest")
            if not self.supports:
                raise ConfigError("--supports with nothing after it", "one name or more")
        else:
            refuse_given(self, _OF_COMPARISONS, "with a suite", "leaving it out: each study has its own")
        return _compare(self) if self.suite is None else _run_suite(self, self.suite)


def _lab(args: Evaluate, out: Path, trials: tuple[Trial, ...]) -> Lab:
    """A lab that knows how much is left to do; what cannot be found is said before anything runs."""
    checkpoints = Checkpoints(
        folder=None if args.checkpoints is None else Path(args.checkpoints),
        path=None if args.checkpoint is None else Path(args.checkpoint),
    )
    progress = Progress(0)
    lab = Lab(
        Store(out / "results", progress.say), checkpoints, args.engine, args.threads, args.fresh, progress
    )
    lab.check(trials)
    # Before hours of work: a place that cannot be written to.
    out.mkdir(parents=True, exist_ok=True)
    progress.total = sum(trial.num_episodes for trial in dict.fromkeys(trials) if lab.at_hand(trial) is None)
    return lab


def _compare(args: Evaluate) -> int:
    out = Path(args.out or "out/evaluation")
    trials = tuple(
        Trial(
            pool=composed(pool, args.exclude),
            support=support,
            method=method,
            num_objects=args.num_objects,
            attempts=args.attempts,
            trials=args.trials or _DEFAULT_TRIALS,
            seed=args.seed,
            repeat=args.repeat,
            change=args.change,
        )
        for pool in args.pools or ("dining",)
        for support in args.supports
        for method in args.methods or tuple(BASELINES)
    )
    lab = _lab(args, out, trials)
    records = [lab.record(trial) for trial in trials]
    if all("figures" not in record for record in records):
        raise PoolError(records[0]["missing"], hint=records[0]["hint"])
    table = comparison(records)
    print(table.markdown())
    write_atomically(out / "table.md", (table.markdown() + "\n").encode())
    write_atomically(out / "table.csv", csv_text([row_of(record) for record in records]).encode())
    write_atomically(out / "table.tex", table.latex().encode())
    write_atomically(out / "results.json", json_bytes([row_of(record) for record in records]))
    return 0


def _run_suite(args: Evaluate, suite: str) -> int:
    out = Path(args.out or f"out/{suite}{'-quick' if args.quick else ''}")
    seeds = args.seeds or (1 if args.quick else 3)
    scale = Scale(args.quick, args.trials, seeds, args.pools, args.methods, args.seed, imported_pools())
    studies = find_suite(suite, scale, args.only)
    # Times are measured in processes of their own, after everything else.
    lab = _lab(args, out, tuple(t for s in studies if s.measure != "timing" for t in s.trials))
    results = []
    for study in studies:
        result = run_study(lab, study, out, suite, command_of(args, study), args.quick)
        write_report(result, out)
        print(study_markdown(result), flush=True)
        results.append(result)
    write_atomically(out / "all.md", document(results, link="").encode())
    print(f"done       {len(results)} studies in {out}")
    return 0


def imported_pools() -> tuple[tuple[str, int], ...]:
    """Pools of the paper's own objects that are at hand, and how many a scene of each has."""
    names = [name for name in list_pools() if name.startswith(IMPORTED)]
    return tuple((name, min(OBJECTS, len(find_pool(name)))) for name in names)


def command_of(args: Evaluate, study: Study) -> str:
    """What makes one study again."""
    words = ["cluttergen evaluate"]
    for each in dataclasses.fields(args):
        value = getattr(args, each.name)
        if each.name in ("only", "out", "fresh") or value == each.default:
            continue
        flag = "--" + each.name.replace("_", "-")
        values = list(value) if isinstance(value, tuple) else [value]
        words.append(flag if value is True else " ".join([flag, *(shlex.quote(str(v)) for v in values)]))
    return " ".join([*words, f"--only {study.name}"])


def row_of(record: dict[str, Any]) -> dict[str, Any]:
    """A record as one flat row."""
    trial, figures = record["trial"], record.get("figures", {})
    row = {
        "pool": trial["pool"],
        "support": trial["support"],
        "objects": trial["num_objects"],
        "method": trial["method"],
        "trials": trial["trials"],
    }
    names = (
        "success",
        "low95",
        "high95",
        "filled",
        "placed",
        "attempts_per_valid_scene",
        "simulated_steps_per_valid_scene",
        "valid_scenes_per_cpu_second",
        "valid_scenes_per_second",
        "seconds",
        "compile_seconds",
    )
    return row | {name: figures.get(name) for name in names} | {"missing": record.get("missing")}


def comparison(records: list[dict[str, Any]]) -> Table:
    """The table for people; speeds leave compilation out."""
    columns = (
        "pool",
        "support",
        "objects",
        "method",
        "success [95 %]",
        "filled",
        "placed",
        "attempts per valid scene",
        "valid scenes per CPU-second",
    )
    rows = []
    for record in records:
        row = row_of(record)
        head = (row["pool"], row["support"], str(row["objects"]), row["method"])
        if row["missing"]:
            rows.append((*head, missing(record), *["-"] * 4))
            continue
        rows.append(
            (
                *head,
                interval(row["success"], row["low95"], row["high95"]),
                share(row["filled"]),
                number(row["placed"], 2),
                number(row["attempts_per_valid_scene"]) if row["success"] else "-",
                number(row["valid_scenes_per_cpu_second"]),
            )
        )
    return Table(f"{records[0]['trial']['trials']} trials a row", columns, tuple(rows))


def csv_text(rows: list[dict[str, Any]]) -> str:
    """Flat rows with all digits."""
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
