"""Folders whose content a recipe decides: the same one continues it, another is refused, one process writes.

What is written appears whole or not at all (`files`).
"""

from __future__ import annotations

import datetime
import errno
import json
import os
import socket
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cluttergen_jax.errors import BankError, ClutterGenError
from cluttergen_jax.files import is_partial, writing

try:
    import fcntl
except ImportError:  # Windows has no fcntl.
    fcntl = None  # type: ignore[assignment]

LOCK = ".lock"
_NO_LOCKS = {errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL}


def changed_settings(ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> list[str]:
    """Which settings differ, such as placement.min_margin, sorted; one that is missing is None."""
    names = []
    for name in {*ours, *theirs}:
        one, other = ours.get(name), theirs.get(name)
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            names += [f"{name}.{inner}" for inner in changed_settings(one, other)]
        elif one != other:
            names.append(name)
    return sorted(names)


def check_recipe(
    place: Path,
    content: str,
    ours: Mapping[str, Any],
    theirs: Mapping[str, Any],
    hint: str = "another `out`",
    error: type[ClutterGenError] = BankError,
) -> None:
    """Refuses to continue what was made by another recipe.

    Args:
      content: what the place holds, as in "a bank made".
      ours: JSON values, and tuples, which are lists in a file; theirs: as read from one.

    Raises:
      ClutterGenError: of the kind `error`, where something differs; the message names it.
    """
    plain = json.loads(json.dumps(ours))
    if changed := changed_settings(plain, theirs):
        what = ", ".join(name + _both_values(name, plain, theirs) for name in changed)
        raise error(
            f"{place} holds {content} with another {what}", "the same settings, which continue it", hint
        )


_LONGEST = 40


def _both_values(name: str, ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> str:
    """The values of a setting, in brackets, where both are short."""
    values = []
    for record in (theirs, ours):
        value: Any = record
        for key in name.split("."):
            value = value.get(key) if isinstance(value, Mapping) else None
        if isinstance(value, list | Mapping) or len(str(value)) > _LONGEST:
            return ""
        values.append(str(value))
    return f" ({values[0]} there, {values[1]} asked for)"


@dataclass(frozen=True)
class KeptFolder:
    """A folder of some kind, which may not exist yet.

    Attributes:
      path: where.
      is_whole: whether a folder is one of the kind.
      refusal: what is said of any other folder, with {path} and {other}, what lies there.
      is_begun: whether a path in it can be there before it is one.
      error: what is raised.
    """

    path: Path
    is_whole: Callable[[Path], bool]
    refusal: str
    is_begun: Callable[[Path], bool]
    error: type[ClutterGenError] = BankError

    @property
    def is_free(self) -> bool:
        """Whether there is none of another kind."""
        return self._other() is None

    def check_place(self) -> None:
        """Refuses a folder that holds something else, or a file (ClutterGenError: of the kind `error`)."""
        if (other := self._other()) is not None:
            given = self.refusal.format(path=self.path, other=other)
            raise self.error(given, "a new or empty folder, or one of that kind", "another `out`")

    def _other(self) -> Path | None:
        if not self.path.is_dir():
            return self.path if self.path.exists() else None
        # A writer that was killed before anything was finished leaves a lock, and what is half written.
        found = sorted(each for each in self.path.iterdir() if each.name != LOCK)
        other = next((each for each in found if not (is_partial(each.name) or self.is_begun(each))), None)
        # Asked last: what another process has finished in the meantime makes the folder whole.
        return None if self.is_whole(self.path) else other

    def lock(self) -> FolderLock:
        """Holds the folder, which is made if need be; `check_place` comes first.

        Raises:
          ClutterGenError: likewise; or another process writes there, or it cannot be written.
        """
        with writing(self.path):
            self.check_place()
            self.path.mkdir(parents=True, exist_ok=True)
            return FolderLock(self.path)


class FolderLock:
    """Holds a folder until `release`, until the end of a `with` block, or until the process ends.

    The file says who holds it, for messages only: what counts is the system's own lock on it, which a killed
    process cannot leave behind. Where the file system knows no locks, nothing is held.

    Args:
      folder: what is held, which may not exist yet if there is a `file`.
      file: in a folder that exists, removed again by `release`; None is one in the folder itself.

    Raises:
      BankError: another process holds it; the message says which.
    """

    def __init__(self, folder: Path, file: Path | None = None) -> None:
        self.path = file or folder / LOCK
        self._file = _open_locked(self.path, folder)
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
            # Removed while it is still held: a process that waits for it notices that the file is gone.
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
      BankError: another process holds it.
    """
    folder = folder.absolute()
    folder.parent.mkdir(parents=True, exist_ok=True)
    return FolderLock(folder, folder.with_name(f".{folder.name}.lock"))


def check_unlocked(folder: Path) -> None:
    """Refuses a folder that another process is writing to; takes no lock (BankError: one holds it)."""
    if (folder / LOCK).exists():
        os.close(_open_locked(folder / LOCK, folder))


def _open_locked(path: Path, folder: Path) -> int:
    """The descriptor of the locked file, made if need be."""
    while True:
        # A link is not followed: what it leads to would be emptied.
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
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file), os.stat(path)):
                return file
        # Its holder let go and removed it between our opening and our locking it.
        os.close(file)


def _holder(path: Path) -> str:
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        return f"process {record['process']} on {record['host']}, since {record['since']}"
    except (OSError, ValueError, KeyError, TypeError):
        return "another process"
