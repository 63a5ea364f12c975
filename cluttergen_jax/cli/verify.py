"""`cluttergen verify`: reloads every saved scene in plain MuJoCo and simulates ten seconds."""

from __future__ import annotations

import sys
from typing import ClassVar

from tyro.conf import Positional

from cluttergen_jax.cli.options import Options, options_from
from cluttergen_jax.judging.api import verify


@options_from(verify, path=Positional[str])
class Verify(Options):
    """Check that saved scenes are stable, in plain MuJoCo. Exit status 1 if one is not.

    Of a bank, its files are compared with the digests in bank.json as well, and each scene's file with its
    row: a scene of which something was changed does not count.

    Example: `cluttergen verify out`
    """

    resumes: ClassVar[bool] = False

    def run(self) -> int:
        report = self.call(verify)
        print(report)
        if report.unwritten:
            print(f"note: {report.unwritten}", file=sys.stderr)
        return 0 if report.is_sound else 1
