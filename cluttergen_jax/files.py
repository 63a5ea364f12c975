"""Files and folders that appear whole or not at all, and names from files that stay in their folder.

What was there before stays until what takes its place is whole.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cluttergen_jax.errors import BankError, ConfigError, UnsafePathError

PARTIAL = ".partial"
"""Ending of what is being written, in names that begin with a dot."""
_ADVICE = {
    errno.EEXIST: "removing the file that stands where a folder has to be, or another place",
    errno.ENOTDIR: "removing the file that stands where a folder has to be, or another place",
    errno.EISDIR: "removing the folder that stands where a file has to be, or another place",
    errno.ENOENT: "a path that exists",
    errno.ENOSPC: "making room on the disk",
    errno.EDQUOT: "making room in your quota",
    errno.EFBIG: "a file system or a limit (ulimit -f) that allows larger files",
    errno.EACCES: "a folder that you may write to",
    errno.EPERM: "a folder that you may write to",
    errno.EROFS: "a folder on a disk that can be written",
    errno.ENAMETOOLONG: "a shorter name",
}
_STRANGE = re.compile(r"[\\:\x00-\x1f\x7f]")


def cache_home() -> Path:
    """The folder of what can be made again: `$CLUTTERGEN_HOME`, else one in the XDG cache home."""
    if home := os.environ.get("CLUTTERGEN_HOME"):
        return Path(home)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "cluttergen_jax"


def check_utf8(path: str | os.PathLike[str]) -> None:
    """Refuses a path that is not UTF-8, its folders included: Arrow, MuJoCo and JSON cannot name it.

    Raises:
      ConfigError: it is not; in a C locale without UTF-8 mode, no letter beyond ASCII is.
    """
    text = os.path.abspath(path)
    try:
        text.encode()
    except UnicodeEncodeError:
        readable = os.fsencode(text).decode("utf-8", "backslashreplace")
        raise ConfigError(
            f"a file or folder of the name {readable}, which is not read as UTF-8",
            "names in UTF-8",
            "another name; or, if it is UTF-8, the variable PYTHONUTF8=1 or a locale such as C.UTF-8",
        ) from None


def inside(folder: str | os.PathLike[str], name: object) -> Path:
    """`folder / name`, where the name comes from a file, an archive or a server: somebody else's word.

    Args:
      folder: known to be meant.
      name: relative to it, parts divided by "/".

    Raises:
      UnsafePathError: the name is no plain one (absolute, `..`, a drive, not a text at all), or a link on the
        way leads out of the folder.
    """
    parts = name.split("/") if isinstance(name, str) else [""]
    if any(part in ("", ".", "..") or _STRANGE.search(part) for part in parts):
        raise UnsafePathError(
            f"{folder}: a file in it names the path {name!r}", "plain names, within that folder", _STRANGER
        )
    path = Path(folder).joinpath(*parts)
    if not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder)):
        raise UnsafePathError(
            f"{path} is a link that leads out of {folder}", "files and folders of its own", _STRANGER
        )
    return path


_STRANGER = "not using it if you do not know where it is from; a copy without links (cp -rL) if you do"


@contextmanager
def file_whole(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A path beside `path`, with the same ending, to be written in the block; then it takes `path`'s place.

    Folders are made as needed; if the block fails, nothing is left behind.
    """
    path = Path(path)
    # Two commands may write the same file of a cache at once.
    with _replacing(path, path.with_name(f".{path.name}.{os.getpid()}{PARTIAL}{path.suffix}")) as fresh:
        yield fresh


def write_atomically(path: Path, data: bytes, is_durable: bool = False) -> None:
    """Writes a file so that it is there whole or not at all.

    Args:
      is_durable: wait until the disk has it, so that even a power failure leaves the old or the new file.
    """
    with _replacing(path, path.with_name(f".{path.name}{PARTIAL}")) as fresh, fresh.open("wb") as file:
        file.write(data)
        if is_durable:
            file.flush()
            os.fsync(file.fileno())


@contextmanager
def _replacing(path: Path, fresh: Path) -> Iterator[Path]:
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        # Whatever lies there would be written through if it were a link.
        fresh.unlink(missing_ok=True)
        with _naming(path):
            yield fresh
        os.replace(fresh, path)
    except BaseException:
        with suppress(OSError):
            fresh.unlink(missing_ok=True)
        raise


@contextmanager
def folder_whole(folder: Path, is_only_writer: bool = False) -> Iterator[Path]:
    """A path at which a folder is to be made in the block; then it takes the place of `folder`.

    If the block fails, `folder` is what it was, and nothing else is left behind.

    Args:
      is_only_writer: nobody else writes this folder now, so what a killed writer left is removed.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    if is_only_writer:
        scratch = folder.with_name(f".{folder.name}{PARTIAL}")
        shutil.rmtree(scratch, ignore_errors=True)
        scratch.mkdir()
    else:
        scratch = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", suffix=PARTIAL, dir=folder.parent))
    try:
        with _naming(folder):
            yield scratch / folder.name
        swap_in(scratch / folder.name, folder)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """A full disk does not say of itself what could not be written: such errors get the name of `path`."""
    try:
        yield
    except OSError as error:
        if error.errno and not error.filename:
            error.filename = str(path)
        raise


def swap_in(fresh: Path, folder: Path) -> None:
    """Puts `fresh` where `folder` is; the old one is put back if that fails, and removed if not."""
    aside = _aside(folder)
    if folder.exists():
        shutil.rmtree(aside, ignore_errors=True)
        os.rename(folder, aside)
    try:
        os.rename(fresh, folder)
    except BaseException:
        put_back(folder)
        raise
    shutil.rmtree(aside, ignore_errors=True)


def put_back(folder: Path) -> None:
    """The old folder again, where a writer was stopped between taking it away and putting in the new one."""
    if not folder.exists() and _aside(folder).exists():
        os.rename(_aside(folder), folder)


def _aside(folder: Path) -> Path:
    return folder.with_name(f".{folder.name}.old")


def advice_on(error: OSError) -> str:
    """What to try about what the operating system refused."""
    return _ADVICE.get(error.errno or 0, "removing its cause")


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
        raise BankError(
            f"{path} cannot be written: {error.strerror or error}. What was finished before is kept whole",
            hint=f"{advice_on(error)}, then the same command: it goes on where it stopped",
        ) from error
