"""Folders whose content a recipe decides: the same one continues it, another is refused, one process writes.

What is written appears whole or not at all (`files`).
"""

from __future__ import annotations

import datetime
import errno
import functools
import inspect
import json
import os
import socket
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from cluttergen_jax.errors import BankError, ClutterGenError
from cluttergen_jax.files import is_partial, writing

try:
    import fcntl
except ImportError:  # Windows has no fcntl.
    fcntl = None  # type: ignore[assignment]

_P = ParamSpec("_P")
_R = TypeVar("_R")
LOCK = ".lock"
_NO_LOCKS = {errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL}


def changed_settings(ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> list[str]:
    """Which settings differ, such as placement.min_margin, sorted; one that is missing is None."""
    names = []
    for name in {*ours, *theirs}:
        one = ours.get(name)
        other = theirs.get(name)
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
            f"{place} holds {content} with another {what}",
            "the same settings, which continue it",
            hint,
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
        other = next(
            (each for each in found if not (is_partial(each.name) or self.is_begun(each))), None
        )
        # Asked last: what another process has finished in the meantime makes the folder whole.
        return None if self.is_whole(self.path) else other

    def lock(self, patience: float = 0.0) -> FolderLock:
        """Holds the folder, which is made if need be, and then looks at what it holds (`check_place`).

        What a folder holds is judged under its lock alone: nobody sees what another writer has half begun.

        Args:
          patience: seconds to wait for another process.

        Raises:
          ClutterGenError: likewise; or another process writes there, or it cannot be written.
        """
        with writing(self.path):
            try:
                return FolderLock(self.path, check=self.check_place, patience=patience)
            except OSError:
                # A file, or something of other people, which takes no lock.
                self.check_place()
                raise


_held: ContextVar[frozenset[Path]] = ContextVar("held folders", default=frozenset())
"""The lock files that `hold` blocks around this code hold; threads begin with none."""
# Seconds between two tries, and after which a wait is said.
_PAUSE = 0.02
_SILENT = 1.0

PATIENCE = 60.0
"""Seconds for which a short change waits for another one."""


class FolderLock:
    """Holds a folder until `release`, until the end of a `with` block, or until the process ends.

    The file says who holds it, for messages only: what counts is the system's own lock on it, which a killed
    process cannot leave behind. Where the file system knows no locks, nothing is held.

    Args:
      folder: what is held; it is made if need be, and removed again where a check or the block fails, if it
        is still empty.
      file: in place of one in the folder, which then need not exist; removed again by `release`.
      check: looks at the folder once it is held; what it raises is passed on, and the folder is let go.
      patience: seconds to wait for another process.

    Raises:
      BankError: another process holds it; the message says which.
      OSError: the file cannot be made.
    """

    def __init__(
        self,
        folder: Path,
        file: Path | None = None,
        check: Callable[[], None] | None = None,
        patience: float = 0.0,
    ) -> None:
        self.path = Path(
            os.path.realpath((file or folder / LOCK).parent), (file or folder / LOCK).name
        )
        self._file = -1
        self._made = list[Path]()
        self._is_ours = True
        if self.path in _held.get():
            if check is not None:
                check()
            return
        self._open(folder, patience)
        try:
            if check is not None:
                check()
        except BaseException:
            # A file of this name that holds something was there before, and may be somebody else's.
            self._is_ours = os.fstat(self._file).st_size == 0
            self.release(is_kept=False)
            raise
        # What another program keeps under this name is left as it is.
        self._is_ours = os.pread(self._file, 1, 0) in (b"", b"{")
        if self._is_ours:
            holder = {
                "process": os.getpid(),
                "host": socket.gethostname(),
                "since": datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
            }
            os.ftruncate(self._file, 0)
            os.write(self._file, json.dumps(holder).encode())

    def _open(self, folder: Path, patience: float) -> None:
        begun = time.monotonic()
        is_said = False
        while True:
            try:
                self._make_folders()
                self._file = _open_locked(self.path, folder)
                return
            except FileNotFoundError:
                # Whoever had made the folder let go and removed it, empty as it was.
                continue
            except FileExistsError:
                # Likewise, but for what is there and is no folder.
                if os.path.lexists(self.path.parent) and not self.path.parent.is_dir():
                    raise
            except BankError as error:
                waited = time.monotonic() - begun
                if waited >= patience:
                    raise
                if waited > _SILENT and not is_said:
                    print(
                        f"note: {error.given}: waiting for it, {patience:g} s at most",
                        file=sys.stderr,
                    )
                    is_said = True
                time.sleep(_PAUSE)

    def _make_folders(self) -> None:
        place = self.path.parent
        missing = list[Path]()
        while not place.exists():
            missing.append(place)
            place = place.parent
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._made += [each for each in missing if each not in self._made]

    def __enter__(self) -> FolderLock:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        self.release(is_kept=kind is None)

    def release(self, is_kept: bool = True) -> None:
        """Lets go; once is enough.

        Args:
          is_kept: folders that were made for it stay even if they are empty.
        """
        if self._file >= 0:
            # Removed while it is still held: a process that waits for it notices that the file is gone.
            if self._is_ours:
                with suppress(OSError):
                    self.path.unlink(missing_ok=True)
            if not is_kept:
                with suppress(OSError):
                    for each in self._made:
                        each.rmdir()
            os.close(self._file)
            self._file = -1

    def __del__(self) -> None:
        if getattr(self, "_file", -1) >= 0:
            self.release()


@contextmanager
def hold(lock: FolderLock) -> Iterator[None]:
    """Holds a folder in the block, in which the same thread may lock it again.

    A command holds its folder so, from its first check to its last write; what it calls holds it for itself.
    """
    with lock:
        token = _held.set(_held.get() | {lock.path})
        try:
            yield
        finally:
            _held.reset(token)


def hold_folder(folder: Path | None) -> AbstractContextManager[None]:
    """Holds a folder of whatever kind in the block, in which the same thread may lock it again.

    Args:
      folder: made if need be, and removed again where the block fails and it is empty; None holds nothing.

    Raises:
      BankError: another process writes there, or it cannot be written.
    """
    if folder is None:
        return nullcontext()
    with writing(folder):
        return hold(FolderLock(folder))


def hold_file(path: str | Path | None) -> AbstractContextManager[None]:
    """Holds a single file in the block, which need not exist; None holds nothing. Raises as `hold_folder`."""
    if path is None:
        return nullcontext()
    with writing(Path(path)):
        return hold(lock_beside(Path(path)))


def hold_out(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """The function, which holds the folder of its argument `out` (`hold_folder`) while it runs."""
    signature = inspect.signature(function)

    @functools.wraps(function)
    def held(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        given = signature.bind(*args, **kwargs)
        given.apply_defaults()
        with hold_folder(given.arguments["out"]):
            return function(*args, **kwargs)

    return held


def lock_beside(folder: Path, patience: float = 0.0) -> FolderLock:
    """Holds a folder that is made anew, or a file, which may not exist yet, by a file beside it.

    Raises:
      BankError: another process holds it.
    """
    folder = folder.absolute()
    return FolderLock(folder, folder.with_name(f".{folder.name}.lock"), patience=patience)


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
