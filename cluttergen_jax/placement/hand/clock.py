"""How long a person was at work."""

from __future__ import annotations

import time
from collections.abc import Callable

IDLE = 60.0
"""Seconds without any input after which nobody is taken to be at work."""


class ActiveClock:
    """Seconds of work: it runs from the first input on, and stands still `idle` seconds after the latest.

    Args:
      now: seconds, from any beginning.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic, idle: float = IDLE) -> None:
        self._now = now
        self._idle = idle
        self._before = 0.0
        self._latest = None

    _latest: float | None

    def touch(self) -> None:
        """There was an input."""
        self._latest = self._now()
        self._before = self.seconds

    def stop(self) -> None:
        """Nothing more counts until the next input."""
        self._before = self.seconds
        self._latest = None

    @property
    def seconds(self) -> float:
        """So far."""
        since = 0.0 if self._latest is None else self._now() - self._latest
        return self._before + min(since, self._idle)
