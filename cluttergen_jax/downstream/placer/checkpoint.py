"""Trained placers: from a folder, or from those that come with the package."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from cluttergen_jax.downstream.fitting import Learner, blank_params, config_of, embedded_checkpoints
from cluttergen_jax.downstream.placer.query import Example, Placer
from cluttergen_jax.downstream.placer.scored import ScoredConfig, ScoredHead
from cluttergen_jax.errors import PoolError
from cluttergen_jax.learning import read_policy, read_record


class Head(Learner, Protocol):
    """A network, what it learns from a pair, and the placer that acts by it; a frozen value."""

    @property
    def kind(self) -> str:
        """Its name in records and on the command line."""

    def prepare(self, example: Example) -> Any:
        """What a gradient step reads of one pair, made once; a pytree, to be mapped."""

    def placer(self, params: Any, temperature: float = 1.0) -> Placer:
        """The placer with these weights; temperature: that of its chances, where it tells them."""


KIND = "placer"
"""Of a checkpoint, as its record names it."""
HEADS: Mapping[str, tuple[Any, Any]] = {
    "scored": (ScoredHead, ScoredConfig),
}
"""By kind: what learns, and the sizes of its network."""
REMOVED_HEADS = ("mixture", "regression")
_HINT = "the folder `placer` of a run of `cluttergen placer train`"


def embedded_placers() -> dict[str, Path]:
    """The trained placers that come with the package, by the name of their head."""
    return embedded_checkpoints("placers")


def head_of(record: Mapping[str, Any], path: Path, wanted: str | None = None) -> Head:
    """The head that a checkpoint's record names.

    Args:
      wanted: the only kind that will do; any if None.

    Raises:
      PoolError: it is of no placer, of another head, or of sizes that this version does not know.
    """
    if record.get("kind") != KIND:
        kind = record.get("kind", "pose")
        raise PoolError(f"{path} holds a network of kind {kind!r}, and no placer", hint=_HINT)
    name = str(record.get("head"))
    if name in REMOVED_HEADS:
        raise PoolError(
            f"{path} holds a placer with the head {name!r}, which was removed after version 0.1.0",
            wanted or ", ".join(HEADS),
            "a placer with the head 'scored', trained on the same pairs: `cluttergen placer train`",
        )
    if name not in HEADS or wanted not in (None, name):
        raise PoolError(
            f"{path} holds a placer with the head {name!r}", wanted or ", ".join(HEADS), _HINT
        )
    head, config = HEADS[name]
    return head(
        config_of(
            config, record, path, "a placer that `cluttergen placer train` of this version left"
        )
    )


def placer_folder(placer: str | Path) -> Path | None:
    """Where a trained placer is: that of a name that comes with the package, a folder of its own, or a run's.

    None if it is neither a name nor a folder.
    """
    if not str(placer):
        return None
    path = embedded_placers().get(str(placer), Path(placer))
    inner = path / "placer"
    if (inner / "record.json").is_file():
        return inner
    return path if path.is_dir() else None


def load_placer(path: Path, wanted: str | None = None) -> Placer:
    """The placer in a folder.

    Args:
      wanted: the head that it must have; any if None.

    Raises:
      PoolError: there is none, it is damaged, or of another kind or head.
    """
    try:
        record = read_record(path)
    except PoolError as error:
        raise PoolError(error.given, hint=_HINT) from error
    head = head_of(record, path, wanted)
    temperature = record.get("temperature", 1.0)
    if not isinstance(temperature, int | float) or not 0 < temperature < 1e3:
        raise PoolError(
            f"{path / 'record.json'}: temperature {temperature!r}", "a positive number", _HINT
        )
    return head.placer(read_policy(path, blank_params(head)), float(temperature))
