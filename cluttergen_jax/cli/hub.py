"""`cluttergen push` and `cluttergen pull`: a bank to and from a hub, and checkpoints of policies from one."""

from __future__ import annotations

from pathlib import PurePosixPath

from tyro.conf import Positional

from cluttergen_jax.api.hub import holds_policies, pull_bank, pull_policies, push_bank
from cluttergen_jax.cli.options import Options, options_from


@options_from(push_bank, path=Positional[str], name=Positional[str])
class Push(Options):
    """Publish a bank as a data set on the Hugging Face Hub (extra `hub`), with its card.

    The bank is checked first, and replaces an earlier one of that name in one commit.

    Example: `cluttergen push out me/breakfast`
    """

    def run(self) -> int:
        from cluttergen_jax.scene.bank import read_bank
        from cluttergen_jax.scene.bank.hub import local_paths

        for path in local_paths(read_bank(self.path)):
            print(f"note: the bank's record names a path of this machine, and will show it: {path}")
        print(f"pushed     {self.call(push_bank)}")
        return 0


@options_from(pull_bank, name=Positional[str])
class Pull(Options):
    """Fetch a bank, or policies, from the Hugging Face Hub (extra `hub`) and check every file of it.

    Rerun to resume.

    Example: `cluttergen pull me/breakfast --out breakfast`
    """

    def run(self) -> int:
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
