"""How far a suite is, and how long it still takes: a bar on a terminal, lines in a log."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import TextIO

from cluttergen_jax.progress import EVERY, time_text


class Progress:
    """Counts rows and episodes, those at hand included.

    Args:
      total: episodes of all rows.
      rows: how many there are.
      kept: rows at hand from before; kept_episodes: theirs.
      file: where it is shown, stderr if not given; a bar is drawn only on a terminal.
      clock: seconds.
    """

    def __init__(
        self,
        total: int,
        rows: int = 0,
        kept: int = 0,
        kept_episodes: int = 0,
        file: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.total, self.rows, self.kept, self.kept_episodes = total, rows, kept, kept_episodes
        self.done, self.rows_done = kept_episodes, kept
        self._file, self._clock = file or sys.stderr, clock
        self._started = clock()
        self._title, self._drawn = "", self._started

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
        self.rows_done += 1
        self._drawn = self._clock()
        self.say(f"[{self.standing()}] {self._title}: {text}")

    def standing(self) -> str:
        """Rows that are done of all, those from before, and the time left."""
        kept = f", {self.kept} kept from before" if self.kept else ""
        return f"{self.rows_done} of {self.rows} rows{kept}, {self.time_left()}"

    def time_left(self) -> str:
        """For people; by the pace so far."""
        made = self.done - self.kept_episodes
        if not made:
            return "time left unknown"
        return f"{time_text((self._clock() - self._started) / made * max(self.total - self.done, 0))} left"

    def _draw(self, force: bool = False) -> None:
        now = self._clock()
        if not self._file.isatty():
            if force or now - self._drawn >= EVERY:
                self._drawn = now
                begins = "begins, compiling first" if force else f"{self.done} of {self.total} episodes"
                self.say(f"[{self.standing()}] {self._title}: {begins}")
            return
        if not force and now - self._drawn < 0.1:
            return
        self._drawn = now
        share = self.done / self.total if self.total else 1.0
        self._file.write(f"\r\x1b[K{share:4.0%} {self.time_left():>18}  {self._title}")
        self._file.flush()
