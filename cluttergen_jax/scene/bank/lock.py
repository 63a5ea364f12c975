"""One writer of a bank at a time, by a file in its folder."""

from __future__ import annotations

from pathlib import Path

from cluttergen_jax.locks import FolderLock, check_unlocked

LOCK = ".lock"


class BankLock(FolderLock):
    """Holds a bank until `release`, or until the process ends.

    Args:
      folder: the bank's, which exists.

    Raises:
      BankError: somebody else holds it; the message says who.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__(folder / LOCK, folder)


def check_free(folder: Path) -> None:
    """Refuses a folder that another process is writing to; takes no lock.

    Raises:
      BankError: somebody holds the bank in this folder.
    """
    check_unlocked(folder / LOCK, folder)
