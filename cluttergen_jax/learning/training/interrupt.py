"""Graceful shutdown: Ctrl-C is answered between compiled calls, where everything can be saved."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any, TypeVar

from cluttergen_jax.numerics import with_own_settings
from cluttergen_jax.progress import run_abandonable

T = TypeVar("T")


class Interrupt:
    """While it is entered, the first Ctrl-C (or SIGTERM) only sets `is_asked`; a second interrupts at once.

    Outside the main thread, where Python allows no handlers, it does nothing.
    """

    _SIGNALS = (signal.SIGINT, signal.SIGTERM)

    def __init__(self) -> None:
        self.is_asked = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Interrupt:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._ask) for number in self._SIGNALS}
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def run_compiling(self, function: Callable[..., T], *args: Any) -> T:
        """The result of a call that compiles, and before which there is nothing to save.

        Raises:
          KeyboardInterrupt: on Ctrl-C or SIGTERM, which do not wait for it.
        """
        if threading.current_thread() is not threading.main_thread():
            return function(*args)
        return run_abandonable(lambda: self.is_asked, with_own_settings(function), *args)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        if self.is_asked:
            raise KeyboardInterrupt
        self.is_asked = True
