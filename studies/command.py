"""`python evaluate.py --suite`: the suites from the command line."""

from __future__ import annotations

from collections.abc import Sequence

from cluttergen_jax.cli.learning import status_of
from cluttergen_jax.cli.main import run_words
from cluttergen_jax.cli.options import Options, command
from studies.api import evaluate_suite


@command(evaluate_suite)
def run_suite(options: Options) -> int:
    """Make a suite of tables and figures.

    Writes Markdown, CSV, LaTeX, JSON and pictures for each study. Every row is kept under `results` in that
    folder: rerun to resume. If a row cannot be made, the others are, and the exit status is 1.

    Example: `python evaluate.py --suite paper --quick`
    """
    from studies.report import markdown
    from studies.running import num_failed, suite_folder

    results = options.call(evaluate_suite, show=lambda result: print(markdown(result), flush=True))
    folder = options.out or suite_folder(options.suite, options.quick)
    print(f"done       {len(results)} studies in {folder}")
    return status_of(num_failed(results))


def main(words: Sequence[str]) -> int:
    """Parses the words behind `python evaluate.py` and makes the suite; the exit status."""
    return run_words(lambda: run_suite.options, "python evaluate.py", words)
