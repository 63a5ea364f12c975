"""One object that is made by a worker process, in one of several ways."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from cluttergen_jax.assets.body import BodyConfig
from cluttergen_jax.assets.config import NUM_TRIALS
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.config import check_positive
from cluttergen_jax.errors import AssetError, ClutterGenError
from cluttergen_jax.importing.limited import most_memory
from cluttergen_jax.importing.readers import ObjectFile, ReadOptions, read_shape
from cluttergen_jax.importing.readers.read import MAX_FURNITURE, MAX_SIZE
from cluttergen_jax.importing.readers.source import states_unit
from cluttergen_jax.importing.readers.things import SeveralThings
from cluttergen_jax.importing.solo_stability import measured_object
from cluttergen_jax.importing.table_top import SEVERAL, LeftOut, Limits
from cluttergen_jax.physics.log import silent_log

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
