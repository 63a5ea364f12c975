"""`python train.py` is `cluttergen train`."""

import sys

from cluttergen_jax.cli.main import program

if __name__ == "__main__":
    program(["train", *sys.argv[1:]])
