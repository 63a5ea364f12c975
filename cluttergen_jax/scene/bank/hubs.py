"""Where banks are shared: the Hugging Face Hub, or a folder that many can read."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Protocol

from cluttergen_jax.errors import BankError, MissingExtraError
from cluttergen_jax.files import folder_whole, inside

PATTERNS = (
    "README.md",
    "bank.json",
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
