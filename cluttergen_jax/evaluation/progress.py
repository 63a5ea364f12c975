"""How far a suite is, and how long it still takes: a bar on a terminal, a line per row in a log."""

from __future__ import annotations

import sys
import time
from typing import TextIO


class Progress:
    """Counts episodes.

    Args:
      total: episodes to be made, those of results at hand left out.
      file: where it is shown; a bar is drawn only on a terminal.
    """

    def __init__(self, total: int, file: TextIO | None = None) -> None:
        self.total, self.done = total, 0
        self._file = file or sys.stderr
        self._started = time.monotonic()
        self._title, self._drawn = "", 0.0

    def begin(self, title: str) -> None:
        """A row begins."""
        self._title = title
        self._draw(force=True)

    def add(self, episodes: int) -> None:
        """Episodes are over."""
        self.done += episodes
        self._draw()

    def skip(self, episodes: int) -> None:
        """Episodes need not be made after all."""
        self.total -= episodes

    def say(self, text: str) -> None:
        """A line that stays."""
        if self._file.isatty():
            self._file.write("\r\x1b[K")
        print(text, file=self._file, flush=True)

    def finish(self, text: str) -> None:
        """A row is done."""
        self.say(f"[{self.done}/{self.total} episodes, {self.time_left()}] {self._title}: {text}")

    def time_left(self) -> str:
        """For people; by the pace so far."""
        if not self.done:
            return "time left unknown"
        seconds = (time.monotonic() - self._started) / self.done * max(self.total - self.done, 0)
        if seconds < 90:
            return f"{seconds:.0f} s left"
        return f"{seconds / 60:.0f} min left" if seconds < 5400 else f"{seconds / 3600:.1f} h left"

    def _draw(self, force: bool = False) -> None:
        now = time.monotonic()
        if not self._file.isatty() or (not force and now - self._drawn < 0.1):
            return
        self._drawn = now
        share = self.done / self.total if self.total else 1.0
        self._file.write(f"\r\x1b[K{share:4.0%} {self.time_left():>18}  {self._title}")
        self._file.flush()
