"""`python -m cluttergen_jax` is the console script `cluttergen`."""

import sys

from cluttergen_jax.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
