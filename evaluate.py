"""`python evaluate.py` is `cluttergen evaluate`."""

import sys

from cluttergen_jax.cli.main import program

if __name__ == "__main__":
    program(["evaluate", *sys.argv[1:]])
