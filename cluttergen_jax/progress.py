"""Progress of long work, on a terminal and in a log, and Ctrl-C that ends it in good order."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, wait
from functools import cache
from types import TracebackType
from typing import Any, TextIO, TypeVar

from tqdm import tqdm

from cluttergen_jax.numerics import with_own_settings

T = TypeVar("T")
EVERY = 10.0
"""Seconds between two lines in a log."""
_LONGEST_WAIT = 0.2
stop_asked = threading.Event()
"""Set by the console script at Ctrl-C. An import may swallow a KeyboardInterrupt, which comes again then."""
COMPILING = "compiling where this was not compiled before, which takes about 20 s"


class Progress:
    """Counts what is done: a bar on a terminal; elsewhere a line every ten seconds, and none before.

    Args:
      title: what is done, as in "drawing".
      total: how much there is to do, in `unit`s; kept: how much of that was done before.
      file: where it is shown, stderr if not given; nowhere in a process without one.
      clock: seconds.
    """

    def __init__(
        self,
        title: str,
        total: int,
        unit: str,
        kept: int = 0,
        file: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.title = title
        self.total = total
        self.unit = unit
        self.kept = kept
        self.done = kept
        self._file = file or sys.stderr or _nowhere()
        self._clock = clock
        self._is_log = not self._file.isatty()
        self._bar = tqdm(
            total=total,
            initial=kept,
            desc=title,
            unit=unit,
            file=self._file,
            disable=self._is_log or not total,
        )
        self._started = self._last_line = clock()

    def __enter__(self) -> Progress:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.close()
        if error is None:
            self.close()

    def close(self) -> None:
        """Nothing more is shown; a log that has lines gets a last one."""
        self._bar.close()
        if self._is_log and self._last_line > self._started:
            passed = time_text(self._clock() - self._started)
            self.say(f"{self.title}: {self.done} of {self.total} {self.unit}s done in {passed}")

    def update(self, number: int = 1, note: str = "") -> None:
        """So many more are done; a note stands beside the bar, and in a log's lines."""
        self.done += number
        if note:
            self._bar.set_postfix_str(note, refresh=False)
        self._bar.update(number)
        self._log(note)

    def note(self, text: str) -> None:
        """What is being done: beside the bar; in a log, in lines that come while nothing gets done."""
        if not self._is_log:
            self._bar.set_postfix_str(text)
        self._log(text)

    def _log(self, note: str) -> None:
        """A line in a log, where the last is long ago."""
        now = self._clock()
        if self._is_log and now - self._last_line >= EVERY:
            self._last_line = now
            text = f"{self.title}: {self.done} of {self.total} {self.unit}s, {self.times()}"
            self.say(f"{text}, {note}" if note else text)

    def times(self) -> str:
        """How long it has taken, and at this pace still takes."""
        passed = self._clock() - self._started
        made = self.done - self.kept
        left = f", {time_text(passed / made * (self.total - self.done))} left" if made else ""
        return f"{time_text(passed)} passed{left}"

    def rate(self, more: int = 0) -> float:
        """How many have been done in a second so far, `more` included that are not counted yet."""
        return (self.done + more - self.kept) / max(self._clock() - self._started, 1e-9)

    def rename(self, title: str) -> None:
        """From now on something else is done."""
        self.title = title
        self._bar.set_description(title, refresh=False)

    def say(self, text: str) -> None:
        """A line that stays."""
        if self._is_log:
            print(text, file=self._file, flush=True)
        else:
            self._bar.write(text, file=self._file)


@cache
def _nowhere() -> TextIO:
    return open(os.devnull, "w", encoding="utf-8")


def track(items: Iterable[T], title: str, total: int, unit: str) -> Iterator[T]:
    """The items, with progress."""
    with Progress(title, total, unit) as progress:
        for item in items:
            yield item
            progress.update()


def time_text(seconds: float) -> str:
    """A length of time for people."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def interruptible(function: Callable[..., T], *args: Any) -> T:
    """The result of a call that would keep Ctrl-C waiting, such as a compilation.

    It is made in a thread of its own while this one waits. Where Ctrl-C ends the wait the call is abandoned:
    it goes on until the process ends, and its result is lost. Outside the main thread, where
    Python answers no signals, it is an ordinary call.

    Raises:
      KeyboardInterrupt: Ctrl-C, now or before.
    """
    if stop_asked.is_set():
        raise KeyboardInterrupt
    # What JAX is asked to do differently holds for a thread alone.
    whole = with_own_settings(function)
    if threading.current_thread() is not threading.main_thread():
        return whole(*args)
    return run_abandonable(lambda: False, whole, *args)


def run_abandonable(is_stopped: Callable[[], bool], function: Callable[..., T], *args: Any) -> T:
    """The result of a call that is made in a thread of its own, and abandoned as soon as `is_stopped`.

    Raises:
      KeyboardInterrupt: it was abandoned.
    """
    result: Future[T] = Future()

    def work() -> None:
        try:
            result.set_result(function(*args))
        except BaseException as error:
            result.set_exception(error)

    threading.Thread(target=work, daemon=True).start()
    while not result.done():
        # A signal that comes just before the wait begins does not end it, so no wait is a long one.
        wait([result], _LONGEST_WAIT)
        if is_stopped() and not result.done():
            raise KeyboardInterrupt
    return result.result()
