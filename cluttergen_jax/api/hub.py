"""Banks and policies on a hub: pushed whole, and pulled whole."""

from __future__ import annotations

from pathlib import Path


def push_bank(
    path: str | Path,
    name: str,
    *,
    hub: str | None = None,
    is_private: bool = False,
    allow_outside: bool = False,
) -> str:
    """Publishes a bank as a data set, with its card; returns where it is.

    What is there under that name is replaced at once, if it is a bank: a hub keeps its earlier revisions.

    Args:
      path: a whole bank's folder; nobody may be writing it.
      name: OWNER/NAME.
      hub: another server's address, https://..., or a folder; the variable CLUTTERGEN_HUB says the same. The
        Hugging Face Hub if not given.
      is_private: a new data set can be seen by its owner alone.
      allow_outside: publish also what was made of files from outside the folders that were imported.

    Raises:
      BankError: the bank is not whole, holds what was made of files from outside the folders that were
        imported, the name is none or that of something else, or the hub refuses or cannot
        be reached.
      MissingExtraError: the extra `hub` is not installed.
    """
    from cluttergen_jax.scene.bank.hub import push

    return push(path, name, hub, is_private, allow_outside)


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
      BankError: there is no such bank, it is damaged or has no digests, `out` exists or is being written by
        another process, or the hub cannot be reached.
      UnsafePathError: it names paths outside of its folder.
      MissingExtraError: the extra `hub` is not installed.
    """
    from cluttergen_jax.scene.bank.hub import pull

    return pull(name, out, hub, revision, overwrite, allow_unchecked)


_OF_POLICIES = ("*/record.json", "*/weights.npz", "*/README.md", "*/curve.png")


def pull_policies(
    name: str, *, hub: str | None = None, revision: str | None = None, overwrite: bool = False
) -> list[str]:
    """Fetches checkpoints of policies, which methods find by name from then on (`cluttergen pull`).

    Weights of ablations do not come with the package: `scenes` of a checkout of the repository is a hub of
    its own, as in `cluttergen pull scenes/ablations --hub CHECKOUT`.

    Args:
      name: OWNER/NAME of a data set with a folder for each checkpoint, POOL-VARIANT.
      hub: as in `pull_bank`.
      revision: a branch, tag or commit; the latest if not given.
      overwrite: replace checkpoints of these names that were pulled before.

    Returns:
      The names, POOL-VARIANT.

    Raises:
      BankError: there is no such data set, it holds no checkpoint, one is there already, another process
        pulls some, or the hub cannot be reached.
      PoolError: a checkpoint is damaged.
      UnsafePathError: it names paths outside of its folder.
      MissingExtraError: the extra `hub` is not installed.
    """
    from cluttergen_jax.errors import BankError
    from cluttergen_jax.files import inside, scratch_folder, swap_in, writing
    from cluttergen_jax.kept_folder import hold_folder
    from cluttergen_jax.learning.policies.checkpoint import read_checkpoint
    from cluttergen_jax.learning.policies.embedded import pulled_root
    from cluttergen_jax.learning.ppo.checkpoint import check_weights
    from cluttergen_jax.scene.bank.hub import hub_of

    place = hub_of(hub)
    root = pulled_root()
    commit, files = place.listing(name, revision)
    found = sorted(
        {
            each.split("/")[0]
            for each in files
            if each.count("/") == 1 and each.endswith("/record.json")
        }
    )
    if not found:
        raise BankError(
            f"{name} holds no checkpoints", "a folder POOL-VARIANT with record.json for each"
        )
    with hold_folder(root):
        if there := [each for each in found if inside(root, each).exists() and not overwrite]:
            raise BankError(
                f"{root / there[0]} exists",
                "names that do not exist yet",
                "`overwrite` to replace them",
            )
        with writing(root), scratch_folder(root / "fetched") as scratch:
            place.fetch(name, commit, scratch, _OF_POLICIES)
            for each in found:
                check_weights(read_checkpoint(inside(scratch, each)).path)
            for each in found:
                swap_in(scratch / each, root / each)
        return found


def holds_policies(name: str, hub: str | None = None, revision: str | None = None) -> bool:
    """Whether a data set on a hub holds checkpoints and no bank; the errors are those of `pull_bank`."""
    from cluttergen_jax.scene.bank.hub import hub_of

    files = hub_of(hub).listing(name, revision)[1]
    return "bank.json" not in files and any(each.endswith("/record.json") for each in files)
