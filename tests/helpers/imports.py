"""Imports without worker processes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from cluttergen_jax.importing.limited import Outcome
from cluttergen_jax.importing.run import ImportConfig, Job, Watch, make_job


def made_here(
    jobs: Sequence[Job], config: ImportConfig, watch: Watch | None = None
) -> Iterator[tuple[int, Outcome]]:
    """In place of `run._outcomes`: jobs are done in this process."""
    for index, job in enumerate(jobs):
        yield index, Outcome(make_job(job))
