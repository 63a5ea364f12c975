"""`cluttergen repair`: broken layouts made stable."""

from __future__ import annotations

from tyro.conf import Positional

from cluttergen_jax.api.repair import repair
from cluttergen_jax.cli.options import Options, options_from


@options_from(repair, source=Positional[str])
class Repair(Options):
    """Make broken layouts stable with little motion: noisy poses, JSON of a language model.

    Exit status 1 if one is not stable afterwards.

    Example: `cluttergen repair layout.json --pool dining --out repaired`
    """

    def run(self) -> int:
        report = self.call(repair)
        print(report)
        return 0 if all(each.is_stable for each in report.layouts) else 1
