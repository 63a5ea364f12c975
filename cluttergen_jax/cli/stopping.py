"""Ctrl-C while the main thread is in a call that answers none, such as a compilation: the process ends."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

GRACE = 3.0
"""Seconds in which a signal has to be answered."""


def watch_signals(usual: Callable[..., Any]) -> None:
    """Ends the process with 128 + the signal where one is not answered in time. For the main thread, once.

    Python answers a signal between two steps of the main thread. One that comes while that thread is in
    compiled code is seen by a thread of its own. What is on disk is whole whenever a process ends.

    Args:
      usual: the handler of Ctrl-C that is there as long as nobody has answered, or has taken it over to save
        what there is first (`learning.training.interrupt`). A second signal waits for nobody.
    """
    reads, writes = os.pipe()
    os.set_blocking(writes, False)
    signal.set_wakeup_fd(writes, warn_on_full_buffer=False)

    def watch() -> None:
        count = 0
        while True:
            for number in os.read(reads, 64):
                if number in (signal.SIGINT, signal.SIGTERM):
                    count += 1
                    threading.Thread(target=_end_late, args=(number, count, usual), daemon=True).start()

    threading.Thread(target=watch, daemon=True).start()


def _end_late(number: int, count: int, usual: Callable[..., Any]) -> None:
    time.sleep(GRACE)
    if count > 1 or signal.getsignal(signal.SIGINT) is usual:
        print("\nstopped; rerun the command to resume", file=sys.stderr, flush=True)
        os._exit(128 + number)
