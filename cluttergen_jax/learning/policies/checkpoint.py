"""A stored policy and what its record says of it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, TypeVar

import msgspec

from cluttergen_jax.errors import PoolError
from cluttergen_jax.learning.networks.config import KIND, NetworkConfig
from cluttergen_jax.learning.ppo.checkpoint import read_record
from cluttergen_jax.schema import Record, SchemaError, convert

T = TypeVar("T")
_HINT = "a policy that `cluttergen train` of this version left"


_Count = Annotated[int, msgspec.Meta(ge=0, le=1_000_000)]


class TrainedPlacement(msgspec.Struct):
    """Of the episodes in which a policy was trained (`PlacementConfig`), what acting needs."""

    max_attempts: _Count
    history_stride: _Count
    num_objects: _Count | None = None


class Trained(msgspec.Struct):
    """What a policy's record says of how it was trained; a record without a kind is of poses."""

    network: Record
    placement: TrainedPlacement
    kind: str = KIND
    variant: str | None = None
    pool: str | None = None
    support: str | None = None
    stability: Record = {}


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """A stored policy: its folder, and its record, which is read once.

    Attributes:
      path: the folder, of `weights.npz` and `record.json`.
      record: all JSON values of the latter; trained: those that acting needs.
    """

    path: Path
    record: Record
    trained: Trained

    @property
    def variant(self) -> str | None:
        """The method's name; None where the record does not say it."""
        return self.trained.variant

    @property
    def kind(self) -> str:
        """Of its network."""
        return self.trained.kind

    @cached_property
    def network(self) -> NetworkConfig:
        """The sizes of its network, one that proposes poses.

        Raises:
          PoolError: it is of another kind, or the record names sizes that this version does not know.
        """
        if self.kind != KIND:
            given = f"{self.path} holds a network of kind {self.kind!r}, and no policy of poses"
            raise PoolError(given, hint=_HINT)
        return self.sizes(NetworkConfig)

    def sizes(self, config: Callable[..., T]) -> T:
        """The sizes of its network, whichever that is; PoolError where the record names other ones."""
        try:
            return config(**self.trained.network)
        except TypeError as error:
            place = self.path / "record.json"
            raise PoolError(
                f"{place} does not say what network it holds ({error})", hint=_HINT
            ) from error

    @cached_property
    def hash(self) -> str:
        """Hex digest of its weights and record; PoolError where there are no weights."""
        digests = [hashlib.sha256(data).digest() for data in self.files().values()]
        return hashlib.sha256(b"".join(digests)).hexdigest()

    def files(self) -> dict[str, bytes]:
        """All that it consists of, by name within its folder; PoolError where there are no weights."""
        try:
            return {
                name: (self.path / name).read_bytes() for name in ("record.json", "weights.npz")
            }
        except OSError as error:
            raise PoolError(
                f"{self.path} holds no policy ({error.strerror})",
                hint="the folder `policy` of a run",
            ) from error


def read_checkpoint(path: Path) -> Checkpoint:
    """The policy in a folder, or in the folder `policy` of a training run.

    Raises:
      PoolError: there is none, or its record is damaged, of another format, or lacks what a policy needs.
    """
    if not (path / "record.json").exists() and (path / "policy" / "record.json").is_file():
        path = path / "policy"
    record = read_record(path)
    try:
        trained = convert(record, Trained)
    except SchemaError as error:
        reason = f"does not say what network it holds, and how that was trained ({error})"
        raise PoolError(f"{path / 'record.json'} {reason}", hint=_HINT) from error
    return Checkpoint(path, record, trained)
