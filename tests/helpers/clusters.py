"""Work for tests of clusters: at module level, so that a worker finds it by name."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path


def squares() -> Callable[[int], tuple[int, int]]:
    """Makes a function that squares, and says in which process."""
    return lambda item: (item * item, os.getpid())


class Meeting:
    """The same, where nobody begins before so many processes are there.

    Args:
      folder: where they meet.
    """

    def __init__(self, folder: Path, number: int) -> None:
        self.folder = folder
        self.number = number

    def __call__(self) -> Callable[[int], tuple[int, int]]:
        """The function."""
        Path(self.folder, str(os.getpid())).touch()
        while len(list(self.folder.iterdir())) < self.number:
            time.sleep(0.01)
        return squares()


def variables() -> Callable[[str], str | None]:
    """Makes a function that looks up an environment variable."""
    return os.environ.get


class Deaths:
    """Makes a function that kills its process at item 3, at most so many times in all.

    Args:
      folder: keeps count.
    """

    def __init__(self, folder: Path, most: int) -> None:
        self.folder = folder
        self.most = most

    def __call__(self) -> Callable[[int], int]:
        """The function."""

        def work(item: int) -> int:
            if item == 3 and len(list(self.folder.iterdir())) < self.most:
                Path(self.folder, str(os.getpid())).touch()
                os.kill(os.getpid(), signal.SIGKILL)
            return -item

        return work
