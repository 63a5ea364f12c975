"""`cluttergen pull`: a bank, or checkpoints of policies, from a hub."""

from __future__ import annotations

from pathlib import PurePosixPath

from tyro.conf import Positional

from cluttergen_jax.api.hub import holds_policies, pull_bank, pull_policies
from cluttergen_jax.cli.options import Options, options_from


@options_from(pull_bank, name=Positional[str])
class Pull(Options):
    """Fetch a bank, or policies, from the Hugging Face Hub (extra `hub`) and check every file of it.

    Rerun to resume.

    Example: `cluttergen pull me/breakfast --out breakfast`
    """

    def run(self) -> int:
        """Runs the command; the exit status."""
        from cluttergen_jax.scene.bank import read_bank
        from cluttergen_jax.scene.bank.digests import without_digests

        if holds_policies(self.name, self.hub, self.revision):
            where = "for a data set of policies"
            names = self.call(pull_policies, where, "leaving it out: methods find them by name")
            print(f"pulled     {len(names)} checkpoints: {', '.join(names)}")
            return 0
        bank = read_bank(self.call(pull_bank, out=self.out or PurePosixPath(self.name).name))
        unchecked = without_digests(bank)
        checked = f"it has no digests of its {unchecked}" if unchecked else "every file was checked"
        print(f"pulled     {bank.num_scenes} scenes to {bank.path}; {checked}")
        return 0
