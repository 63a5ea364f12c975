"""What a process says of its work while another waits for it."""

from collections.abc import Callable

_hearers: list[Callable[[str], None]] = []


def hear_phases(hear: Callable[[str], None]) -> None:
    """From now on `hear` is given what this process says of its work by `say_phase`."""
    _hearers.append(hear)


def say_phase(text: str) -> None:
    """What this process begins to do now, for those who wait for it; nobody may be there to hear it."""
    for hear in _hearers:
        hear(text)
