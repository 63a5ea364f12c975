"""`cluttergen pull`: a bank from a hub."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePosixPath

import tyro


@dataclass(frozen=True)
class Pull:
    """Fetch a bank from the Hugging Face Hub (extra `hub`) and check every file of it.

    The same command goes on where it was interrupted.

    Example: `cluttergen pull me/breakfast --out breakfast`

    Attributes:
      name: OWNER/NAME.
      out: the folder to make; NAME if not given.
      hub: another server's address, or a folder; the variable CLUTTERGEN_HUB says the same.
      revision: a branch, tag or commit; the latest if not given.
      overwrite: replace a bank that is there.
    """

    name: tyro.conf.Positional[str]
    out: str | None = None
    hub: str | None = None
    revision: str | None = None
    overwrite: bool = False

    def run(self) -> int:
        """Runs the command; the exit status."""
        from cluttergen_jax.scene.bank import read_bank
        from cluttergen_jax.scene.bank.hub import pull_bank

        out = self.out or PurePosixPath(self.name).name
        path = pull_bank(self.name, out, hub=self.hub, revision=self.revision, overwrite=self.overwrite)
        bank = read_bank(path)
        print(f"pulled     {bank.num_scenes} scenes to {path}; every file was checked")
        return 0
