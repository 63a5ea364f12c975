"""From the options of `cluttergen evaluate` to tables: a comparison of methods, or the studies of a suite."""

from __future__ import annotations

import csv
import dataclasses
import io
import shlex
from pathlib import Path
from typing import Any

from cluttergen_jax.assets.pool import composed, find_pool, list_pools
from cluttergen_jax.baselines import METHODS as BASELINES
from cluttergen_jax.cli.evaluate import Evaluate
from cluttergen_jax.errors import PoolError
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
from cluttergen_jax.files import write_atomically

_DEFAULT_TRIALS = 1000


def _lab(args: Evaluate, out: Path, trials: tuple[Trial, ...]) -> Lab:
    """A lab that knows how much is left to do; what cannot be found is said before anything runs."""
    checkpoints = Checkpoints(
        folder=None if args.checkpoints is None else Path(args.checkpoints),
        path=None if args.checkpoint is None else Path(args.checkpoint),
    )
    store = Store(out / "results", Progress(0).say)
    lab = Lab(store, checkpoints, args.engine, args.threads, args.fresh)
    lab.check(trials)
    # Before hours of work: a place that cannot be written to.
    out.mkdir(parents=True, exist_ok=True)
    lab.progress = _planned(lab, trials)
    return lab


def _planned(lab: Lab, trials: tuple[Trial, ...]) -> Progress:
    """Progress over all rows that can be made, those at hand counted as done; said at once."""
    at_hand = {trial: lab.at_hand(trial) for trial in trials}
    rows = {trial: known is not None for trial, known in at_hand.items() if "missing" not in (known or {})}
    episodes = sum(trial.num_episodes for trial in rows)
    kept = [trial for trial, is_kept in rows.items() if is_kept]
    progress = Progress(episodes, len(rows), len(kept), sum(trial.num_episodes for trial in kept))
    progress.say(f"{len(rows)} rows, {len(kept)} kept from before, {len(rows) - len(kept)} to be made")
    return progress


def compare(args: Evaluate) -> int:
    """Runs methods side by side and writes their table; the exit status."""
    out = Path(args.out or "out/evaluation")
    methods: tuple[str, ...] = args.methods or tuple(BASELINES)
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
        for method in methods
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


def run_suite(args: Evaluate, suite: str) -> int:
    """Runs the studies of a suite and writes each as it is done; the exit status."""
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
