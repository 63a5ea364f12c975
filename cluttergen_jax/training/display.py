"""What a run shows while it runs: two lines that are drawn anew, or a line now and then in a log."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable
from typing import TextIO

from cluttergen_jax.training.metrics_log import Row

WIDTH = 100
_FIRST = (
    ("success", "success", ".2f"),
    ("placed", "num_placed", ".2f"),
    ("stable steps", "stable_steps", ".0f"),
    ("reward", "reward", ".3f"),
)
_SECOND = (
    ("loss", "loss", ".3g"),
    ("policy", "policy_loss", ".3g"),
    ("value", "value_loss", ".3g"),
    ("entropy", "entropy", ".2f"),
    ("KL", "kl", ".4f"),
    ("clipped", "clipped", ".2f"),
    ("gradient", "gradient_norm", ".2f"),
)
_LOGGED = (*_FIRST[:3], _SECOND[2], _SECOND[3], _SECOND[4])


class Display:
    """Shows the figures of a run.

    Args:
      total: attempts of the whole run; done: those made before now.
      stream: where to; by default, stderr.
      every: seconds between lines where the stream is no terminal.
      clock: seconds; another one for tests.
    """

    def __init__(
        self,
        total: int,
        done: int = 0,
        stream: TextIO | None = None,
        every: float = 10.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._total, self._first, self._stream = total, done, stream or sys.stderr
        self._every, self._clock = every, clock
        self._is_terminal = self._stream.isatty()
        self._started, self._shown = clock(), -float("inf")
        self._is_drawn = False

    def begin(self) -> None:
        """Time runs from now: what came before was compilation."""
        self._started = self._clock()

    def show(self, row: Row) -> None:
        """The newest figures."""
        now, progress = self._clock(), self._progress(row)
        if self._is_terminal:
            self._draw(progress + _figures(row, _FIRST), _figures(row, _SECOND, start=" "))
        elif now - self._shown >= self._every or row["attempts"] >= self._total:
            self._shown = now
            print((progress + _figures(row, _LOGGED)).strip(), file=self._stream, flush=True)

    def say(self, text: str) -> None:
        """A line that stays, above the figures."""
        if self._is_drawn:
            self._stream.write("\r\x1b[K\n\x1b[K\x1b[1A\r")
            self._is_drawn = False
        print(text, file=self._stream, flush=True)

    def close(self) -> None:
        """Leaves the figures where they are; what is printed next stands below."""
        if self._is_drawn:
            self._stream.write("\n\n")
            self._stream.flush()
            self._is_drawn = False

    def _progress(self, row: Row) -> str:
        done = int(row["attempts"])
        elapsed = self._clock() - self._started
        rate = (done - self._first) / elapsed if elapsed > 0 else 0.0
        left = clock_text((self._total - done) / rate) if rate > 0 else "?"
        share = f"{100 * done / self._total:3.0f}% {short(done)}/{short(self._total)}"
        return f" {share}  {row['attempts_per_second']:.0f}/s  {left} left"

    def _draw(self, first: str, second: str) -> None:
        # Both lines are cut, not wrapped: a wrapped line could not be drawn over.
        width = min(WIDTH, shutil.get_terminal_size((WIDTH + 1, 24)).columns - 1)
        self._stream.write(f"\r\x1b[K{first[:width]}\n\x1b[K{second[:width]}\x1b[1A\r")
        self._stream.flush()
        self._is_drawn = True


def _figures(row: Row, wanted: tuple[tuple[str, str, str], ...], start: str = "  ") -> str:
    found = [f"{label} {row[name]:{form}}" for label, name, form in wanted if name in row]
    return start + "  ".join(found)


def short(number: float) -> str:
    """A count in few characters: 950, 12.3k, 250k, 2.5M."""
    for size, letter in ((1e6, "M"), (1e3, "k")):
        if number >= size:
            value = number / size
            return f"{value:.0f}{letter}" if value >= 100 or value == int(value) else f"{value:.1f}{letter}"
    return f"{number:.0f}"


def clock_text(seconds: float) -> str:
    """A duration: 0:42, 12:05, 3 h 20 min."""
    minutes = int(seconds) // 60
    if minutes >= 60:
        return f"{minutes // 60} h {minutes % 60:02d} min"
    return f"{minutes}:{int(seconds) % 60:02d}"
