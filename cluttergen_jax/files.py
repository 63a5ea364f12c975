"""Files and folders that appear whole or not at all: what was there before stays until then."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PARTIAL = ".partial"
"""Ending of what is being written, in names that begin with a dot."""


@contextmanager
def file_whole(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A path beside `path`, with the same ending, to be written in the block; then it takes `path`'s place.

    Folders are made as needed; if the block fails, nothing is left behind.
    """
    path = Path(path)
    with _replacing(path, path.with_name(f".{path.name}{PARTIAL}{path.suffix}")) as fresh:
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
        _swap_in(scratch / folder.name, folder)
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


def _swap_in(fresh: Path, folder: Path) -> None:
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
