"""Whether saved scenes are stable."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cluttergen_jax.config import VerifyConfig

if TYPE_CHECKING:
    from cluttergen_jax.judging.verify import VerificationReport


def verify(
    path: str | Path,
    check: VerifyConfig | None = None,
    *,
    jobs: int = 0,
    cluster: str | None = None,
    workers: int = 0,
    allow_unchecked: bool = False,
) -> VerificationReport:
    """Checks that saved scenes are stable: plain MuJoCo, sleeping disabled (`cluttergen verify`).

    Of a bank, its files are compared with the digests in bank.json as well, and each scene's file with its
    row: a scene of which something was changed does not count. What was found is written to verification.json
    in the bank's folder.

    Args:
      path: a bank (its folder, or a URL), or one MJCF file with a keyframe called scene.
      check: how long, and what counts as standing; the defaults of `VerifyConfig` if not given.
      jobs: scenes simulated at a time; 0 takes every core.
      cluster: where it is done: "local", Ray on this machine; "auto", the Ray cluster that this machine
        belongs to; or a cluster's address (extra `ray`). In this process if not given. All machines have to
        see the files under the same path.
      workers: worker processes on the cluster; 0 takes as many as it has room for.
      allow_unchecked: simulate a bank that has no digests of its files, as those of older versions have none.

    Raises:
      BankError: there is nothing to verify, or the one file that is given cannot be loaded or simulated
        (of a bank, such a scene is not stable, and its `fault` says why), or a bank has no digests of its
        files.
      UnsafePathError: a file of a bank names files outside of that bank.
      ConfigError: `jobs` is out of range.
      MissingExtraError: a cluster without the extra `ray`.
    """
    from cluttergen_jax.cluster import cluster_of
    from cluttergen_jax.judging.verify import verify_files
    from cluttergen_jax.scene.bank.remote import bank_folder

    return verify_files(
        bank_folder(path),
        check or VerifyConfig(),
        jobs,
        cluster_of(cluster, workers),
        allow_unchecked,
    )
