"""Writing files and folders whole or not at all, and saying what is wrong if that cannot be."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cluttergen_jax.errors import BankError

PARTIAL = ".partial"
_ADVICE = {
    errno.ENOSPC: "making room on the disk",
    errno.EDQUOT: "making room in your quota",
    errno.EFBIG: "a file system or a limit (ulimit -f) that allows larger files",
    errno.EACCES: "a folder that you may write to",
    errno.EPERM: "a folder that you may write to",
    errno.EROFS: "a folder on a disk that can be written",
    errno.ENAMETOOLONG: "a shorter name",
}


def write_atomically(path: Path, data: bytes, is_durable: bool = False) -> None:
    """Writes a file so that it is there whole or not at all; what it was before stays until then.

    Args:
      is_durable: wait until the disk has it, so that even a power failure leaves the old or the new file.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh = path.with_name(f".{path.name}{PARTIAL}")
    try:
        with fresh.open("wb") as file:
            file.write(data)
            if is_durable:
                file.flush()
                os.fsync(file.fileno())
        os.replace(fresh, path)
    except BaseException:
        with suppress(OSError):
            fresh.unlink(missing_ok=True)
        raise


def fill_atomically(folder: Path, fill: Callable[[Path], object]) -> None:
    """Makes a folder by `fill(path)` beside its place and then puts it there; an older one is replaced."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    fresh = folder.with_name(f".{folder.name}{PARTIAL}")
    shutil.rmtree(fresh, ignore_errors=True)
    try:
        fill(fresh)
        shutil.rmtree(folder, ignore_errors=True)
        os.rename(fresh, folder)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)


def remove_partial(folder: Path) -> None:
    """Removes what a writer that was killed left half written in `folder`."""
    for path in folder.glob(f".*{PARTIAL}"):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Inside, an OSError becomes a BankError that says what to do.

    Raises:
      BankError: the disk is full, or `path` cannot be written for another reason.
    """
    try:
        yield
    except OSError as error:
        advice = _ADVICE.get(error.errno or 0, "mending that")
        raise BankError(
            f"{path} cannot be written: {error.strerror or error}. What was finished before is kept whole",
            hint=f"{advice}, then the same command: it goes on where it stopped",
        ) from error
