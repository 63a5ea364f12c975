"""MuJoCo's own log: quiet while an engine reads every warning itself."""

from __future__ import annotations

import io
import threading
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout

import mujoco

_lock = threading.Lock()
_users = 0
_before = mujoco.MjLogConfig.get()


@contextmanager
def silent_import() -> Iterator[None]:
    """Leaves out what MJX prints of packages that are not installed, while it is first imported."""
    said = io.StringIO()
    try:
        with redirect_stdout(said):
            yield
    finally:
        others = [
            line for line in said.getvalue().splitlines() if not line.startswith("Failed to import")
        ]
        print("".join(f"{line}\n" for line in others), end="")


@contextmanager
def silent_log() -> Iterator[None]:
    """MuJoCo neither prints its warnings nor writes MUJOCO_LOG.TXT into the working folder.

    The setting belongs to the whole process, so the last one to leave puts it back. Only for code that looks
    at the warning counters.
    """
    global _users, _before
    with _lock:
        _users += 1
        if _users == 1:
            _before = mujoco.MjLogConfig.get()
            silent = mujoco.MjLogConfig.get()
            silent.logto_console = silent.logto_file = False
            silent.set()
    try:
        yield
    finally:
        with _lock:
            _users -= 1
            if _users == 0:
                _before.set()
