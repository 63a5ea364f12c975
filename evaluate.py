"""`python evaluate.py` is `cluttergen evaluate`."""

import sys

from cluttergen_jax.cli.main import main

if __name__ == "__main__":
    sys.exit(main(["evaluate", *sys.argv[1:]]))
