"""`cluttergen certify`: a stability certificate for every scene of a bank that stands."""

from __future__ import annotations

import numpy as np
from tyro.conf import Positional

from cluttergen_jax.cli.options import Options, options_from
from cluttergen_jax.judging.api import certify


@options_from(certify, bank=Positional[str])
class Certify(Options):
    """Add a stability certificate to each successful scene of a bank, a column for each measure.

    Residual speed, drift, overlap, contacts, shake score, the contact graph, support margins, and what tilted
    gravity topples. Rerun to resume.

    Example: `cluttergen certify out --seconds 10`
    """

    def run(self) -> int:
        found = self.call(certify)
        print(
            f"{len(found.shake)} scenes that stand have their certificate ({found.num_new} rows are new); "
            f"shake score: median {np.median(found.shake):.2f}, least {found.shake.min():.2f} m/s^2"
        )
        return 0
