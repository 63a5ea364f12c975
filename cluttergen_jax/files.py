"""Files and folders that appear whole or not at all, and names from files that stay in their folder.

What was there before stays until what takes its place is whole.
"""

from __future__ import annotations

import errno
import os
import platform
import re
import secrets
import shutil
import stat
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from cluttergen_jax.errors import BankError, ConfigError, UnsafePathError

PARTIAL = ".partial"
"""Ending of folders in which something is being written; their names begin with a dot."""
_BEGUN = ".begun"
_OLD = ".old"
_TEMPORARY = re.compile(
    r"\..*\.(?P<machine>[0-9a-f]{8})-(?P<process>\d+)-[0-9a-f]+\.(partial|begun|old)", re.DOTALL
)
_LONGEST = 40
_in_use: set[str] = set()
"""Temporary names of this process; its number alone may be that of one before it."""
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
    """`folder / name`, where the name comes from a file, an archive or a server, and is not trusted.

    Args:
      folder: known to be meant.
      name: relative to it, parts divided by "/".

    Raises:
      UnsafePathError: the name is no plain one (absolute, `..`, a drive, not a text at all), or a link on the
        way leads out of the folder, and not into the cache that it is a snapshot of (`blobs_of`).
    """
    parts = name.split("/") if isinstance(name, str) else [""]
    if any(part in ("", ".", "..") or _STRANGE.search(part) for part in parts):
        raise UnsafePathError(
            f"{folder}: a file in it names the path {name!r}",
            "plain names, within that folder",
            _STRANGER,
        )
    path = Path(folder).joinpath(*parts)
    real = Path(os.path.realpath(path))
    roots = [Path(os.path.realpath(folder))]
    roots += [Path(os.path.realpath(each.parent)) / each.name for each in blobs_of(Path(folder))]
    if not any(real.is_relative_to(each) for each in roots):
        raise UnsafePathError(
            f"{path} is a link that leads out of {folder}",
            "files and folders of its own",
            _STRANGER,
        )
    return path


def blobs_of(folder: Path) -> tuple[Path, ...]:
    """Where the Hugging Face Hub's cache keeps the files of a snapshot, in which they are links.

    They belong to the folder as if they lay in it; none where it is no snapshot.
    """
    path = folder.absolute()
    snapshots = [each for each in (path, *path.parents) if each.name == "snapshots"]
    return tuple(each.parent / "blobs" for each in snapshots)


MOST_WORDS = 64 << 20
"""Bytes of a file that people write: settings, layouts, tables."""


def fault_of_file(path: str | os.PathLike[str], most: int = MOST_WORDS) -> str:
    """Why a file is not to be opened, in words; "" if it may be, or is not there, which opening it says.

    A named pipe or a device, where a link leads too, would be waited for without end.

    Args:
      most: bytes that it may have.
    """
    try:
        found = os.stat(path)
    except OSError:
        return ""
    except ValueError as error:
        return f"no file can have this path ({error})"
    if not stat.S_ISREG(found.st_mode):
        kinds = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a named pipe", stat.S_IFSOCK: "a socket"}
        return f"it is {kinds.get(stat.S_IFMT(found.st_mode), 'a device')}, no regular file"
    return (
        f"it has {found.st_size:,} bytes, and up to {most:,} are read"
        if found.st_size > most
        else ""
    )


def is_regular_file(path: str | os.PathLike[str]) -> bool:
    """Whether a regular file is there; False too for a path that none can have, such as a very long one."""
    try:
        return stat.S_ISREG(os.stat(path).st_mode)
    except (OSError, ValueError):
        return False


_STRANGER = (
    "not using it if you do not know where it is from; a copy without links (cp -rL) if you do"
)


MOST_BYTES = 2**30
"""Of a file that is read as a whole: a record, a mesh, an image."""


def check_regular(path: Path, most: int = MOST_BYTES) -> None:
    """Refuses what cannot be read as a whole: a pipe, which never ends, a device, a folder, a huge file.

    Raises:
      OSError: it is none, or has more than `most` bytes.
    """
    found = path.stat()
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))
    if found.st_size > most:
        raise OSError(
            errno.EFBIG, f"it has {found.st_size} bytes, and at most {most} are read", str(path)
        )


def read_regular(path: Path) -> bytes:
    """What a regular file holds (OSError: see `check_regular`)."""
    check_regular(path)
    return path.read_bytes()


def read_inside(folder: Path, name: object) -> bytes:
    """What a file in a folder holds, whose name is not trusted; errors: `inside`, `read_regular`."""
    return read_regular(inside(folder, name))


@contextmanager
def file_whole(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A path of the same name, to be written in the block; then it takes `path`'s place.

    Folders are made as needed; if the block fails, nothing is left behind.
    """
    path = Path(path)
    with scratch_folder(path) as scratch, _naming(path):
        yield scratch / path.name
        os.replace(scratch / path.name, path)


def write_atomically(path: Path, data: bytes, is_durable: bool = False) -> None:
    """Writes a file so that it is there whole or not at all.

    Args:
      is_durable: wait until the disk has it, so that even a power failure leaves the old or the new file.
    """
    with file_whole(path) as fresh, fresh.open("wb") as file:
        file.write(data)
        if is_durable:
            file.flush()
            os.fsync(file.fileno())


@contextmanager
def folder_whole(folder: Path, is_only_writer: bool = False) -> Iterator[Path]:
    """A path at which a folder is to be made in the block; then it takes the place of `folder`.

    If the block fails, `folder` is what it was, and nothing else is left behind.

    Args:
      is_only_writer: no other process writes this folder now, so what any killed writer left is removed.
    """
    with scratch_folder(folder, is_only_writer) as scratch:
        with _naming(folder):
            yield scratch / folder.name
        swap_in(scratch / folder.name, folder)


@contextmanager
def scratch_folder(path: Path, is_only_writer: bool = False) -> Iterator[Path]:
    """A new, empty folder beside `path`, in which what is to take its place is made; removed after the block.

    Every temporary name beside something that is kept is made by `_new_folder`: no link or file can lie there
    yet, no other process gets the same, and it says which process uses it. What processes of this machine
    left that are no more is removed on the way.

    Args:
      path: its folder is made if need be.
      is_only_writer: remove also what processes of other machines, and older versions, left of `path`.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_left(path.parent.absolute())
    if is_only_writer:
        remove_partial(path.parent, _beginning(path))
    scratch = _new_folder(path, PARTIAL)
    try:
        yield scratch
    finally:
        remove(scratch)
        _in_use.discard(scratch.name)


@contextmanager
def resumable_folder(path: Path) -> Iterator[Path]:
    """As `scratch_folder`, but it is kept if the block fails, and has then what was made of `path` before."""
    path.parent.mkdir(parents=True, exist_ok=True)
    scratch = _new_folder(path, _BEGUN)
    for left in _stale(path.parent, _beginning(path), (_BEGUN,)):
        if not _is_plain(left):
            remove(left)
            continue
        with suppress(OSError):
            # Only one process can take it up.
            os.rename(left, scratch)
    try:
        yield scratch
        remove(scratch)
    finally:
        with suppress(OSError):
            scratch.rmdir()
        _in_use.discard(scratch.name)


def remove(path: Path) -> None:
    """Removes a file, a folder or a link, not what a link leads to; as much of it as can be."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


def is_partial(name: str) -> bool:
    """Whether a name is that of something which is being written, by this or an older version."""
    return _TEMPORARY.fullmatch(name) is not None or (name.startswith(".") and PARTIAL in name)


def _new_folder(path: Path, ending: str) -> Path:
    """A folder beside `path` that was not there, of a name that cannot be guessed, for this user alone."""
    while True:
        name = f"{_beginning(path)}{_machine()}-{os.getpid()}-{secrets.token_hex(4)}{ending}"
        # Known before it is there: other threads look for what was left.
        _in_use.add(name)
        scratch = path.parent.absolute() / name
        try:
            scratch.mkdir(mode=0o700)
            return scratch
        except FileExistsError:
            _in_use.discard(name)
        except OSError as error:
            _in_use.discard(name)
            error.filename = str(path)
            raise


def _beginning(path: Path) -> str:
    name = path.name
    if len(name) > _LONGEST:
        name = f"{name[:_LONGEST]}~{zlib.crc32(os.fsencode(name)):08x}"
    return f".{name}."


@cache
def _machine() -> str:
    """Within which numbers of processes mean something: containers number their own."""
    try:
        numbering = os.readlink("/proc/self/ns/pid")
    except OSError:
        numbering = ""
    return f"{zlib.crc32(os.fsencode(platform.node() + numbering)):08x}"


def _stale(
    folder: Path, beginning: str, endings: tuple[str, ...], is_only_writer: bool = False
) -> Iterator[Path]:
    """What was being written in a folder by processes that are no more; see `remove_partial`."""
    for path in list(folder.absolute().iterdir()):
        name = path.name
        is_meant = name.startswith(beginning) and any(ending in name for ending in endings)
        if not (is_meant and is_partial(name)):
            continue
        known = _TEMPORARY.fullmatch(name)
        if known is None or known["machine"] != _machine():
            is_left = is_only_writer
        elif (process := int(known["process"])) == os.getpid():
            is_left = name not in _in_use
        else:
            is_left = not _is_running(process)
        if is_left:
            yield path


def _is_running(process: int) -> bool:
    try:
        # On Windows, asking would end it.
        if os.name != "nt":
            os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        pass
    return True


def _is_plain(folder: Path) -> bool:
    """Whether a folder is one of the user's own, and holds files and folders, no links."""
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or (os.name != "nt" and found.st_uid != os.geteuid()):
        return False
    return not any(
        os.path.islink(os.path.join(place, name))
        for place, folders, names in os.walk(folder)
        for name in (*folders, *names)
    )


@cache
def _remove_left(folder: Path) -> None:
    """Once in a process for a folder, which may have many files."""
    with suppress(OSError):
        remove_partial(folder, is_only_writer=False)


def remove_partial(folder: Path, beginning: str = ".", is_only_writer: bool = True) -> None:
    """Removes what writers that were killed left half written in `folder`.

    Args:
      beginning: of its name.
      is_only_writer: only this process may write there: what other machines and older versions left counts.
    """
    for path in _stale(folder, beginning, (PARTIAL, _OLD), is_only_writer):
        _put_back_from(path)
        remove(path)


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
    aside = _new_folder(folder, _OLD)
    try:
        while True:
            with suppress(FileNotFoundError):
                os.rename(folder, aside / folder.name)
            try:
                os.rename(fresh, folder)
                return
            except OSError as error:
                # Another process may have put in its own since.
                if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                    raise
                remove(aside / folder.name)
    except BaseException:
        _put_back_from(aside)
        raise
    finally:
        remove(aside)
        _in_use.discard(aside.name)


def put_back(folder: Path) -> None:
    """The old folder again, where a writer was stopped between taking it away and putting in the new one."""
    if not folder.exists() and folder.parent.is_dir():
        for aside in _stale(folder.parent, _beginning(folder), (_OLD,), is_only_writer=True):
            _put_back_from(aside)


def _put_back_from(aside: Path) -> None:
    """What a writer had taken away, if nothing has come into its place."""
    if aside.name.endswith(_OLD) and not aside.is_symlink() and aside.is_dir():
        for each in aside.iterdir():
            if not os.path.lexists(aside.parent / each.name):
                with suppress(OSError):
                    os.rename(each, aside.parent / each.name)


def advice_on(error: OSError) -> str:
    """What to try about what the operating system refused."""
    return _ADVICE.get(error.errno or 0, "removing its cause")


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Inside, an OSError becomes a BankError that says what to do, and names what was refused.

    Raises:
      BankError: the disk is full, or `path` cannot be written for another reason.
    """
    try:
        yield
    except OSError as error:
        reason = f"{path} cannot be written: {error.strerror or error}"
        if error.filename and not Path(os.fsdecode(error.filename)).is_relative_to(path.parent):
            reason = f"{error.filename}: {error.strerror}, while {path} was being written"
        raise BankError(
            f"{reason}. What was finished before is kept whole",
            hint=f"{advice_on(error)}, then the same command: it goes on where it stopped",
        ) from error


def check_folder(out: str | Path | None, argument: str = "out") -> None:
    """Refuses what can be no folder on this machine: nothing, a URL, a file; None is let through.

    Raises:
      ConfigError: it names the argument.
    """
    if out is None:
        return
    path = Path(out)
    nearest = next((each for each in (path, *path.parents) if each.exists()), path)
    if not str(out) or "://" in str(out) or not nearest.is_dir():
        is_file = str(out) and nearest.is_file()
        raise ConfigError(
            f"{argument} = {str(out)!r}" + (f", where {nearest} is a file" if is_file else ""),
            "a folder on this machine, there or not",
            f"another `{argument}`",
        )


def check_file(out: str | Path | None, argument: str, example: str) -> None:
    """Refuses what can be no file on this machine: nothing, a URL, a folder; None is let through.

    Raises:
      ConfigError: it names the argument.
    """
    if out is None:
        return
    if not Path(out).name or "://" in str(out) or Path(out).is_dir():
        raise ConfigError(
            f"{argument} = {str(out)!r}",
            "a file on this machine, there or not",
            f"{argument}={example!r}",
        )
    check_folder(Path(out).parent, argument)
