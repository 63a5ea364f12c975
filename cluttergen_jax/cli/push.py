"""`cluttergen push`: a bank as a data set on a hub."""

from __future__ import annotations

from dataclasses import dataclass

import tyro


@dataclass(frozen=True)
class Push:
    """Publish a bank as a data set on the Hugging Face Hub (extra `hub`), with its card.

    The bank is checked first, and replaces an earlier one of that name in one commit.

    Example: `cluttergen push out me/breakfast`

    Attributes:
      bank: its folder.
      name: OWNER/NAME.
      hub: another server's address, or a folder; the variable CLUTTERGEN_HUB says the same.
      private: a new data set can be seen by its owner alone.
    """

    bank: tyro.conf.Positional[str]
    name: tyro.conf.Positional[str]
    hub: str | None = None
    private: bool = False

    def run(self) -> int:
        """Runs the command; the exit status."""
        from cluttergen_jax.scene.bank import read_bank
        from cluttergen_jax.scene.bank.hub import local_paths, push_bank

        for path in local_paths(read_bank(self.bank)):
            print(f"note: the bank's record names a path of this machine, and will show it: {path}")
        print(f"pushed     {push_bank(self.bank, self.name, hub=self.hub, is_private=self.private)}")
        return 0
