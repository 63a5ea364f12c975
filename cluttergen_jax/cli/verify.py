"""`cluttergen verify`: every saved scene, loaded afresh in plain MuJoCo, for ten seconds."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field

import tyro

from cluttergen_jax.cli.parse import keywords
from cluttergen_jax.config import VerifyConfig


@dataclass(frozen=True)
class Verify:
    """Check that saved scenes stand: plain MuJoCo, everything awake. Exit status 1 if one does not.

    Of a bank, its files are compared with the digests in bank.json as well: a scene of which a file was
    changed does not count.

    Example: `cluttergen verify out`

    Attributes:
      path: a bank, or one MJCF file with a keyframe called scene.
      check: how long, and what counts as standing.
      jobs: scenes simulated at a time; 0 takes every core.
    """

    path: tyro.conf.Positional[str]
    check: VerifyConfig = field(default_factory=VerifyConfig)
    jobs: int = 0

    def run(self) -> int:
        """Runs the command; the exit status."""
        from cluttergen_jax.scene.bank.verify import verify

        report = verify(**keywords(self))
        print(report)
        if report.unwritten:
            print(f"note: {report.unwritten}", file=sys.stderr)
        return 0 if report.is_sound else 1
