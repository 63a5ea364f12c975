"""`cluttergen evaluate`: methods side by side."""

from __future__ import annotations

import sys

from cluttergen_jax.cli.options import Options, options_from
from cluttergen_jax.evaluation.api import evaluate


@options_from(evaluate)
class Evaluate(Options):
    """Compare methods on pools and supports.

    Writes table.md, table.csv, table.tex and results.json. Every row is kept under `results` in that folder:
    rerun to resume. If a row cannot be made, the others are, and the exit status is 1. Suites of tables and
    figures are made in a checkout of the repository: `python evaluate.py --suite paper`.

    Example: `cluttergen evaluate --methods clear drop --supports table table-0.40x0.50 --trials 200`
    """

    def run(self) -> int:
        found = self.call(evaluate, out=self.out or "out/evaluation")
        print(found.table.markdown(), flush=True)
        return status_of(found.num_missing)


def status_of(num_failed: int) -> int:
    """The exit status where so many rows could not be made, and what is said where it is not 0."""
    if num_failed:
        rows = "1 row" if num_failed == 1 else f"{num_failed} rows"
        print(f"error: {rows} could not be made; why stands below the table", file=sys.stderr)
    return int(num_failed > 0)
