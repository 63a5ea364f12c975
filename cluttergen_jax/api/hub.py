"""Banks on a hub: pushed whole, and pulled whole."""

from __future__ import annotations

from pathlib import Path


def push_bank(path: str | Path, name: str, *, hub: str | None = None, is_private: bool = False) -> str:
    """Publishes a bank as a data set, with its card; returns where it is.

    What is there under that name is replaced at once, if it is a bank: a hub keeps its earlier revisions.

    Args:
      path: a whole bank's folder; nobody may be writing it.
      name: OWNER/NAME.
      hub: another server's address, https://..., or a folder; the variable CLUTTERGEN_HUB says the same. The
        Hugging Face Hub if not given.
      is_private: a new data set can be seen by its owner alone.

    Raises:
      BankError: the bank is not whole, the name is none or that of something else, or the hub refuses or
        cannot be reached.
      MissingExtraError: the extra `hub` is not installed.
    """
    from cluttergen_jax.scene.bank.hub import push

    return push(path, name, hub, is_private)


def pull_bank(
    name: str,
    out: str | Path | None = None,
    *,
    hub: str | None = None,
    revision: str | None = None,
    overwrite: bool = False,
    allow_unchecked: bool = False,
) -> Path:
    """Fetches a bank; returns its folder, which is there whole or not at all.

    It is fetched beside its place; its names, rows, assets and the digests of all files are checked, each
    scene's file is held against its row, and then it is moved there. An interrupted pull resumes where it
    stopped.

    Args:
      name: OWNER/NAME.
      out: a folder that does not exist yet. If not given, the command takes NAME, and a function the folder
        in which `load_bank` keeps it.
      hub: another server's address, https://..., or a folder; the variable CLUTTERGEN_HUB says the same. The
        Hugging Face Hub if not given.
      revision: a branch, tag or commit; the latest if not given.
      overwrite: replace a bank that is there.
      allow_unchecked: take a bank that has no digests of its files or rows: those of older versions.

    Raises:
      BankError: there is no such bank, it is damaged or has no digests, `out` exists, or the hub cannot be
        reached.
      UnsafePathError: it names paths outside of its folder.
      MissingExtraError: the extra `hub` is not installed.
    """
    from cluttergen_jax.scene.bank.hub import pull

    return pull(name, out, hub, revision, overwrite, allow_unchecked)
