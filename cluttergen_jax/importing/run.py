"""Many objects: found, made by worker processes or taken from the cache, and written as a pool."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path

from cluttergen_jax.assets.body import BodyConfig
from cluttergen_jax.assets.config import NUM_TRIALS
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import NAME_PATTERN, object_hash
from cluttergen_jax.assets.pool import ALL, EMBEDDED, Pool, read_pool, user_pool_folder, user_root, write_pool
from cluttergen_jax.cluster import MOST_DEATHS, Cluster, each_on
from cluttergen_jax.config import check_positive, check_workers
from cluttergen_jax.errors import AssetError, ClutterGenError, PoolError
from cluttergen_jax.importing import cache
from cluttergen_jax.importing.planning import YCB, Failure, Planned, plan_all
from cluttergen_jax.importing.processes import CRASHED, run_all
from cluttergen_jax.importing.readers import ObjectFile, ReadOptions, Skipped, read_shape
from cluttergen_jax.importing.readers.axes import UpAxis
from cluttergen_jax.importing.solo import measured_object
from cluttergen_jax.physics.log import silent_log
from cluttergen_jax.progress import Progress


@dataclass(frozen=True)
class ObjectConfig:
    """All that decides what an imported body is.

    Attributes:
      read: unit, axis, density and mass.
      body: tier and decomposition.
      trials: placements by which solo stability is measured.
    """

    read: ReadOptions = field(default_factory=ReadOptions)
    body: BodyConfig = field(default_factory=BodyConfig)
    trials: int = NUM_TRIALS

    def __post_init__(self) -> None:
        check_positive(self, "trials")


@dataclass(frozen=True)
class Job:
    """One object to be made and stored in the cache under `key`."""

    source: ObjectFile
    key: str
    config: ObjectConfig


def made(job: Job) -> ObjectAsset | str:
    """The object, or why it could not be made."""
    try:
        # Rest and ball test look at the poses themselves, so MuJoCo's own log has nothing to add.
        with silent_log():
            shape = read_shape(job.source, job.config.read)
            asset = measured_object(shape, job.config.body, job.config.trials)
            return replace(asset, flags=(*job.source.notes, *asset.flags))
    except ClutterGenError as error:
        return str(error)
    except Exception as error:  # One object that nobody foresaw must not end a run of hundreds.
        return f"{job.source.path}: {type(error).__name__}: {error}"


def run_job(job: Job) -> str:
    """Makes the object and caches it. The empty string, or why it could not be made."""
    return _cached(job, made(job))


def _cached(job: Job, asset: ObjectAsset | str) -> str:
    if isinstance(asset, str):
        return asset
    try:
        cache.store(job.key, asset)
    except OSError as error:
        return f"{job.source.path}: {type(error).__name__}: {error}"
    return ""


def _maker() -> Callable[[Job], ObjectAsset | str]:
    return made


def _run_on(cluster: Cluster, jobs: Sequence[Job]) -> Generator[tuple[int, str], None, None]:
    """As `processes.run_all`, on a cluster; objects come back to the cache of this machine."""
    # One thread each, as in processes of this machine (`processes`).
    lost: ObjectAsset | str = f"{CRASHED}, {MOST_DEATHS} times"
    done: Generator[tuple[int, ObjectAsset | str], None, None]
    done = each_on(cluster, _maker, jobs, "object", settings={"OMP_NUM_THREADS": "1"}, if_lost=lost)
    with closing(done):
        for index, asset in done:
            yield index, _cached(jobs[index], asset)


@dataclass(frozen=True)
class ImportConfig:
    """How a pool is imported.

    Attributes:
      object: what decides each body.
      jobs: worker processes; 0 takes one for each core.
      force: make everything again, and replace a pool of that name, or with `add` objects in it.
      progress: show a progress bar.
      add: add to a pool that exists.
      settings: a file of settings per object, in place of the `objects.toml` in each folder.
      cluster: where objects are made; in processes of this machine if None.
    """

    object: ObjectConfig = field(default_factory=ObjectConfig)
    jobs: int = 0
    force: bool = False
    progress: bool = True
    add: bool = False
    settings: Path | None = None
    cluster: Cluster | None = None

    def __post_init__(self) -> None:
        check_workers("jobs", self.jobs)


@dataclass(frozen=True, eq=False)
class ImportReport:
    """What an import did.

    Attributes:
      path: the pool's folder; None if no object could be made.
      objects: those that were imported, in the pool now.
      num_cached: how many of them had been made before.
      failures: those that could not be.
      skipped: files that are no objects, and why.
      up_axes: by object, the vertical axis of its file, and who says so.
    """

    path: Path | None
    objects: tuple[ObjectAsset, ...]
    num_cached: int
    failures: tuple[Failure, ...]
    skipped: tuple[Skipped, ...] = ()
    up_axes: dict[str, UpAxis] = field(default_factory=dict)

    @property
    def pool(self) -> Pool:
        """The pool, with what was in it before.

        Raises:
          AssetError: no object could be made.
        """
        if self.path is None:
            raise AssetError(f"nothing was imported: {'; '.join(each.reason for each in self.failures)}")
        return read_pool(self.path)


def import_sources(
    sources: Sequence[str | Path], pool_name: str, config: ImportConfig | None = None
) -> ImportReport:
    """Makes a user pool of everything that the sources hold; the word `ycb` stands for the YCB objects.

    Bodies are cached as they are finished: an interrupted import takes up where it stopped, and an
    unchanged one only reads.

    Raises:
      PoolError: the name is taken by an embedded pool, or by another of different content and `force` is
        not set; or `add` is, and there is no such pool, or it has other objects of the same names. Then
        nothing is lost: the bodies are in the cache.
      ConfigError: the settings are wrong, or fit nothing.
      MissingExtraError: `ycb` without the extra.
    """
    config = config or ImportConfig()
    _check_name(pool_name)
    if not sources:
        raise AssetError("nothing to import", f"files, folders, or {YCB!r}")
    old = read_pool(user_pool_folder(pool_name)) if config.add else None
    known = None if config.force and old is None else user_root() / pool_name
    planned = plan_all(sources, config.object.read, config.settings, known)
    jobs, unreadable = _jobs(planned.objects, config.object)
    made: dict[str, ObjectAsset] = {} if config.force else _loaded(jobs)
    missing = [job for job in jobs if job.source.name not in made]
    num_cached = len(made)
    if config.force:
        for job in missing:
            cache.drop(job.key)
    failures = (*planned.failures, *unreadable, *_make(missing, config))
    made |= _loaded(missing)
    names = [each.source.name for each in planned.objects if each.source.name in made]
    objects = tuple(made[name] for name in names)
    path = _write(pool_name, objects, old, config) if objects else None
    axes = {each.source.name: each.up for each in planned.objects}
    return ImportReport(
        path, objects, num_cached, failures, planned.skipped, {name: axes[name] for name in names}
    )


def _check_name(name: str) -> None:
    if not NAME_PATTERN.fullmatch(name) or name in (*EMBEDDED, ALL):
        raise PoolError(
            f"a pool called {name!r}",
            f"names of a-z, 0-9, '_' and '-', but not {', '.join((*EMBEDDED, ALL))}",
        )


def _jobs(planned: Sequence[Planned], config: ObjectConfig) -> tuple[list[Job], list[Failure]]:
    """What there is to make, and the files that cannot be read."""
    jobs, failures = [], []
    for each in planned:
        own = replace(config, read=each.options)
        try:
            jobs.append(Job(each.source, cache.cache_key(each.source, own), own))
        except OSError as error:
            failures.append(Failure(each.source.name, f"{error.filename} cannot be read ({error.strerror})"))
    return jobs, failures


def _loaded(jobs: Sequence[Job]) -> dict[str, ObjectAsset]:
    pairs = ((job.source.name, cache.load(job.key, job.source.name)) for job in jobs)
    return {name: asset for name, asset in pairs if asset is not None}


def _make(jobs: Sequence[Job], config: ImportConfig) -> list[Failure]:
    """Runs the jobs; those that failed, in the order of the jobs."""
    reasons: dict[int, str] = {}
    num_processes = config.jobs or os.cpu_count() or 1
    is_shown = config.progress and bool(jobs)
    with Progress("importing", len(jobs), "object") if is_shown else nullcontext() as progress:
        if progress is not None:
            at_once = (
                f"{min(num_processes, len(jobs))} at a time" if config.cluster is None else "on a cluster"
            )
            progress.say(f"importing {len(jobs)} objects, {at_once}")
        done = _run_on(config.cluster, jobs) if config.cluster else run_all(run_job, jobs, num_processes)
        for index, reason in done:
            if progress is not None:
                progress.update(note=jobs[index].source.name)
            if reason:
                reasons[index] = reason
    return [Failure(jobs[index].source.name, reasons[index]) for index in sorted(reasons)]


def _write(name: str, objects: tuple[ObjectAsset, ...], old: Pool | None, config: ImportConfig) -> Path:
    path = user_root() / name
    if old is not None:
        objects = _added(old, objects, config)
    licences = sorted({asset.provenance.licence for asset in objects})
    pool = Pool(name, objects, config.object.body.tier, "; ".join(licences))
    if path.exists() and (not config.force or old is not None) and _is_same(path, pool):
        return path
    if path.exists() and not config.force and old is None:
        raise PoolError(
            f"pool {name!r} exists and holds something else",
            "a new name",
            "`add` to add to it, or `force` to replace it",
        )
    return write_pool(path, pool, overwrite=config.force or old is not None)


def _added(old: Pool, objects: tuple[ObjectAsset, ...], config: ImportConfig) -> tuple[ObjectAsset, ...]:
    """The old objects, new ones in place of those of the same name, then the rest."""
    if old.tier != config.object.body.tier:
        raise PoolError(
            f"pool {old.name!r} is of tier {old.tier}, not {config.object.body.tier}", f"tier={old.tier!r}"
        )
    new = {asset.name: asset for asset in objects}
    changed = [n for n in old.names if n in new and object_hash(new[n]) != object_hash(old[n])]
    if changed and not config.force:
        raise PoolError(
            f"pool {old.name!r} has other objects called {', '.join(changed)}",
            "objects of other names",
            "`force` to replace them, or another `name` in a settings file",
        )
    kept = tuple(new.get(asset.name, asset) for asset in old.objects)
    return kept + tuple(asset for asset in objects if asset.name not in old)


def _is_same(path: Path, pool: Pool) -> bool:
    try:
        old = read_pool(path)
    except ClutterGenError:
        return False
    return old.hash == pool.hash and old.names == pool.names
