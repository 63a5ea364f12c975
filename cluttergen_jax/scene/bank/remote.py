"""Banks elsewhere, at a URL such as s3://bucket/name: small files are copied, blocks are read where they lie.

A *mirror* is the folder on this machine that stands for such a bank: whatever reads or writes banks works on
it. It holds bank.json, the card and the assets, and while a bank is made the blocks that are in no shard yet.
Losing it loses those alone. S3 and Google Cloud Storage are spoken by pyarrow, everything else by fsspec.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.fs as pafs

from cluttergen_jax.assets.pool import user_root
from cluttergen_jax.errors import BankError, MissingExtraError
from cluttergen_jax.files import inside, is_partial, write_atomically
from cluttergen_jax.kept_folder import FolderLock
from cluttergen_jax.scene.bank.record import INDEX, READER
from cluttergen_jax.schema import digest_of

MARK = ".url"
"""The file of a mirror that says what it stands for."""
_SMALL = (INDEX, READER, "README.md")
_NOT_OF_THE_BANK = (".lock", MARK)
_BUFFER = 8 * 2**20
FETCHING = 5.0
"""Seconds for which a reader's fetching of a mirror is waited for."""


def is_url(path: object) -> bool:
    """Whether a bank's place is a URL."""
    return "://" in str(path)


def mirror_of(url: str) -> Path:
    """The folder of this machine that stands for the bank at a URL; made if need be."""
    url = url.rstrip("/")
    digest = digest_of(url.encode())[:16]
    folder = _root() / digest / (url.partition("?")[0].rpartition("/")[2] or "bank")
    write_atomically(folder / MARK, url.encode())
    return folder


def url_of(path: Path) -> str | None:
    """The URL that a mirror stands for; None for any other folder."""
    # A folder from elsewhere cannot make this machine open what it names.
    if path.parent.parent != _root() or not (path / MARK).is_file():
        return None
    return (path / MARK).read_text()


def check_is_here(path: Path) -> None:
    """Refuses the mirror of a bank at a URL, for what wants all files of a bank (BankError)."""
    if (url := url_of(path)) is not None:
        if url.startswith("file://"):
            raise BankError(
                f"{url} is a URL",
                "a bank in a folder",
                f"the plain path {url.removeprefix('file://')}",
            )
        raise BankError(
            f"{url} is not on this machine", "a bank in a folder", "copying it to a folder first"
        )


def _root() -> Path:
    return user_root().parent / "mirrors"


@dataclass(frozen=True, eq=False)
class RemoteFolder:
    """A folder behind a URL; names are relative to it, parts divided by "/".

    Attributes:
      url: as it was given.
      system: speaks with it.
      root: its path there.
    """

    url: str
    system: pafs.FileSystem
    root: str

    @classmethod
    def of(cls, url: str) -> RemoteFolder:
        """The folder at a URL, which need not exist.

        Raises:
          BankError: no file system of that kind is known, or it does not answer.
          MissingExtraError: fsspec, or its package for this kind of URL, is not installed.
        """
        with _explain_errors(url):
            try:
                system, root = pafs.FileSystem.from_uri(url)
            except pa.ArrowInvalid:
                system, root = _by_fsspec(url)
        return cls(url, system, root.rstrip("/"))

    def sizes(self) -> dict[str, int]:
        """The files in it, at any depth, and their bytes; none where there is no such folder."""
        selector = pafs.FileSelector(self.root, allow_not_found=True, recursive=True)
        with _explain_errors(self.url):
            found = self.system.get_file_info(selector)
        prefix = len(self.root) + 1
        return {each.path[prefix:]: each.size for each in found if each.type == pafs.FileType.File}

    def open(self, name: str) -> pa.NativeFile:
        """A file of it, of which parts may be read."""
        with _explain_errors(self.url):
            return self.system.open_input_file(f"{self.root}/{name}")

    def fetch(self, name: str, folder: Path) -> None:
        """Copies a file into a folder of this machine, where it appears whole."""
        with (
            _explain_errors(self.url),
            self.system.open_input_stream(f"{self.root}/{name}") as stream,
        ):
            write_atomically(inside(folder, name), stream.read())

    def put(self, name: str, folder: Path) -> None:
        """Copies a file of a folder of this machine here; object stores show it once it is whole."""
        with _explain_errors(self.url):
            self.system.create_dir(f"{self.root}/{name}".rpartition("/")[0], recursive=True)
            with (
                (folder / name).open("rb") as source,
                self.system.open_output_stream(f"{self.root}/{name}") as sink,
            ):
                shutil.copyfileobj(source, sink, _BUFFER)

    def remove(self, name: str) -> None:
        """Removes a file."""
        with _explain_errors(self.url):
            self.system.delete_file(f"{self.root}/{name}")


def remote_of(path: Path) -> RemoteFolder | None:
    """What a mirror stands for; None for any other folder."""
    url = url_of(path)
    return None if url is None else RemoteFolder.of(url)


def fetch_mirror(url: str, is_held: bool = False) -> Path:
    """The mirror of a bank, with all that is small in it as it is now: the index, the card, the assets.

    One that a process of this machine writes is newer than what it stands for, and is left as it is.

    Args:
      is_held: by this process, which is about to write.

    Raises:
      BankError: it cannot be reached.
      UnsafePathError: it has a file of a name that leads elsewhere.
    """
    folder = mirror_of(url)
    remote = RemoteFolder.of(url)
    if is_held:
        _fetch(folder, remote)
        return folder
    try:
        lock = FolderLock(folder, patience=FETCHING)
    except BankError:
        if (folder / INDEX).is_file():
            return folder
        raise
    with lock:
        _fetch(folder, remote)
    return folder


def _fetch(folder: Path, remote: RemoteFolder) -> None:
    names = remote.sizes()
    if INDEX not in names:
        # Of a bank that was removed there.
        (folder / INDEX).unlink(missing_ok=True)
    for name in sorted(names):
        if name.startswith(_SMALL):
            remote.fetch(name, folder)
    _fetch_part(folder, remote, names, "assets")


def _fetch_part(folder: Path, remote: RemoteFolder, names: Iterable[str], part: str) -> None:
    """Fetches what is not as the index says, and removes what a bank that was made anew has no more."""
    kept = sorted(name for name in names if name.startswith(f"{part}/"))
    for file in sorted((folder / part).rglob("*")):
        if file.is_file() and file.relative_to(folder).as_posix() not in kept:
            file.unlink()
    try:
        listed = dict(json.loads((folder / INDEX).read_bytes())["files"])
    except (OSError, ValueError, LookupError, TypeError):
        listed = {}
    for name in kept:
        file = inside(folder, name)
        if not (file.is_file() and digest_of(file.read_bytes()) == listed.get(name)):
            remote.fetch(name, folder)


def bank_folder(path: str | Path) -> Path:
    """A bank's folder on this machine: of one at a URL the mirror, as `fetch_mirror` leaves it."""
    return fetch_mirror(str(path)) if is_url(path) else Path(path)


def fetch_scenes(path: Path) -> None:
    """Fetches the files of single scenes into a mirror."""
    if remote := remote_of(path):
        _fetch_part(path, remote, remote.sizes(), "scenes")


def publish(path: Path, name: str) -> None:
    """Moves a file of blocks from a mirror to where its bank is; any other folder is left as it is."""
    if remote := remote_of(path):
        remote.put(name, path)
        (path / name).unlink()


def publish_all(path: Path, is_begun: bool = False) -> None:
    """Brings the bank of a mirror up to date: blocks, everything else, and the index at last.

    Args:
      is_begun: the bank is only begun: what is small goes there, so that it can be continued from elsewhere.
    """
    remote = remote_of(path)
    if remote is None:
        return
    found = [each.relative_to(path) for each in path.rglob("*") if each.is_file()]
    files = [each.as_posix() for each in found if not any(map(is_partial, each.parts))]
    files = [name for name in files if name not in _NOT_OF_THE_BANK]
    there = remote.sizes()
    for name in sorted(files, key=lambda name: (name == INDEX, name)):
        is_block = name.startswith("scenes-")
        is_same = there.get(name) == (path / name).stat().st_size
        # Assets and scenes' files do not change while their size does not; what does is small.
        if (is_block and is_begun) or (is_same and "/" in name):
            continue
        remote.put(name, path)
        if is_block:
            (path / name).unlink()


def _by_fsspec(url: str) -> tuple[pafs.FileSystem, str]:
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        raise MissingExtraError("remote", f"a bank at {url}") from error
    try:
        system, root = url_to_fs(url)
    except ImportError as error:
        raise BankError(
            f"{url} cannot be opened ({error})", hint="installing the package that it names"
        ) from error
    return pafs.PyFileSystem(pafs.FSSpecHandler(system)), root


@contextmanager
def _explain_errors(url: str) -> Iterator[None]:
    """What file systems raise becomes a BankError that says what to do."""
    try:
        yield
    except (OSError, ValueError, pa.ArrowException) as error:
        raise BankError(
            f"{url} does not answer as it should ({' '.join(str(error).split())})",
            "a URL that pyarrow or fsspec knows, such as s3://bucket/name",
            "the same command when it does: it goes on where it stopped",
        ) from error
