"""One writer at a time: a lock that the operating system lets go of when its holder ends, however it ends."""

from __future__ import annotations

import datetime
import errno
import json
import os
import socket
from contextlib import suppress
from pathlib import Path

from cluttergen_jax.errors import BankError

try:
    import fcntl
except ImportError:  # Windows has no fcntl.
    fcntl = None  # type: ignore[assignment]

LOCK = ".lock"
_NO_LOCKS = {errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL}


class BankLock:
    """Holds a bank until `release`, or until the process ends.

    The file says who holds it, for messages only: what counts is the system's own lock on it, which a killed
    process cannot leave behind. Where the file system knows no locks, nothing is held.

    Args:
      folder: the bank's, which exists.

    Raises:
      BankError: somebody else holds it; the message says who.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / LOCK
        self._file = _locked(self.path)
        holder = {
            "process": os.getpid(),
            "host": socket.gethostname(),
            "since": datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
        }
        os.ftruncate(self._file, 0)
        os.write(self._file, json.dumps(holder).encode())

    def release(self) -> None:
        """Lets go; once is enough."""
        if self._file >= 0:
            # Removed while it is still held: whoever waits for it notices that the file is gone.
            with suppress(OSError):
                self.path.unlink(missing_ok=True)
            os.close(self._file)
            self._file = -1

    def __del__(self) -> None:
        if getattr(self, "_file", -1) >= 0:
            self.release()


def check_free(folder: Path) -> None:
    """Refuses a folder that another process is writing to; takes no lock.

    Raises:
      BankError: somebody holds the bank in this folder.
    """
    if (path := folder / LOCK).exists():
        os.close(_locked(path))


def _locked(path: Path) -> int:
    """The descriptor of the locked file, made if need be."""
    while True:
        # A link that somebody put there is not followed: what it leads to would be emptied.
        file = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o644)
        try:
            if fcntl is not None:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(file)
            raise BankError(
                f"{path.parent} is being written by {_holder(path)}",
                "one writer at a time",
                "waiting for it to end, stopping it, or another `out`",
            ) from error
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                os.close(file)
                raise
            return file
        if _is_current(file, path):
            return file
        # Its holder let go and removed it between our opening and our locking it.
        os.close(file)


def _is_current(file: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file), os.stat(path))
    except FileNotFoundError:
        return False


def _holder(path: Path) -> str:
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        return f"process {record['process']} on {record['host']}, since {record['since']}"
    except (OSError, ValueError, KeyError, TypeError):
        return "another process"
