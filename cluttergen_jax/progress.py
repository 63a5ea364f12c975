"""Progress of long work, on a terminal and in a log, and Ctrl-C that ends it in good order."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, wait
from contextlib import contextmanager, suppress
from functools import cache
from types import TracebackType
from typing import Any, TextIO, TypeVar

from tqdm import tqdm

from cluttergen_jax.numerics import with_own_settings

T = TypeVar("T")
EVERY = 10.0
"""Seconds between two lines in a log."""
_TICK = 1.0
"""Seconds after which a terminal shows anew how long something has lasted."""
_LONGEST_WAIT = 0.2
stop_asked = threading.Event()
"""Set by the console script at Ctrl-C. An import may swallow a KeyboardInterrupt, which comes again then."""
COMPILING = "compiling where this was not compiled before, which takes about 20 s"


class _Ticker:
    """Calls a function every second, from a thread of its own, until it is stopped."""

    def __init__(self, tick: Callable[[], None]) -> None:
        self._tick = tick
        self._is_over = threading.Event()
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        # Where what is shown to is closed, nobody waits any more.
        with suppress(ValueError, OSError):
            while not self._is_over.wait(_TICK):
                self._tick()

    def stop(self) -> None:
        self._is_over.set()


class Progress:
    """Counts what is done: a bar on a terminal; elsewhere a line every ten seconds, and none before.

    In a `with` block the seconds go on while nothing gets done, with the last note of what is at work.

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
        self._started = self._timed_from = self._last_line = clock()
        self._note = ""
        self._lock = threading.Lock()
        self._ticker: _Ticker | None = None

    def __enter__(self) -> Progress:
        self._ticker = _Ticker(self._tick)
        return self

    def _tick(self) -> None:
        if self._is_log:
            self._log(self._note)
        else:
            self._bar.refresh()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is None:
            self.close()
        else:
            self._end()

    def _end(self) -> None:
        if self._ticker is not None:
            self._ticker.stop()
        self._bar.close()

    def close(self) -> None:
        """Nothing more is shown; a log that has lines gets a last one."""
        self._end()
        if self._is_log and self._last_line > self._started:
            passed = time_text(self._clock() - self._started)
            self.say(f"{self.title}: {self.done} of {self.total} {self.unit}s done in {passed}")

    def begin_timing(self) -> None:
        """From now on time counts: what is done so far was compiled first, which says nothing of the rest."""
        self.kept = self.done
        self._timed_from = self._clock()
        self._bar.initial = self._bar.n
        self._bar.start_t = time.time()

    def update(self, number: int = 1, note: str = "") -> None:
        """So many more are done; a note stands beside the bar, and in a log's lines."""
        self.done += number
        if note:
            self._bar.set_postfix_str(note, refresh=False)
        self._bar.update(number)
        self._log(note)

    def note(self, text: str) -> None:
        """What is being done: beside the bar; in a log, in lines that come while nothing gets done."""
        self._note = text
        if not self._is_log:
            self._bar.set_postfix_str(text)
        self._log(text)

    def _log(self, note: str) -> None:
        """A line in a log, where the last is long ago."""
        with self._lock:
            now = self._clock()
            is_due = self._is_log and now - self._last_line >= EVERY
            if is_due:
                self._last_line = now
        if is_due:
            text = f"{self.title}: {self.done} of {self.total} {self.unit}s, {self.times()}"
            self.say(f"{text}, {note}" if note else text)

    def times(self) -> str:
        """How long it has taken, and at this pace still takes."""
        passed = self._clock() - self._started
        made = self.done - self.kept
        pace = (self._clock() - self._timed_from) / made if made else 0.0
        left = f", {time_text(pace * (self.total - self.done))} left" if made else ""
        return f"{passed_text(passed)} passed{left}"

    def rate(self, more: int = 0) -> float:
        """How many have been done in a second so far, `more` included that are not counted yet."""
        return (self.done + more - self.kept) / max(self._clock() - self._timed_from, 1e-9)

    def rename(self, title: str) -> None:
        """From now on something else is done."""
        self.title = title
        self._bar.set_description(title, refresh=False)

    def say_compiling(self) -> None:
        """That what follows waits for the compiler first."""
        self.say(COMPILING)

    def say(self, text: str) -> None:
        """A line that stays."""
        if self._is_log:
            # In one piece: lines come from a thread as well.
            self._file.write(f"{text}\n")
            self._file.flush()
        else:
            self._bar.write(text, file=self._file)


@contextmanager
def waiting(
    phase: str,
    reason: str,
    say: Callable[[str], None] | None = None,
    file: TextIO | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> Iterator[None]:
    """Says what is done in the block, without parts that could be counted, and for how many seconds.

    The phase and its reason come first. Then a terminal shows the seconds that have passed; elsewhere there
    is a line every ten seconds, and a last one where there was any.

    Args:
      phase: what is done, as in "compiling"; reason: why it takes long, and about how long.
      say: is given the first line; it goes where the others go if not given.
      file, clock: as of `Progress`.
    """
    file = file or sys.stderr or _nowhere()
    started = last_line = clock()
    is_log = not file.isatty()
    text = f"{phase}: {reason}"
    bar = tqdm(
        desc=phase, bar_format="{desc}: {elapsed} passed", file=file, disable=is_log, leave=False
    )

    def write(line: str) -> None:
        if is_log:
            file.write(f"{line}\n")
            file.flush()
        else:
            bar.write(line, file=file)

    def tick() -> None:
        nonlocal last_line
        now = clock()
        if not is_log:
            bar.refresh()
        elif now - last_line >= EVERY:
            last_line = now
            write(f"{phase}: {passed_text(last_line - started)} passed")

    (say or write)(text)
    # A log of both streams has it before the seconds.
    if sys.stdout is not None:
        sys.stdout.flush()
    ticker = _Ticker(tick)
    try:
        yield
    finally:
        ticker.stop()
        bar.close()
    if is_log and last_line > started:
        write(f"{phase}: done in {passed_text(clock() - started)}")


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


def passed_text(seconds: float) -> str:
    """A length of time that goes on, with its seconds: shown again, it differs from the one before."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if 90 <= seconds < 5400 else time_text(seconds)


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
