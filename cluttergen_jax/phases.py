"""What a process is at: said where the work is done, heard by whoever waits for it. Needs nothing else."""

from __future__ import annotations

from collections.abc import Callable

_hearers: list[Callable[[str], None]] = []


def hear_phases(hear: Callable[[str], None]) -> None:
    """From now on `hear` is given what this process says of its work by `say_phase`."""
    _hearers.append(hear)


def say_phase(text: str) -> None:
    """What this process begins to do now, for those who wait for it; where somebody does."""
    for hear in _hearers:
        hear(text)
