"""Many objects: found, made by worker processes or taken from the cache, and written as a pool."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path

from cluttergen_jax.assets.body import BodyConfig
from cluttergen_jax.assets.config import MAX_TEXTURE, DecompositionConfig
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import NAME_PATTERN, object_hash
from cluttergen_jax.assets.pool import ALL, EMBEDDED, Pool, read_pool, user_pool_folder, user_root, write_pool
from cluttergen_jax.config import check_positive, check_workers
from cluttergen_jax.errors import AssetError, ClutterGenError, PoolError
from cluttergen_jax.importing import cache
from cluttergen_jax.importing.planning import YCB, Failure, Planned, plan_all
from cluttergen_jax.importing.processes import run_all
from cluttergen_jax.importing.readers import ObjectFile, ReadOptions, Skipped, read_shape
from cluttergen_jax.importing.readers.axes import UpAxis
from cluttergen_jax.importing.solo import NUM_TRIALS, measured_object
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


def run_job(job: Job) -> str:
    """Makes the object and caches it. The empty string, or why it could not be made."""
    try:
        # Rest and ball test look at the poses themselves, so MuJoCo's own log has nothing to add.
        with silent_log():
            shape = read_shape(job.source, job.config.read)
            asset = measured_object(shape, job.config.body, job.config.trials)
            cache.store(job.key, replace(asset, flags=(*job.source.notes, *asset.flags)))
    except ClutterGenError as error:
        return str(error)
    except Exception as error:  # One object that nobody foresaw must not end a run of hundreds.
        return f"{job.source.path}: {type(error).__name__}: {error}"
    return ""


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
    """

    object: ObjectConfig = field(default_factory=ObjectConfig)
    jobs: int = 0
    force: bool = False
    progress: bool = True
    add: bool = False
    settings: Path | None = None

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


def import_pool(
    sources: str | Path | Sequence[str | Path],
    pool: str,
    *,
    tier: str = "standard",
    scale: float = 1.0,
    up: str = "auto",
    front: str = "auto",
    density: float = 500.0,
    mass: float | None = None,
    max_texture: int = MAX_TEXTURE,
    decomposition: DecompositionConfig | None = None,
    trials: int = NUM_TRIALS,
    jobs: int = 0,
    friction: float | None = None,
    licence: str = "",
    attribution: str = "",
    settings: str | Path | None = None,
    add: bool = False,
    force: bool = False,
    progress: bool = True,
) -> ImportReport:
    """Makes a user pool of all objects that files and folders hold (`cluttergen import --pool`).

    It works in processes of its own: a script calls it below `if __name__ == "__main__":`. An interrupted
    import takes up where it stopped.

    Args:
      sources: files or folders; "ycb" stands for the 78 YCB objects (extra `ycb`).
      pool: the new pool's name.
      tier: "standard" (up to 32 convex parts), or "light" (one hull) for MJX in pure JAX.
      scale, up, front, density, mass, friction, licence, attribution, max_texture: what the files do not
        say, see `ReadOptions`.
      decomposition: CoACD's parameters; `DecompositionConfig()` if not given.
      trials: placements by which solo stability is measured.
      jobs: worker processes; 0 takes one for each core.
      settings: a TOML file of settings per object, in place of the `objects.toml` in each folder.
      add: add to the pool, which exists; objects of equal names are refused, or replaced with `force`.
      force: make everything again, and replace a pool or, with `add`, objects of that name.
      progress: show a progress bar.

    Returns:
      What was made (`pool`), skipped, and what failed, and why: a file that is damaged fails alone.

    Raises:
      ConfigError, PoolError, AssetError, MissingExtraError: see `import_sources`.
    """
    read = ReadOptions(
        scale=scale,
        up=up,
        front=front,
        density=density,
        mass=mass,
        friction=friction,
        licence=licence,
        attribution=attribution,
        max_texture=max_texture,
    )
    config = ObjectConfig(read, BodyConfig(tier, decomposition or DecompositionConfig()), trials)
    how = ImportConfig(config, jobs, force, progress, add, None if settings is None else Path(settings))
    given = [sources] if isinstance(sources, str | Path) else sources
    return import_sources(given, pool, how)


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
    planned = plan_all(sources, config.object.read, config.settings)
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
            progress.say(f"importing {len(jobs)} objects, {min(num_processes, len(jobs))} at a time")
        for index, reason in run_all(run_job, jobs, num_processes):
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
