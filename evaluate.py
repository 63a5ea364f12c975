"""`python evaluate.py` is `cluttergen evaluate`; with `--suite` it makes a suite of `studies/`."""

import sys
from collections.abc import Sequence

from cluttergen_jax.cli.main import main, program


def evaluate(words: Sequence[str]) -> int:
    """The exit status of what the words ask for."""
    if any(word.partition("=")[0] == "--suite" for word in words):
        from studies.command import main as make_suite

        return make_suite(words)
    return main(["evaluate", *words])


if __name__ == "__main__":
    program(sys.argv[1:], evaluate)
