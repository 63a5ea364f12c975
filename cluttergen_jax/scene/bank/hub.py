"""Where banks are shared, the Hugging Face Hub or a folder that many can read: pushed and pulled whole."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Protocol

import pyarrow.compute as pc

from cluttergen_jax.assets.pool import user_root
from cluttergen_jax.errors import BankError, ClutterGenError, MissingExtraError, UnsafePathError
from cluttergen_jax.files import folder_whole, inside, remove, resumable_folder, swap_in, writing
from cluttergen_jax.kept_folder import hold_folder, lock_beside
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.scene.bank.bank import Bank, read_bank
from cluttergen_jax.scene.bank.card import write_card
from cluttergen_jax.scene.bank.index import BankIndex, changes_of
from cluttergen_jax.scene.bank.record import INDEX, READER, NewerBankError
from cluttergen_jax.scene.bank.remote import check_is_here, fetch_mirror, is_url
from cluttergen_jax.schema import digest_of

_DATASET = re.compile(r"\w[\w-]*(\.[\w-]+)*/\w[\w-]*(\.[\w-]+)*", re.ASCII)
_EMPTY = {".gitattributes", "README.md"}
_NAMES_PATHS = ("pool", "support", "checkpoint", "start")
_MENDED = "the same `cluttergen generate` again"
PATTERNS = (
    "README.md",
    "bank.json",
    "croissant.json",
    "bank_reader.py",
    "scenes-*.parquet",
    "assets/*",
    "scenes/*.xml",
    "scenes/*.png",
    "overview.png",
    "verification.json",
)
"""What a bank consists of; nothing else is pushed or pulled. A star stands for slashes, too."""
_KIND = "dataset"
_LONGEST = 300


def is_of_a_bank(name: str, patterns: Sequence[str] = PATTERNS) -> bool:
    """Whether a file of this path belongs to a bank, or to what else the patterns are of."""
    return any(fnmatchcase(name, pattern) for pattern in patterns)


class Hub(Protocol):
    """Keeps data sets called OWNER/NAME."""

    def listing(self, dataset: str, revision: str | None) -> tuple[str | None, list[str]]:
        """What `fetch` takes for just this state of a data set, and the paths of its files (BankError)."""

    def fetch(
        self, dataset: str, revision: str | None, folder: Path, patterns: Sequence[str] = PATTERNS
    ) -> None:
        """Copies the files of these patterns into `folder`; those that are there already may stay.

        Raises:
          BankError: there is no such data set, or it cannot be reached.
        """

    def store(self, dataset: str, folder: Path, is_private: bool) -> str:
        """Puts a bank's files in the place of the data set's own, at once; returns where they are.

        Raises:
          BankError: that is not allowed, or the hub cannot be reached.
        """


class FolderHub:
    """A folder with a folder for each owner: on a shared disk, or in a test.

    Args:
      root: exists.
    """

    def __init__(self, root: Path) -> None:
        if not root.is_dir():
            hint = "another `hub`" if root.exists() else f"mkdir {root}"
            raise BankError(f"no hub in {root}", "a folder that exists, or https://...", hint)
        self._root = root

    def listing(self, dataset: str, revision: str | None) -> tuple[str | None, list[str]]:
        """See `Hub`; a folder has no revisions."""
        folder = inside(self._root, dataset)
        if revision is not None:
            raise BankError(f"revision {revision!r} of {dataset} in a folder", "no revision")
        if not folder.is_dir():
            known = sorted(
                each.parent.relative_to(self._root) for each in self._root.glob("*/*/bank.json")
            )
            raise BankError(
                f"no data set {dataset} in {self._root}", ", ".join(map(str, known)) or "none yet"
            )
        return None, _names_in(folder)

    def fetch(
        self, dataset: str, revision: str | None, folder: Path, patterns: Sequence[str] = PATTERNS
    ) -> None:
        """See `Hub`."""
        source = inside(self._root, dataset)
        for name in _names_in(source):
            if is_of_a_bank(name, patterns):
                _copy(inside(source, name), inside(folder, name))

    def store(self, dataset: str, folder: Path, is_private: bool) -> str:
        """See `Hub`; who may read a folder is for its file system to say."""
        place = inside(self._root, dataset)
        if is_private:
            raise BankError(f"a private data set in {self._root}", "a folder's own permissions")
        with folder_whole(place) as fresh:
            for name in filter(is_of_a_bank, _names_in(folder)):
                _copy(inside(folder, name), fresh / name)
        return str(place)


def _names_in(folder: Path) -> list[str]:
    return sorted(
        each.relative_to(folder).as_posix() for each in folder.rglob("*") if each.is_file()
    )


def _copy(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)


class HuggingFaceHub:
    """The Hugging Face Hub, or another server that speaks as it does.

    Args:
      endpoint: its address; None for `HF_ENDPOINT`, else huggingface.co.

    Raises:
      MissingExtraError: the extra `hub` is not installed.
    """

    def __init__(self, endpoint: str | None = None) -> None:
        try:
            import huggingface_hub
            import huggingface_hub.errors
        except ImportError as error:
            raise MissingExtraError("hub", "a bank on the Hugging Face Hub") from error
        self._hub = huggingface_hub
        self._api = self._hub.HfApi(endpoint=endpoint, library_name="cluttergen_jax")

    def listing(self, dataset: str, revision: str | None) -> tuple[str | None, list[str]]:
        """See `Hub`: a commit, which stays what it is even if another push comes meanwhile."""
        with self._explain_errors(dataset):
            info = self._api.dataset_info(dataset, revision=revision)
            return info.sha, [each.rfilename for each in info.siblings or []]

    def fetch(
        self, dataset: str, revision: str | None, folder: Path, patterns: Sequence[str] = PATTERNS
    ) -> None:
        """See `Hub`. What an interrupted call has fetched is not fetched again."""
        with self._explain_errors(dataset):
            self._api.snapshot_download(
                dataset,
                repo_type=_KIND,
                revision=revision,
                local_dir=folder,
                allow_patterns=list(patterns),
            )

    def store(self, dataset: str, folder: Path, is_private: bool) -> str:
        """See `Hub`: one commit. Large files that an interrupted call has sent are not sent again."""
        if self._hub.get_token() is None:
            raise BankError(
                f"pushing to {self._api.endpoint} without a token",
                hint="hf auth login, or HF_TOKEN=...",
            )
        with self._explain_errors(dataset):
            # None leaves a data set that is there as it is, and a new one as its owner's default says.
            url = self._api.create_repo(
                dataset, repo_type=_KIND, private=is_private or None, exist_ok=True
            )
            if is_private and not self._api.dataset_info(dataset).private:
                raise BankError(
                    f"{dataset} is there and public", "a private data set", "another name"
                )
            self._api.upload_folder(
                repo_id=dataset,
                repo_type=_KIND,
                folder_path=folder,
                allow_patterns=list(PATTERNS),
                delete_patterns=list(PATTERNS),
                commit_message="A bank of scenes, by cluttergen",
            )
        return str(url)

    @contextmanager
    def _explain_errors(self, dataset: str) -> Iterator[None]:
        """What the library raises becomes a BankError that says what to do."""
        errors = self._hub.errors
        where = f"{dataset} on {self._api.endpoint}"
        try:
            yield
        except errors.GatedRepoError as error:
            hint = "asking for access on its page, then hf auth login"
            raise BankError(
                f"{where} is open only to those whom its owner admits", hint=hint
            ) from error
        except errors.RepositoryNotFoundError as error:
            hint = "another OWNER/NAME; for a private one hf auth login, or HF_TOKEN=..."
            raise BankError(
                f"there is no data set {where}, or you may not see it", hint=hint
            ) from error
        except errors.RevisionNotFoundError as error:
            raise BankError(
                f"{where} has no such revision", hint="no `revision` for the latest"
            ) from error
        except errors.HfHubHTTPError as error:
            status = getattr(error.response, "status_code", None)
            hint = (
                "a token that may do that: hf auth login" if status in (401, 403) else "again later"
            )
            raise BankError(f"{where}: {_one_line(error)}", hint=hint) from error
        except errors.HFValidationError as error:
            raise BankError(f"{dataset}: {_one_line(error)}", "OWNER/NAME") from error
        except Exception as error:
            if isinstance(error, OSError) and error.filename:
                # The disk's trouble, not the hub's.
                raise
            # The library has changed its HTTP client twice, and what that raises without a network with it.
            reason = f"{type(error).__name__}: {_one_line(error)}"
            hint = "the same command when the network is back: it goes on where it stopped"
            raise BankError(
                f"{where} does not answer as it should ({reason})", hint=hint
            ) from error


def _one_line(error: Exception) -> str:
    """What an error says, on one line."""
    words = " ".join(str(error).split()) or "no reason given"
    return words if len(words) <= _LONGEST else f"{words[:_LONGEST]}..."


HUB_VARIABLE = "CLUTTERGEN_HUB"


def push(
    path: str | Path, name: str, hub: str | None, is_private: bool, allow_outside: bool = False
) -> str:
    """Where a bank is after it was published; see `cluttergen_jax.hub.push_bank`."""
    _check_name(name)
    place = hub_of(hub)
    bank = read_bank(path)
    check_is_here(bank.path)
    with hold_folder(bank.path):
        # As it is now: another process may have written it since.
        bank = read_bank(bank.path)
        check_whole(bank)
        if not allow_outside:
            _check_outside(bank)
        with writing(bank.path):
            write_card(bank)
        _check_free(place, name)
        return place.store(name, bank.path, is_private)


def pull(
    name: str,
    out: str | Path | None,
    hub: str | None,
    revision: str | None,
    overwrite: bool,
    allow_unchecked: bool = False,
    is_shared: bool = False,
) -> Path:
    """The folder of a bank that was fetched into it; see `cluttergen_jax.hub.pull_bank`.

    Args:
      is_shared: other processes may pull the same at once: of what was not there before, the first is kept.
    """
    _check_name(name)
    place = hub_of(hub)
    out = pulled_path(name, hub, revision) if out is None else Path(out)
    was_there = (out / INDEX).is_file()
    with ExitStack() as stack:
        stack.enter_context(writing(out))
        if not is_shared:
            stack.enter_context(lock_beside(out))
        _check_place(out, overwrite)
        scratch = stack.enter_context(resumable_folder(out))
        fresh = scratch / out.name
        fresh.mkdir(exist_ok=True)
        _fetch(place, name, revision, fresh, allow_unchecked)
        if is_shared and not was_there:
            try:
                os.rename(fresh, out)
            except OSError:
                # Another process was first.
                if not (out / INDEX).is_file():
                    raise
        else:
            _check_place(out, overwrite)
            swap_in(fresh, out)
    return out


def pulled_path(name: str, hub: str | None = None, revision: str | None = None) -> Path:
    """Where `load_bank` keeps a bank that it has pulled; each hub and revision has a folder of its own."""
    asked = (hub or os.environ.get(HUB_VARIABLE) or "", revision or "")
    other = f"@{digest_of(repr(asked).encode())[:12]}" if any(asked) else ""
    return inside(user_root().parent / "banks", name + other)


def find_bank(path: str | Path, *, hub: str | None = None, revision: str | None = None) -> Path:
    """The folder of a bank that is named by it, by a URL, or as OWNER/NAME on a hub; that is pulled once.

    Raises:
      BankError: there is no such folder, and it is no name; or there is no such bank on the hub.
      MissingExtraError: the extra `hub` is not installed.
    """
    if is_url(path):
        return fetch_mirror(str(path))
    if Path(path).exists() or not isinstance(path, str) or not _DATASET.fullmatch(path):
        return Path(path)
    stored = pulled_path(path, hub)
    if revision is None and (stored / INDEX).is_file():
        return stored
    try:
        return pull(path, None, hub, revision, overwrite=True, is_shared=True)
    except ClutterGenError as error:
        raise BankError(
            f"{path} is not a bank: there is no such folder, and as a name on a hub: {error.given}",
            "a folder that `generate` made, or OWNER/NAME",
            error.hint,
        ) from error


def hub_of(text: str | None) -> Hub:
    """The hub that an argument names: see `cluttergen_jax.hub.push_bank`."""
    text = text or os.environ.get(HUB_VARIABLE) or None
    if text is None or text.startswith(("https://", "http://")):
        return HuggingFaceHub(text)
    place = text.removeprefix("file://")
    if is_url(place):
        raise BankError(
            f"no hub at {text}", "a folder that exists, or https://...", "another `hub`"
        )
    return FolderHub(Path(place))


def check_whole(bank: Bank, allow_unchecked: bool = False) -> None:
    """Looks at everything in a bank: rows, assets, digests of all files, and scenes' files beside their rows.

    Args:
      allow_unchecked: a bank without digests of its files is taken as it is.

    Raises:
      BankError: scenes are missing, or a file is missing, damaged, changed or without a digest; or the bank
        does not say how it was made.
      UnsafePathError: it names a path outside of its folder.
    """
    if not bank.recipe:
        raise BankError(
            f"{bank.path}: its record does not say how it was made", "a bank with its recipe"
        )
    if bank.files is None and not allow_unchecked:
        raise BankError(
            f"{bank.path}: bank.json has no digests of the bank's files: nobody can tell whether they were "
            "changed",
            "a bank that knows its files",
            f"{_MENDED}, which adds them; or `allow_unchecked` to take it as it is",
        )
    num_rows = 0
    names = set()
    for rows in bank.tables():
        num_rows += rows.num_rows
        names |= {
            base_name(name) for name in pc.unique(pc.list_flatten(rows["objects"])).to_pylist()
        }
    if num_rows < bank.num_scenes:
        raise BankError(f"{bank.path} holds {num_rows} of {bank.num_scenes} scenes", hint=_MENDED)
    for name in sorted(names | set(bank.assets["objects"])):
        bank.object(name)
    _ = bank.support
    if changes := changes_of(bank):
        shown = ", ".join(f"{change.name} ({change.what})" for change in changes[:3])
        more = f", and {len(changes) - 3} more" if len(changes) > 3 else ""
        raise BankError(f"{bank.path}: files are not what was written: {shown}{more}", hint=_MENDED)


def _check_outside(bank: Bank) -> None:
    """Refuses what was made of files from outside the folders that were imported: they may be private.

    Raises:
      BankError: it names the objects, and those files.
    """
    origins = [(name, bank.object(name).provenance) for name in sorted(bank.assets["objects"])]
    origins.append((bank.support.name, bank.support.provenance))
    taken = [f"{name} ({', '.join(each.outside)})" for name, each in origins if each.outside]
    if taken:
        more = f", and {len(taken) - 3} more" if len(taken) > 3 else ""
        raise BankError(
            f"{bank.path}: made of files from outside the folders that were imported: "
            f"{', '.join(taken[:3])}{more}",
            "objects whose files lie in their own folders",
            "looking at these files, then `allow_outside` to publish what was made of them",
        )


def local_paths(bank: Bank) -> list[str]:
    """The paths of this machine that the record of a bank names: who pushes it, publishes them."""
    recipe = bank.recipe
    texts = [recipe.get(name) for name in _NAMES_PATHS]
    return [text for text in texts if isinstance(text, str) and ("/" in text or os.sep in text)]


def _fetch(
    place: Hub, name: str, revision: str | None, scratch: Path, allow_unchecked: bool
) -> None:
    """Fetches and checks; what is found to be bad is not kept."""
    commit, names = place.listing(name, revision)
    if INDEX not in names:
        raise BankError(f"{name} is not a bank: it has no {INDEX}", "what `cluttergen push` made")
    for each in names:
        inside(scratch, each)
    place.fetch(name, commit, scratch)
    remove(scratch / ".cache")
    wanted = set(filter(is_of_a_bank, names))
    for file in [each for each in scratch.rglob("*") if not each.is_dir()]:
        if file.relative_to(scratch).as_posix() not in wanted:
            file.unlink()
    try:
        bank = read_bank(scratch)
        check_whole(bank, allow_unchecked)
    except (BankError, UnsafePathError) as error:
        remove(scratch)
        given = error.given.replace(str(scratch), name)
        is_newer = isinstance(error, NewerBankError)
        hint = error.hint if is_newer else "pulling it again, or asking who pushed it"
        raise type(error)(given, hint=hint) from error
    index = BankIndex.of(bank)
    # The reader is a program: of a stranger's bank this version's takes its place.
    if (scratch / READER).is_file() and index.write_reader():
        index.write()


def _check_free(place: Hub, name: str) -> None:
    """Refuses a data set that is something else than a bank; what is not there yet is free."""
    try:
        names = set(place.listing(name, None)[1])
    except BankError:
        return
    if names - _EMPTY and INDEX not in names:
        raise BankError(f"{name} is a data set that is not a bank", "a new name, or that of a bank")


def _check_place(out: Path, overwrite: bool) -> None:
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return
    if not (out / INDEX).is_file():
        raise BankError(
            f"{out} exists and is not a bank", "a new folder, or that of a bank", "another `out`"
        )
    if not overwrite:
        raise BankError(
            f"{out} exists", "a new folder", "another `out`, or `overwrite` to replace it"
        )


def _check_name(name: str) -> None:
    if not _DATASET.fullmatch(name):
        raise BankError(
            f"a data set called {name!r}", "OWNER/NAME, in letters, digits, '-', '_' and single '.'"
        )
