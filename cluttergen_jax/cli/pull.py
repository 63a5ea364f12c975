"""`cluttergen pull`: a bank from a hub."""

from __future__ import annotations

from pathlib import PurePosixPath

from tyro.conf import Positional

from cluttergen_jax.api.hub import pull_bank
from cluttergen_jax.cli.options import Options, options_from


@options_from(pull_bank, name=Positional[str])
class Pull(Options):
    """Fetch a bank from the Hugging Face Hub (extra `hub`) and check every file of it.

    Rerun to resume.

    Example: `cluttergen pull me/breakfast --out breakfast`
    """

    def run(self) -> int:
        """Runs the command; the exit status."""
        from cluttergen_jax.scene.bank import read_bank
        from cluttergen_jax.scene.bank.digests import without_digests

        bank = read_bank(self.call(pull_bank, out=self.out or PurePosixPath(self.name).name))
        unchecked = without_digests(bank)
        checked = f"it has no digests of its {unchecked}" if unchecked else "every file was checked"
        print(f"pulled     {bank.num_scenes} scenes to {bank.path}; {checked}")
        return 0
