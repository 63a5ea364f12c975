"""`cluttergen evaluate`: methods side by side, or a whole suite of tables and figures."""

from __future__ import annotations

from cluttergen_jax.api.evaluate import evaluate, evaluate_suite
from cluttergen_jax.cli.options import Options, options_from
from cluttergen_jax.config import Suite


@options_from(evaluate, evaluate_suite, suite=Suite | None)
class Evaluate(Options):
    """Compare methods on pools and supports, or make a suite of tables and figures (`--suite`).

    A comparison writes table.md, table.csv, table.tex and results.json; a suite writes Markdown, CSV, LaTeX,
    JSON and pictures for each of its studies. Every row is kept under `results` in that folder: the same
    command takes an interrupted one up again.

    Example: `cluttergen evaluate --methods clear drop --supports table table-0.40x0.50 --trials 200`
    """

    def run(self) -> int:
        """Runs the command; the exit status."""
        if self.suite is None:
            is_downstream = self.heads or self.num_pairs is not None or self.bank is not None
            hint = "--suite downstream" if is_downstream else "--suite paper, extended or downstream"
            out = self.out or "out/evaluation"
            print(self.call(evaluate, "without a suite", hint, out=out).table.markdown())
            return 0
        from cluttergen_jax.evaluation.report import markdown
        from cluttergen_jax.evaluation.running import suite_folder

        hint = "leaving it out: each study has its own"
        results = self.call(
            evaluate_suite, "with a suite", hint, show=lambda result: print(markdown(result), flush=True)
        )
        print(f"done       {len(results)} studies in {self.out or suite_folder(self.suite, self.quick)}")
        return 0
