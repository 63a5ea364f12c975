"""Functions for a process with limits: one that ends well, and ways to end it. Imports nothing heavy."""

import os


def spin():
    """Computes for ever."""
    while True:
        pass


def end_by(number):
    """Ends its process by a signal."""
    os.kill(os.getpid(), number)


def take_memory():
    """Takes more memory than there is."""
    return len(bytearray(1 << 40))


def add(one, other):
    """Their sum."""
    return one + other


def refuse():
    """Raises an error of ours."""
    from cluttergen_jax.errors import ConfigError

    raise ConfigError("up = 'w'", "an axis", "z")
