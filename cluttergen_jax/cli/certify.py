"""`cluttergen certify`: a stability certificate for every scene of a bank that stands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import tyro


@dataclass(frozen=True)
class Certify:
    """Add a stability certificate to each scene of a bank that stands, a column for each measure.

    Residual speed, drift, overlap, contacts, shake score, who rests on whom, support margins, and what tilted
    gravity topples. The same command goes on where it was interrupted.

    Example: `cluttergen certify out --seconds 10`

    Attributes:
      path: a bank.
      seconds: the horizon over which drift is measured.
      jobs: scenes simulated at a time; 0 takes every core.
      force: measure again what has a certificate.
    """

    path: tyro.conf.Positional[str]
    seconds: float = 2.0
    jobs: int = 0
    force: bool = False

    def run(self) -> int:
        """Runs the command; the exit status."""
        from cluttergen_jax.evaluation.certify import certify

        found = certify(self.path, seconds=self.seconds, jobs=self.jobs, force=self.force)
        print(
            f"{len(found.shake)} scenes that stand have their certificate ({found.num_new} rows are new); "
            f"shake score: median {np.median(found.shake):.2f}, least {found.shake.min():.2f} m/s^2"
        )
        return 0
