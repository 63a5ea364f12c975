"""`python -m cluttergen_jax` is the console script `cluttergen`."""

from cluttergen_jax.cli.main import program

if __name__ == "__main__":
    program()
