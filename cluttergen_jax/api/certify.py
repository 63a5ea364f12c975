"""Stability certificates of the scenes of a bank."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cluttergen_jax.config import check_seconds, check_workers

if TYPE_CHECKING:
    from cluttergen_jax.evaluation.certify import Certification
    from cluttergen_jax.scene.bank import Bank


def certify(
    bank: Bank | str | Path,
    *,
    seconds: float = 2.0,
    jobs: int = 0,
    force: bool = False,
    cluster: str | None = None,
    workers: int = 0,
) -> Certification:
    """Adds a stability certificate to each scene of a bank that stands: a column for each measure.

    Args:
      bank: a bank's folder; in Python also a `Bank`.
      seconds: the horizon over which drift is measured, 3600 at most.
      jobs: scenes simulated at a time; 0 takes every core.
      force: measure again what has a certificate.
      cluster: where it is done: "local", Ray on this machine; "auto", the Ray cluster that this machine
        belongs to; or a cluster's address (extra `ray`). In this process if not given.
      workers: worker processes on the cluster; 0 takes as many as it has room for.
        Each has `jobs` cores, one if that is 0.

    Raises:
      BankError: the bank cannot be read or written, another process writes it, or no scene in it stands.
      ConfigError: a setting is outside its range.
      MissingExtraError: a cluster without the extra `ray`.
    """
    from cluttergen_jax.cluster import cluster_of
    from cluttergen_jax.evaluation.certify import certify_bank
    from cluttergen_jax.scene.bank import Bank, read_bank

    check_seconds("seconds", seconds)
    check_workers("jobs", jobs)
    bank = bank if isinstance(bank, Bank) else read_bank(bank)
    return certify_bank(bank, seconds, jobs, force, cluster_of(cluster, workers))
