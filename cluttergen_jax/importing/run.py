"""Many objects: found, made by worker processes or taken from the cache, and written as a pool."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Collection, Generator, Mapping, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryFile

from cluttergen_jax.assets.body import BodyConfig
from cluttergen_jax.assets.config import NUM_TRIALS, TIME_LIMIT
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import NAME_PATTERN, object_hash
from cluttergen_jax.assets.pool import (
    ALL,
    EMBEDDED,
    Pool,
    hold_pool,
    read_pool,
    user_pool_folder,
    user_root,
    write_pool,
)
from cluttergen_jax.cluster import MOST_DEATHS, Cluster, each_on
from cluttergen_jax.config import check_positive, check_workers
from cluttergen_jax.errors import AssetError, ClutterGenError, PoolError, first_names
from cluttergen_jax.files import writing
from cluttergen_jax.importing import cache
from cluttergen_jax.importing.cache import NOTE, outside_note
from cluttergen_jax.importing.limited import Crew, Outcome, Watch, most_memory
from cluttergen_jax.importing.planning import (
    YCB,
    Failure,
    Planned,
    failure_of,
    name_distinctly,
    plan_all,
)
from cluttergen_jax.importing.readers import ObjectFile, ReadOptions, Skipped, read_shape
from cluttergen_jax.importing.readers.read import MAX_FURNITURE, MAX_SIZE, public_path
from cluttergen_jax.importing.readers.source import UpAxis, states_unit
from cluttergen_jax.importing.readers.things import SeveralThings
from cluttergen_jax.importing.scenery import SEVERAL, LeftOut, Limits
from cluttergen_jax.importing.solo_stability import measured_object
from cluttergen_jax.phases import say_phase
from cluttergen_jax.physics.log import silent_log
from cluttergen_jax.progress import Progress, passed_text

_JITTER = 1e-5
"""Share of an object's size by which a second try moves the corners that its parts are cut from."""
_WAYS = (
    "",
    "made on a second try, its surface minutely roughened",
    "its parts are one hull: CoACD was lost over it, and over its surface minutely roughened",
)
NUM_TRIES = len(_WAYS)


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
    fault: str = ""  # How the try before was lost; empty at the first.
    num_lost: int = 0  # Tries before.
    limits: Limits | None = None  # What is left out once it is read; None leaves nothing out.
    place: str = ""  # See `LeftOut.name`.


def make_job(job: Job) -> ObjectAsset | LeftOut | str:
    """The object, or what is said of it if it is beyond the limits, or why it could not be made."""
    try:
        # Rest and ball test look at the poses themselves, so MuJoCo's own log has nothing to add.
        with silent_log():
            # What is larger is left out as furniture, where its unit is sure.
            is_known = job.limits is not None and states_unit(job.source)
            largest = MAX_FURNITURE if is_known else MAX_SIZE
            again = f" (another try: {job.fault})" if job.num_lost else ""
            say_phase(f"reading its file{again}")
            shape = read_shape(
                job.source, job.config.read, largest=largest, is_whole=job.limits is None
            )
            beyond = job.limits and job.limits.why_shape_left_out(job.place, shape)
            if beyond:
                return beyond
            asset = measured_object(shape, _body(job), job.config.trials)
            lost = (f"{_WAYS[job.num_lost]}: before, {job.fault}",) if job.num_lost else ()
            return replace(asset, flags=(*job.source.notes, *lost, *asset.flags))
    except SeveralThings as error:
        return LeftOut(job.place, SEVERAL, ", ".join(error.places))
    except ClutterGenError as error:
        return str(error)
    except MemoryError:
        given = f"{job.source.path} takes more than {most_memory() >> 30} GB of memory"
        return str(AssetError(given, hint="a mesh of fewer triangles, or smaller images"))
    except Exception as error:  # One unforeseen object must not end a run of hundreds.
        return f"{job.source.path}: {type(error).__name__}: {error}"


def _body(job: Job) -> BodyConfig:
    """How its body is made at this try: as asked, then with another surface and seed, then as one hull."""
    body = job.config.body
    if job.num_lost == 1:
        other = replace(body.decomposition, seed=body.decomposition.seed + 100)
        return replace(body, decomposition=other, jitter=_JITTER)
    if job.num_lost:
        return replace(body, decomposition=replace(body.decomposition, max_parts=1))
    return body


def next_try(job: Job, fault: str) -> Job:
    """The same object by another way, after a try was lost."""
    return replace(job, fault=fault, num_lost=job.num_lost + 1)


_MOST_NAMED = 4
"""So many objects are named at a time as those at work."""
_LONG = 5.0
"""Seconds of one phase that are worth a word."""


@dataclass(frozen=True)
class Cost:
    """What an object cost, all tries together: seconds by the clock, and of processors."""

    seconds: float
    cpu_seconds: float


def _outcomes(
    jobs: Sequence[Job], config: ImportConfig, watch: Watch | None = None
) -> Generator[tuple[int, Outcome], None, None]:
    """What became of each job as they come, from processes of this machine, or of a cluster unwatched."""
    if config.cluster is None:
        crew = Crew(
            make_job,
            config.jobs or os.cpu_count() or 1,
            config.time_limit,
            next_try,
            NUM_TRIES,
            watch,
            True,
        )
        with closing(crew):
            yield from crew.outcomes(jobs)
        return
    # One thread each, as in processes of this machine (`limited`).
    settings = {"OMP_NUM_THREADS": "1"}
    lost = Outcome(fault=f"its worker on the cluster ended, {MOST_DEATHS} times")
    make = partial(_maker, config.time_limit)
    with closing(
        each_on(config.cluster, make, jobs, "object", settings=settings, if_lost=lost)
    ) as done:
        yield from done


def _maker(limit: float) -> Callable[[Job], Outcome]:
    """On a cluster, each worker has a process of its own that can be ended."""
    crew = Crew(make_job, 1, limit, next_try, NUM_TRIES, is_limited=True)
    return lambda job: next(crew.outcomes([job]))[1]


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
      time_limit: seconds that an object may take, all tries together; then it is left out.
      layout: the published set that the sources are of; "auto" for what they show, or "none".
      limits: of what is left out as too large or too heavy for a table.
      take_all: scenery, actors, and what is beyond the limits as well.
    """

    object: ObjectConfig = field(default_factory=ObjectConfig)
    jobs: int = 0
    force: bool = False
    progress: bool = True
    add: bool = False
    settings: Path | None = None
    cluster: Cluster | None = None
    time_limit: float = TIME_LIMIT
    layout: str = "auto"
    limits: Limits = field(default_factory=Limits)
    take_all: bool = False

    def __post_init__(self) -> None:
        check_workers("jobs", self.jobs)
        check_positive(self, "time_limit")


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
      costs: by object, what it cost now; those that failed among them, those from the cache not.
      sets: a line for each published set that was recognised.
      left_out: bodies that could be read and are no objects for a table, and why.
      unused: a line for what a JSON beside an object states and is not used; among the object's flags, too.
    """

    path: Path | None
    objects: tuple[ObjectAsset, ...]
    num_cached: int
    failures: tuple[Failure, ...]
    skipped: tuple[Skipped, ...] = ()
    up_axes: dict[str, UpAxis] = field(default_factory=dict)
    costs: dict[str, Cost] = field(default_factory=dict)
    sets: tuple[str, ...] = ()
    left_out: tuple[LeftOut, ...] = ()
    unused: tuple[str, ...] = ()

    @property
    def cost(self) -> Cost:
        """All objects together; seconds are of objects that were made beside each other."""
        each = self.costs.values()
        return Cost(sum(cost.seconds for cost in each), sum(cost.cpu_seconds for cost in each))

    @property
    def pool(self) -> Pool:
        """The pool, with what was in it before.

        Raises:
          AssetError: no object could be made.
        """
        if self.path is None:
            why = [each.reason for each in self.failures]
            why += [f"{each.reason}: {each.detail}".removesuffix(": ") for each in self.left_out]
            raise AssetError(f"nothing was imported: {'; '.join(dict.fromkeys(why))}")
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
    if config.add:
        # Refused before any work, where there is no such pool. Another process may be writing it.
        with hold_pool(user_root() / pool_name):
            read_pool(user_pool_folder(pool_name))
    known = None if config.force and not config.add else user_root() / pool_name
    planned = plan_all(
        sources, config.object.read, config.settings, known, config.layout, config.take_all
    )
    with hold_pool(user_root() / pool_name):
        _check_name_is_free(known, planned.objects, config)
    jobs, unreadable = _jobs(planned.objects, config)
    made: dict[str, ObjectAsset] = {} if config.force else _load_cached(jobs)
    missing = [job for job in jobs if job.source.name not in made]
    cached = set(made)
    if missing:
        for folder in (cache.cache_root(), user_root()):
            _check_writable(folder)
    if config.force:
        for job in missing:
            cache.drop(job.key)
    lost, beyond, costs = _make(missing, config)
    made |= _load_cached(missing)
    lost = [*lost, *_removed_meanwhile(missing, made, {*beyond, *(each.name for each in lost)})]
    # What was made by other limits is in the cache.
    beyond |= _too_large_bodies(jobs, made)
    kept = [each for each in planned.objects if each.source.name in made.keys() - beyond.keys()]
    failures = (*planned.failures, *unreadable, *lost)
    called = _final_names(planned.objects, kept)
    objects = tuple(
        replace(made[name], name=called[name]) for name in (each.source.name for each in kept)
    )
    path = _write(pool_name, objects, config) if objects else None
    return ImportReport(
        path,
        objects,
        len(cached & {each.source.name for each in kept}),
        tuple(replace(each, name=called.get(each.name, each.name)) for each in failures),
        planned.skipped,
        {called[each.source.name]: each.up for each in kept},
        {called[name]: cost for name, cost in costs.items()},
        planned.sets,
        (*planned.left_out, *beyond.values()),
        planned.unused,
    )


def _final_names(planned: Sequence[Planned], kept: Sequence[Planned]) -> dict[str, str]:
    """What each object is called in the end, by its name of before: only those that were made share numbers.

    Of the others, one whose name is taken now gets its file behind it.
    """
    names = {
        old.source.name: new.source.name
        for old, new in zip(kept, name_distinctly(kept), strict=True)
    }
    taken = set(names.values())
    others = {each.source.name: each.place for each in planned if each.source.name not in names}
    return names | {
        name: f"{name} ({place})" if name in taken else name for name, place in others.items()
    }


def _check_writable(folder: Path) -> None:
    """Refuses, before any work, a folder that takes no files (BankError)."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            pass


def _check_name(name: str) -> None:
    if not NAME_PATTERN.fullmatch(name) or name in (*EMBEDDED, ALL):
        raise PoolError(
            f"a pool called {name!r}",
            f"names of a-z, 0-9, '_' and '-', but not {', '.join((*EMBEDDED, ALL))}",
        )


def _check_name_is_free(
    known: Path | None, planned: Sequence[Planned], config: ImportConfig
) -> None:
    """Refuses, before any work, a pool's name that other objects have."""
    if known is None or not known.exists() or config.force or config.add or not planned:
        return
    try:
        held = {asset.provenance.source for asset in read_pool(known).objects}
    except ClutterGenError:
        return
    if held.isdisjoint(public_path(each.source.path) for each in planned):
        raise _name_error(known.name)


def _name_error(name: str) -> PoolError:
    return PoolError(
        f"pool {name!r} exists and holds something else",
        "a new name",
        "`add` to add to it, or `force` to replace it",
    )


def _jobs(planned: Sequence[Planned], config: ImportConfig) -> tuple[list[Job], list[Failure]]:
    """What there is to make, and the files that cannot be read."""
    jobs = []
    failures = []
    for each in planned:
        own = replace(config.object, read=each.options)
        limits = None if config.take_all or each.take else config.limits
        try:
            key = cache.cache_key(each.source, own, limits is None)
            jobs.append(Job(each.source, key, own, limits=limits, place=each.place))
        except (OSError, AssetError) as error:
            failures.append(failure_of(each.source, error))
    return jobs, failures


def _load_cached(jobs: Sequence[Job]) -> dict[str, ObjectAsset]:
    pairs = ((job.source, cache.load(job.key, job.source.name)) for job in jobs)
    return {
        source.name: _with_source(source, asset) for source, asset in pairs if asset is not None
    }


def _removed_meanwhile(
    jobs: Sequence[Job], made: Mapping[str, ObjectAsset], others: Collection[str]
) -> list[Failure]:
    """Those that were made, and that another import with `force` has removed from the cache since."""
    names = [
        job.source.name
        for job in jobs
        if job.source.name not in made and job.source.name not in others
    ]
    reason = "another import removed it from the cache meanwhile. Try: the same command again"
    return [Failure(name, reason) for name in names]


def _with_source(source: ObjectFile, asset: ObjectAsset) -> ObjectAsset:
    """A cached body that says where it is from now: the same file may lie in several folders."""
    where = {"source": public_path(source.path)} if source.provenance is None else {}
    notes = tuple(note for note in asset.notes if not note.startswith(NOTE)) + outside_note(
        source.outside
    )
    provenance = replace(asset.provenance, outside=source.outside, **where)
    return replace(asset, provenance=provenance, notes=notes)


def _too_large_bodies(jobs: Sequence[Job], made: dict[str, ObjectAsset]) -> dict[str, LeftOut]:
    """By name, what is said of bodies beyond the limits."""
    reasons = {}
    for job in jobs:
        asset = made.get(job.source.name)
        if job.limits is not None and asset is not None:
            reasons[job.source.name] = job.limits.why_body_left_out(job.place, asset)
    return {name: each for name, each in reasons.items() if each is not None}


def _make(
    jobs: Sequence[Job], config: ImportConfig
) -> tuple[list[Failure], dict[str, LeftOut], dict[str, Cost]]:
    """Runs the jobs; those that failed, in the order of the jobs, what is left out, and what each cost."""
    reasons: dict[int, str] = {}
    beyond: dict[str, LeftOut] = {}
    costs: dict[str, Cost] = {}
    num_processes = config.jobs or os.cpu_count() or 1
    is_shown = config.progress and bool(jobs)
    with Progress("importing", len(jobs), "object") if is_shown else nullcontext() as progress:
        say = partial(print, file=sys.stderr, flush=True) if progress is None else progress.say
        if progress is not None:
            at_once = "on a cluster"
            if config.cluster is None:
                at_once = f"{min(num_processes, len(jobs))} at a time"
            progress.say(
                f"importing {len(jobs)} objects, {at_once}; most take one to five CPU-seconds, "
                f"intricate ones up to twenty, and each {config.time_limit:g} at most"
            )
            if config.object.body.decomposition.quality == "fine":
                progress.say("fine parts of curved or hollow objects take several times as long")
        at_work = None if progress is None else _AtWork(progress, jobs)
        try:
            with closing(_outcomes(jobs, config, at_work)) as outcomes:
                for index, outcome in outcomes:
                    job = jobs[index]
                    cost = Cost(outcome.seconds, outcome.cpu_seconds)
                    costs[job.source.name] = cost
                    reason = _store_result(job, outcome)
                    if reason:
                        reasons[index] = reason
                    elif isinstance(outcome.result, LeftOut):
                        beyond[job.source.name] = outcome.result
                    longest = "" if at_work is None else at_work.longest(index)
                    say(_line(job.source.name, cost, outcome.result, reason, longest))
                    if progress is not None:
                        progress.update()
        except KeyboardInterrupt:
            say(f"{len(costs) - len(reasons)} of {len(jobs)} objects were made and are kept")
            raise
    return (
        [Failure(jobs[index].source.name, reasons[index]) for index in sorted(reasons)],
        beyond,
        costs,
    )


class _AtWork:
    """Shows which objects are at work, what each is at and for how long, and remembers what took longest."""

    def __init__(self, progress: Progress, jobs: Sequence[Job]) -> None:
        self._progress = progress
        self._jobs = jobs
        self._now: dict[int, tuple[str, float]] = {}
        self._seconds: dict[int, dict[str, float]] = {}
        self._last = 0.0

    def __call__(self, phases: dict[int, str]) -> None:
        now = time.monotonic()
        texts = []
        for index, phase in phases.items():
            before, began = self._now.get(index, ("", now))
            if phase == before:
                seconds = self._seconds.setdefault(index, {})
                seconds[phase] = seconds.get(phase, 0.0) + now - max(began, self._last)
            else:
                began = now
                self._now[index] = phase, now
            name = self._jobs[index].source.name
            texts.append(f"{name} ({phase}, {passed_text(now - began)})" if phase else name)
        self._last = now
        self._progress.note(f"at work: {first_names(texts, _MOST_NAMED)}")

    def longest(self, index: int) -> str:
        """What an object was at for longest, if that was long, with its seconds."""
        seconds = self._seconds.pop(index, {})
        phase = max(seconds, key=lambda each: seconds[each], default="")
        if not phase or seconds[phase] < _LONG:
            return ""
        return f"{passed_text(seconds[phase])} of it {phase}"


def _store_result(job: Job, outcome: Outcome) -> str:
    """Stores the object that was made in the cache. The empty string, or why it failed."""
    if outcome.fault:
        return str(AssetError(f"{job.source.path}: {outcome.fault}", hint=_hint(outcome)))
    if isinstance(outcome.result, str):
        return outcome.result
    if isinstance(outcome.result, LeftOut):
        return ""
    with writing(cache.cache_root()):
        cache.store(job.key, outcome.result)
    return ""


def _hint(outcome: Outcome) -> str:
    if outcome.is_late:
        return "a longer `time_limit`, or a mesh without pieces that cross, or of fewer triangles"
    if outcome.is_killed:
        return "fewer `jobs` at a time, or a mesh of fewer triangles"
    return "a mesh without pieces that cross, or of fewer triangles"


def _line(
    name: str,
    cost: Cost,
    asset: ObjectAsset | LeftOut | str | None,
    reason: str,
    longest: str = "",
) -> str:
    """One object's line in a log; `longest` is what it was at for longest."""
    took = f"{cost.seconds:.1f} s, {cost.cpu_seconds:.1f} CPU-seconds"
    took = f"{took} ({longest})" if longest else took
    if isinstance(asset, LeftOut) and not reason:
        return f"{name}: left out after {took}: {asset.reason}: {asset.detail}"
    if reason or not isinstance(asset, ObjectAsset):
        return f"{name}: failed after {took}: {reason}"
    parts = "1 part" if len(asset.parts) == 1 else f"{len(asset.parts)} parts"
    flags = f"; flagged: {'; '.join(asset.flags)}" if asset.flags else ""
    return f"{name}: made in {took}: {parts}, {asset.mass:.3g} kg{flags}"


def _write(name: str, objects: tuple[ObjectAsset, ...], config: ImportConfig) -> Path:
    """Writes the pool, or adds to what it holds now: other processes may have added to it since we began."""
    path = user_root() / name
    with hold_pool(path):
        if config.add:
            objects = _merge_pool(read_pool(user_pool_folder(name)), objects, config)
        licences = sorted({asset.provenance.licence for asset in objects})
        pool = Pool(name, objects, config.object.body.tier, "; ".join(licences))
        if path.exists() and (not config.force or config.add) and _is_same(path, pool):
            return path
        if path.exists() and not config.force and not config.add:
            raise _name_error(name)
        return write_pool(path, pool, overwrite=config.force or config.add)


def _merge_pool(
    old: Pool, objects: tuple[ObjectAsset, ...], config: ImportConfig
) -> tuple[ObjectAsset, ...]:
    """The old objects, new ones in place of those of the same name, then the rest."""
    if old.tier != config.object.body.tier:
        raise PoolError(
            f"pool {old.name!r} is of tier {old.tier}, not {config.object.body.tier}",
            f"tier={old.tier!r}",
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
