"""`cluttergen push`: a bank as a data set on a hub."""

from __future__ import annotations

from tyro.conf import Positional

from cluttergen_jax.api.hub import push_bank
from cluttergen_jax.cli.options import Options, options_from


@options_from(push_bank, path=Positional[str], name=Positional[str])
class Push(Options):
    """Publish a bank as a data set on the Hugging Face Hub (extra `hub`), with its card.

    The bank is checked first, and replaces an earlier one of that name in one commit.

    Example: `cluttergen push out me/breakfast`
    """

    def run(self) -> int:
        """Runs the command; the exit status."""
        from cluttergen_jax.scene.bank import read_bank
        from cluttergen_jax.scene.bank.hub import local_paths

        for path in local_paths(read_bank(self.path)):
            print(f"note: the bank's record names a path of this machine, and will show it: {path}")
        print(f"pushed     {self.call(push_bank)}")
        return 0
