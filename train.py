"""`python train.py` is `cluttergen train`."""

import sys

from cluttergen_jax.cli.main import main

if __name__ == "__main__":
    sys.exit(main(["train", *sys.argv[1:]]))
