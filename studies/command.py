"""`python evaluate.py --suite`: the suites from the command line."""

from __future__ import annotations

from collections.abc import Sequence

from cluttergen_jax.cli.evaluate import status_of
from cluttergen_jax.cli.main import run_words
from cluttergen_jax.cli.options import Options, options_from
from studies.api import evaluate_suite


@options_from(evaluate_suite)
class Suite(Options):
    """Make a suite of tables and figures.

    Writes Markdown, CSV, LaTeX, JSON and pictures for each study. Every row is kept under `results` in that
    folder: rerun to resume. If a row cannot be made, the others are, and the exit status is 1.

    Example: `python evaluate.py --suite paper --quick`
    """

    def run(self) -> int:
        from studies.report import markdown
        from studies.running import num_failed, suite_folder

        results = self.call(evaluate_suite, show=lambda result: print(markdown(result), flush=True))
        folder = self.out or suite_folder(self.suite, self.quick)
        print(f"done       {len(results)} studies in {folder}")
        return status_of(num_failed(results))


def main(words: Sequence[str]) -> int:
    """Parses the words behind `python evaluate.py` and makes the suite; the exit status."""
    return run_words(lambda: Suite, "python evaluate.py", words)
