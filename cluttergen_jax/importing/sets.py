"""Published sets of objects, known by what their folders hold; their layouts are data: sets.yaml.

A layout says which files are models, what is no table-top object, and what the files themselves do not say
(unit, axis, licence, label). Options and settings of the user go before it.
"""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cache, lru_cache
from glob import escape
from pathlib import Path
from typing import Any

import msgspec

from cluttergen_jax.errors import AssetError, ConfigError
from cluttergen_jax.files import MOST_WORDS
from cluttergen_jax.importing.readers import ObjectFile, ReadOptions
from cluttergen_jax.importing.readers.opening import gunzip, read_file
from cluttergen_jax.importing.readers.source import label_of
from cluttergen_jax.importing.settings import did_you_mean
from cluttergen_jax.schema import convert, parse_yaml

AUTO = "auto"
NONE = "none"
_DEFAULTS = ReadOptions()


class Lookup(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where an object's label or licence stands.

    Attributes:
      file: a JSON file, packed or not, from the object's file on; {stem} and {folder} are the latter's.
      key: names in it, one below the other, with / between them.
      folder: in place of a file, the name of a folder: 1 is the one above the object's own.
    """

    file: str = ""
    key: str = ""
    folder: int = 0


class SetLayout(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One set, as sets.yaml explains it."""

    title: str
    signs: tuple[str, ...]
    tried: str = ""
    models: tuple[str, ...] = ()
    leave_out: dict[str, tuple[str, ...]] = {}
    values: dict[str, str | float] = {}
    lookups: dict[str, Lookup] = {}
    note: str = ""


@dataclass(frozen=True)
class KnownSet:
    """A set that was recognised, or that the user named."""

    name: str
    layout: SetLayout
    home: Path  # The real folder that its patterns are relative to.

    def covers(self, source: ObjectFile) -> bool:
        """Whether an object lies in the set's home."""
        return source.path.resolve().is_relative_to(self.home)

    def why_out(self, source: ObjectFile) -> str:
        """Why a source is no object of the set; empty if it is one, or none of the set's business."""
        path = os.path.relpath(source.path.resolve(), self.home).replace(os.sep, "/")
        names = (path, f"{path}#{source.body}")
        for why, patterns in self.layout.leave_out.items():
            if any(fnmatchcase(name, each) for name in names for each in patterns):
                return f"{why} ({self.layout.title}; set=none takes it)"
        return ""

    def is_model(self, source: ObjectFile) -> bool:
        """Whether a source is one of the set's models; any is where its layout names none."""
        path = source.path.resolve()
        place = os.path.relpath(path, self.home).replace(os.sep, "/")
        patterns = (
            each.replace("{folder}", escape(path.parent.name)) for each in self.layout.models
        )
        return not self.layout.models or any(fnmatchcase(place, each) for each in patterns)

    def read(self, options: ReadOptions, found: Mapping[str, str]) -> ReadOptions:
        """Options with the set's values, and with what was found, wherever the user has left the default."""
        values = {
            **self.layout.values,
            **{key: value for key, value in found.items() if key != "label"},
        }
        free = [key for key in values if getattr(options, key) == getattr(_DEFAULTS, key)]
        return replace(options, **{key: values[key] for key in free})  # type: ignore[arg-type]

    def look_up(self, source: ObjectFile) -> dict[str, str]:
        """What stands beside an object, or above it: its label, its licence."""
        found = {key: _look_up(each, source.path) for key, each in self.layout.lookups.items()}
        return {key: value for key, value in found.items() if value}


@cache
def layouts() -> dict[str, SetLayout]:
    """All layouts by name, in the order in which they are tried."""
    document = parse_yaml(Path(__file__).with_suffix(".yaml").read_bytes())
    return convert(document, dict[str, SetLayout])


def known_sets(root: Path, files: Iterable[Path], name: str = AUTO) -> tuple[KnownSet, ...]:
    """The sets that files belong to.

    Args:
      root: the folder that the user gave: home of a set that is named and not recognised.
      files: what lies in it, at any depth; folders above count as well.
      name: "auto", "none", or the one set that it is.

    Raises:
      ConfigError: there is no layout of that name.
    """
    if name == NONE:
        return ()
    if name not in (AUTO, *layouts()):
        allowed = ", ".join((AUTO, NONE, *layouts()))
        raise ConfigError(f"set = {name!r}{did_you_mean(name, layouts())}", allowed)
    real = [each.resolve() for each in files]
    tried = layouts() if name == AUTO else {name: layouts()[name]}
    at: dict[Path, KnownSet] = {}
    for key, each in tried.items():
        # Google's scans in SDF are folders as Gazebo's models are: the first that fits a folder is it.
        at |= {home: KnownSet(key, each, home) for home in _homes(each, real) if home not in at}
    found = tuple(at.values())
    return found or (() if name == AUTO else (KnownSet(name, layouts()[name], root.resolve()),))


def describe_sets(sets: Sequence[KnownSet], num_others: Mapping[str, int]) -> Iterator[str]:
    """One line for each set.

    Args:
      num_others: by set, how many files in its home are none of its models.
    """
    for name in dict.fromkeys(each.name for each in sets):
        homes = [each.home.name for each in sets if each.name == name]
        layout = layouts()[name]
        where = f"{homes[0]}/" if len(homes) == 1 else f"{len(homes)} folders"
        values = [f"{key} {value}" for key, value in layout.values.items() if key != "attribution"]
        untried = () if layout.tried else ("known from public lists of files alone",)
        note = (layout.note,) if layout.note else ()
        count = num_others.get(name, 0)
        others = (
            f"{count} other {'file' if count == 1 else 'files'} there no objects of their own",
        )
        parts = (f"{layout.title} in {where}", *values, *note, *untried, *(others if count else ()))
        yield f"recognised: {', '.join(parts)}"


def _homes(layout: SetLayout, files: Sequence[Path]) -> list[Path]:
    """The folders that hold all signs of a set."""
    homes: list[set[Path]] = []
    for sign in layout.signs:
        steps = [each.split("/") for each in sign.split("|")]
        homes.append(
            {home for each in steps for file in files if (home := _home(file, each)) is not None}
        )
    return sorted(set.intersection(*homes))


def _home(file: Path, steps: list[str]) -> Path | None:
    """What lies before the last steps of a path, if these fit."""
    if not fnmatchcase(file.name, steps[-1]) or len(file.parts) <= len(steps):
        return None
    fits = all(fnmatchcase(*pair) for pair in zip(file.parts[-len(steps) :], steps, strict=True))
    return file.parents[len(steps) - 1] if fits else None


def _look_up(where: Lookup, path: Path) -> str:
    if where.folder:
        return label_of(path.resolve().parents[where.folder].name)
    words = {"stem": path.stem, "folder": path.resolve().parent.name}
    file = path.resolve().parent / where.file.format(**words)
    value = _json(file, file.stat().st_mtime_ns) if file.is_file() else None
    for key in where.key.format(**words).split("/"):
        value = value.get(key) if isinstance(value, dict) else None
    return value.strip() if isinstance(value, str) else ""


@lru_cache(maxsize=4)
def _json(path: Path, time: int) -> Any:
    """A JSON file's content as of a time; None if it cannot be read."""
    try:
        data = read_file(path, MOST_WORDS)
        return json.loads(gunzip(data) if path.suffix == ".gz" else data)
    except (AssetError, OSError, ValueError, EOFError, RecursionError, zlib.error):
        return None
