"""Many objects: found, made in parallel or taken from the cache, and written as a pool."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import NAME_PATTERN
from cluttergen_jax.assets.pool import ALL, EMBEDDED, Pool, read_pool, user_root, write_pool
from cluttergen_jax.assets.readers import Source, find_sources, ycb_sources
from cluttergen_jax.assets.readers.source import named_apart
from cluttergen_jax.config import check_workers
from cluttergen_jax.errors import AssetError, ClutterGenError, PoolError
from cluttergen_jax.importing import cache
from cluttergen_jax.importing.processes import run_all
from cluttergen_jax.importing.worker import Job, ObjectConfig, run_job
from cluttergen_jax.progress import Progress

YCB = "ycb"


@dataclass(frozen=True)
class ImportConfig:
    """How a pool is imported.

    Attributes:
      object: what decides each body.
      jobs: worker processes; 0 takes one for each core.
      force: make everything again, and replace a pool of that name.
      progress: show a progress bar.
    """

    object: ObjectConfig = field(default_factory=ObjectConfig)
    jobs: int = 0
    force: bool = False
    progress: bool = True

    def __post_init__(self) -> None:
        check_workers("--jobs", self.jobs)


@dataclass(frozen=True)
class Failure:
    """An object that could not be made, and why."""

    name: str
    reason: str


@dataclass(frozen=True, eq=False)
class ImportReport:
    """What an import did.

    Attributes:
      path: the pool's folder; None if no object could be made.
      objects: those in the pool.
      num_cached: how many of them had been made before.
      failures: those that are not.
    """

    path: Path | None
    objects: tuple[ObjectAsset, ...]
    num_cached: int
    failures: tuple[Failure, ...]

    @property
    def status(self) -> int:
        """Exit status: 1 if anything failed."""
        return 1 if self.failures else 0


def import_sources(
    sources: Sequence[str | Path], pool_name: str, config: ImportConfig | None = None
) -> ImportReport:
    """Makes a user pool of everything that the sources hold; the word `ycb` stands for the YCB objects.

    Bodies are cached as they are finished: an interrupted import takes up where it stopped, and an
    unchanged one only reads.

    Raises:
      PoolError: the name is taken by an embedded pool, or by another of different content and `force` is
        not set. Then nothing is lost: the bodies are in the cache.
      MissingExtraError: `ycb` without the extra.
    """
    config = config or ImportConfig()
    _check_name(pool_name)
    if not sources:
        raise AssetError("nothing to import", f"files, folders, or {YCB!r}")
    found, failures = _find(sources)
    keys = [cache.cache_key(source, config.object) for source in found]
    made: dict[str, ObjectAsset] = {}
    if not config.force:
        made = _loaded(found, keys)
    missing = [
        Job(source, key, config.object)
        for source, key in zip(found, keys, strict=True)
        if source.name not in made
    ]
    num_cached = len(made)
    if config.force:
        for job in missing:
            cache.drop(job.key)
    failures += _make(missing, config)
    made |= _loaded([job.source for job in missing], [job.key for job in missing])
    objects = tuple(made[source.name] for source in found if source.name in made)
    path = _write(pool_name, objects, config) if objects else None
    return ImportReport(path, objects, num_cached, tuple(failures))


def _check_name(name: str) -> None:
    if not NAME_PATTERN.fullmatch(name) or name in (*EMBEDDED, ALL):
        raise PoolError(
            f"a pool called {name!r}",
            f"names of a-z, 0-9, '_' and '-', but not {', '.join((*EMBEDDED, ALL))}",
        )


def _find(sources: Sequence[str | Path]) -> tuple[list[Source], list[Failure]]:
    found: list[Source] = []
    failures: list[Failure] = []
    for each in sources:
        try:
            is_ycb = str(each) == YCB and not Path(each).exists()
            found += ycb_sources() if is_ycb else find_sources(each)
        except AssetError as error:
            failures.append(Failure(str(each), str(error)))
    return named_apart(found), failures


def _loaded(sources: Sequence[Source], keys: Sequence[str]) -> dict[str, ObjectAsset]:
    pairs = ((source.name, cache.load(key, source.name)) for source, key in zip(sources, keys, strict=True))
    return {name: asset for name, asset in pairs if asset is not None}


def _make(jobs: Sequence[Job], config: ImportConfig) -> list[Failure]:
    """Runs the jobs; those that failed, in the order of the jobs."""
    reasons: dict[int, str] = {}
    num_processes = config.jobs or os.cpu_count() or 1
    is_shown = config.progress and bool(jobs)
    with Progress("importing", len(jobs), "object") if is_shown else nullcontext() as progress:
        if progress is not None:
            progress.say(f"importing {len(jobs)} objects, {min(num_processes, len(jobs))} at a time")
        for index, reason in run_all(run_job, jobs, num_processes):
            if progress is not None:
                progress.update(note=jobs[index].source.name)
            if reason:
                reasons[index] = reason
    return [Failure(jobs[index].source.name, reasons[index]) for index in sorted(reasons)]


def _write(name: str, objects: tuple[ObjectAsset, ...], config: ImportConfig) -> Path:
    licences = sorted({asset.provenance.licence for asset in objects})
    pool = Pool(name, objects, config.object.body.tier, "; ".join(licences))
    path = user_root() / name
    if path.exists() and not config.force:
        if _is_same(path, pool):
            return path
        raise PoolError(
            f"pool {name!r} exists and holds something else", "a new name", "--force to replace it"
        )
    return write_pool(path, pool, overwrite=config.force)


def _is_same(path: Path, pool: Pool) -> bool:
    try:
        old = read_pool(path)
    except ClutterGenError:
        return False
    return old.hash == pool.hash and old.names == pool.names
