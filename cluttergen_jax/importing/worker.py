"""One object, from source to cache. Runs in a worker process."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from cluttergen_jax.assets.body import BodyConfig
from cluttergen_jax.assets.config import NUM_TRIALS
from cluttergen_jax.config import check_positive
from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.importing import cache
from cluttergen_jax.importing.readers import ObjectFile, ReadOptions, read_shape
from cluttergen_jax.importing.solo import measured_object
from cluttergen_jax.physics.log import silent_log


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
