"""`cluttergen certify`: a stability certificate for every scene of a bank that stands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import tyro

from cluttergen_jax.config import check_workers
from cluttergen_jax.errors import BankError
from cluttergen_jax.progress import Progress

if TYPE_CHECKING:
    from cluttergen_jax.bank import Bank


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
        from cluttergen_jax.bank import read_bank
        from cluttergen_jax.bank.card import write_card
        from cluttergen_jax.bank.lock import BankLock
        from cluttergen_jax.files import writing
        from cluttergen_jax.measures.simulate import horizons_of

        check_workers("--jobs", self.jobs)
        horizons_of((self.seconds,))
        bank = read_bank(self.path)
        with writing(bank.path):
            lock = BankLock(bank.path)
        try:
            print(_certify(self, bank))
            with writing(bank.path):
                write_card(bank)
        finally:
            lock.release()
        return 0


def _certify(args: Certify, bank: Bank) -> str:
    from cluttergen_jax.bank.bank import block_numbers, read_block
    from cluttergen_jax.bank.table import is_fully_certified
    from cluttergen_jax.bank.writer import write_rows
    from cluttergen_jax.certification import certified, models_of

    record = {name: value for name, value in bank.record.items() if name != "num_scenes"}
    models, num_new, shake = models_of(bank), 0, []
    with Progress("certifying", bank.num_scenes, "scene") as progress:
        for number in block_numbers(bank.path):
            rows = read_block(bank.path, number)
            if args.force or not is_fully_certified(rows):
                rows = certified(rows, models, args.seconds, args.jobs)
                write_rows(bank.path, number, rows, record)
                num_new += rows.num_rows
            shake.append(np.array(rows["shake"].drop_null()))
            progress.update(rows.num_rows)
    scores = np.concatenate([*shake, np.zeros(0)])
    if not len(scores):
        raise BankError(f"{bank.path}: no scene in it stands", hint="more scenes")
    return (
        f"{len(scores)} scenes that stand have their certificate ({num_new} rows are new); "
        f"shake score: median {np.median(scores):.2f}, least {scores.min():.2f} m/s^2"
    )
