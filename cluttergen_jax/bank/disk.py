"""What a bank needs of the disk: its leftovers removed, and what is wrong with it said."""

from __future__ import annotations

import errno
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cluttergen_jax.errors import BankError
from cluttergen_jax.files import PARTIAL, write_atomically

__all__ = ["remove_partial", "write_atomically", "writing"]

_ADVICE = {
    errno.ENOSPC: "making room on the disk",
    errno.EDQUOT: "making room in your quota",
    errno.EFBIG: "a file system or a limit (ulimit -f) that allows larger files",
    errno.EACCES: "a folder that you may write to",
    errno.EPERM: "a folder that you may write to",
    errno.EROFS: "a folder on a disk that can be written",
    errno.ENAMETOOLONG: "a shorter name",
}


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
