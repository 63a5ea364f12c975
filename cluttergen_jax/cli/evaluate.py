"""`cluttergen evaluate`: methods side by side, or a whole suite of tables and figures."""

from __future__ import annotations

import sys

from cluttergen_jax.cli.options import Options, options_from
from cluttergen_jax.config import Suite
from cluttergen_jax.downstream.api import evaluate_suite
from cluttergen_jax.evaluation.api import evaluate


@options_from(evaluate, evaluate_suite, suite=Suite | None)
class Evaluate(Options):
    """Compare methods on pools and supports, or make a suite of tables and figures (`--suite`).

    A comparison writes table.md, table.csv, table.tex and results.json; a suite writes Markdown, CSV, LaTeX,
    JSON and pictures for each of its studies. Every row is kept under `results` in that folder:
    rerun to resume. If a row cannot be made, the others are, and the exit status
    is 1.

    Example: `cluttergen evaluate --methods clear drop --supports table table-0.40x0.50 --trials 200`
    """

    def run(self) -> int:
        if self.suite is None:
            is_downstream = self.heads or self.num_pairs is not None or self.bank is not None
            hint = (
                "--suite downstream" if is_downstream else "--suite paper, extended or downstream"
            )
            out = self.out or "out/evaluation"
            found = self.call(evaluate, "without a suite", hint, out=out)
            print(found.table.markdown(), flush=True)
            return _status(found.num_missing)
        from cluttergen_jax.evaluation.report import markdown
        from cluttergen_jax.evaluation.running import num_failed, suite_folder

        hint = "leaving it out: each study has its own"
        results = self.call(
            evaluate_suite,
            "with a suite",
            hint,
            show=lambda result: print(markdown(result), flush=True),
        )
        print(
            f"done       {len(results)} studies in {self.out or suite_folder(self.suite, self.quick)}"
        )
        return _status(num_failed(results))


def _status(num_failed: int) -> int:
    """The exit status, and what is said where it is not 0."""
    if num_failed:
        rows = "1 row" if num_failed == 1 else f"{num_failed} rows"
        print(f"error: {rows} could not be made; why stands below the table", file=sys.stderr)
    return int(num_failed > 0)
