"""The scenes of one split of a BOP dataset: which they are, and which number the next one gets."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.schema import SchemaError, convert, parse_json

SPLIT = "train_synt"
"""Training images, synthetic."""
ORIGIN = "origin.json"
"""Beside the files of each scene."""
_SPLIT_NAME = re.compile(r"(train|val|test)(_[A-Za-z0-9][A-Za-z0-9_-]*)?")
_NUMBER = re.compile(r"\d{6,}")


@dataclass(frozen=True)
class SceneOrigin:
    """Which scene one of a dataset is, and how it is seen.

    Attributes:
      source: the name of the bank; scene: its number there.
      digest: of its objects, their poses, the support and the region, whatever its bank is called.
      settings: of its views.
      has_colour: whether its colours were drawn.
    """

    source: str
    scene: int
    digest: str
    settings: Mapping[str, int | bool | str]
    has_colour: bool

    def to_json(self) -> bytes:
        """As it stands in the file."""
        return json.dumps({"format": 1, **asdict(self)}, indent=1).encode() + b"\n"


@dataclass(frozen=True)
class Place:
    """Where a scene goes.

    Attributes:
      number: the scene's in the split.
      is_there: whether it is there as it was asked for, and need not be made.
    """

    number: int
    is_there: bool


class BopSplit:
    """What a split holds; it is read once, and remembers the places that it has given.

    Args:
      folder: of the dataset; split: by name.

    Raises:
      ConfigError: no name of a split, or scenes are there that do not say where they are from.
    """

    def __init__(self, folder: Path, split: str) -> None:
        if not _SPLIT_NAME.fullmatch(split):
            raise ConfigError(
                f"split = {split!r}",
                "train, val or test, alone or with a kind of images after it, as in train_synt",
                f"split={SPLIT!r}",
            )
        self.folder = folder / split
        self._by_digest: dict[str, tuple[int, SceneOrigin]] = {}
        self._taken: set[int] = set()
        self._first = ""
        folders = sorted(self.folder.glob("*")) if self.folder.is_dir() else []
        for scene in folders:
            if _NUMBER.fullmatch(scene.name):
                self._keep(int(scene.name), _read_origin(scene))

    def place(self, origin: SceneOrigin) -> Place:
        """The number of a scene: that which it has here; else its own if the split begins with scenes of
        the same bank and it is free; else the next after the highest.

        Raises:
          ConfigError: the scene is here, seen otherwise.
        """
        if known := self._by_digest.get(origin.digest):
            number, there = known
            _check_alike(self.folder, number, there, origin)
            return Place(number, there.has_colour or not origin.has_colour)
        is_free = (
            origin.source == (self._first or origin.source) and origin.scene not in self._taken
        )
        number = origin.scene if is_free else max(self._taken) + 1
        self._keep(number, origin)
        return Place(number, False)

    def _keep(self, number: int, origin: SceneOrigin) -> None:
        self._taken.add(number)
        self._by_digest[origin.digest] = (number, origin)
        self._first = self._first or origin.source


def _read_origin(scene: Path) -> SceneOrigin:
    try:
        return convert(parse_json((scene / ORIGIN).read_bytes()), SceneOrigin)
    except (OSError, SchemaError) as error:
        raise ConfigError(
            f"{scene} does not say which scene it is: {ORIGIN} is damaged, or missing as in datasets of "
            "earlier versions",
            "scenes that `render` of this version has added",
            "another `split`, or another `out`",
        ) from error


def _check_alike(folder: Path, number: int, there: SceneOrigin, asked: SceneOrigin) -> None:
    """Refuses a scene that is there and was seen otherwise."""
    names = dict.fromkeys([*asked.settings, *there.settings])
    differing = [name for name in names if there.settings.get(name) != asked.settings.get(name)]
    # Earlier versions did not say it.
    differing = [name for name in differing if name != "smoothing" or name in there.settings]
    if differing:
        wanted = ", ".join(f"{name} {asked.settings.get(name)}" for name in differing)
        had = ", ".join(f"{name} {there.settings.get(name)}" for name in differing)
        raise ConfigError(
            f"scene {asked.scene} of {asked.source} is in {folder} as {number:06d} with {had}, and is asked "
            f"for with {wanted}",
            "each scene once in a split",
            "the same settings, which resumes; another `split`, or another `out`",
        )
