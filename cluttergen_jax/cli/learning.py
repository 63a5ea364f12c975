"""The commands about methods: policies trained, encoders pretrained, methods compared."""

from __future__ import annotations

import sys

from cluttergen_jax.api.train import pretrain, train, train_suite
from cluttergen_jax.cli.flags import with_flags
from cluttergen_jax.cli.options import Options, command
from cluttergen_jax.config import Suite
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.api import evaluate

_OF_PROCESSES = ("coordinator", "num_processes", "process_id")


@command(
    train,
    train_suite,
    suite=Suite | None,
    everyday="pool objects num_objects support variant preset paper suite num_attempts seed eval_every out",
)
def run_train(options: Options) -> int:
    """Train a placement policy with PPO. Rerun to resume.

    Example: `cluttergen train --pool dining --preset cpu`
    """
    if options.suite is None:
        options.call(train, "without a suite", "--suite paper")
        return 0
    if options.coordinator is not None:
        raise ConfigError("a suite on several processes", "one run at a time there", "--suite-list")
    hint = "leaving it out: each run has its own"
    report = options.call(train_suite, "with a suite", hint, ignored=_OF_PROCESSES)
    for name, error in report.failed.items():
        print(f"error: {name}: {with_flags(error, options)}", file=sys.stderr)
    if report.failed:
        failed = ", ".join(report.failed)
        print(f"failed: {failed}; the same command tries them again", file=sys.stderr)
    return 1 if report.failed else 0


@command(pretrain)
def run_pretrain(options: Options) -> None:
    """Pretrain a point encoder by classifying shapes. Rerun to resume.

    The classes are the families of the modeller (those of the five pools), each with many objects of drawn
    proportions; accuracy is that on objects that were not learned from.

    Example: `cluttergen pretrain --encoder pointnet2`
    """
    print(f"run        {options.out or f'runs/encoder-{options.encoder}'}")
    report = options.call(pretrain)
    found = (
        f"{report.accuracy:.3f} of {report.num_held_out} shapes of {report.num_families} families"
    )
    print(f"held out   {found} recognised")
    print(f"done       --encoder {options.encoder} --encoder-weights {report.folder}")


@command(
    evaluate,
    everyday=(
        "methods pools supports trials num_objects objects region natural change checkpoints seed out"
    ),
)
def run_evaluate(options: Options) -> int:
    """Compare methods on pools and supports.

    Writes table.md, table.csv, table.tex and results.json. Every row is kept under `results` in that folder:
    rerun to resume. If a row cannot be made, the others are, and the exit status is 1. Suites of tables and
    figures are made in a checkout of the repository: `python evaluate.py --suite paper`.

    Example: `cluttergen evaluate --methods clear drop --supports table table-0.40x0.50 --trials 200`
    """
    found = options.call(evaluate, out=options.out or "out/evaluation")
    print(found.table.markdown(), flush=True)
    return status_of(found.num_missing)


def status_of(num_failed: int) -> int:
    """The exit status where so many rows could not be made, and what is said where it is not 0."""
    if num_failed:
        rows = "1 row" if num_failed == 1 else f"{num_failed} rows"
        print(f"error: {rows} could not be made; why stands below the table", file=sys.stderr)
    return int(num_failed > 0)
