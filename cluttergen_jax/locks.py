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

_NO_LOCKS = {errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL}


class FolderLock:
    """Holds a folder until `release`, until the end of a `with` block, or until the process ends.

    The file says who holds it, for messages only: what counts is the system's own lock on it, which a killed
    process cannot leave behind. Where the file system knows no locks, nothing is held.

    Args:
      path: the file, in a folder that exists; removed again by `release`.
      folder: what is held, which may not exist yet.

    Raises:
      BankError: somebody else holds it; the message says who.
    """

    def __init__(self, path: Path, folder: Path) -> None:
        self.path = path
        self._file = _open_locked(path, folder)
        holder = {
            "process": os.getpid(),
            "host": socket.gethostname(),
            "since": datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
        }
        os.ftruncate(self._file, 0)
        os.write(self._file, json.dumps(holder).encode())

    def __enter__(self) -> FolderLock:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

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


def lock_beside(folder: Path) -> FolderLock:
    """Holds a folder that is made anew, and may not exist yet, by a file beside it.

    Raises:
      BankError: somebody else holds it.
    """
    folder = folder.absolute()
    folder.parent.mkdir(parents=True, exist_ok=True)
    return FolderLock(folder.with_name(f".{folder.name}.lock"), folder)


def check_unlocked(path: Path, folder: Path) -> None:
    """Refuses a folder that another process is writing to; takes no lock (BankError)."""
    if path.exists():
        os.close(_open_locked(path, folder))


def _open_locked(path: Path, folder: Path) -> int:
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
                f"{folder} is being written by {_holder(path)}",
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
