"""What a JSON beside an object's file states of it: scale, mass, axes, friction, names and terms.

Known sets keep such files as sidecars.yaml says. Of others it is not known whether a "scale" is a factor to
metres, and of which mesh: what they state is reported, and not used.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import msgspec

from cluttergen_jax import schema
from cluttergen_jax.importing.readers.sidecar_values import (
    UNIT,
    VALUES,
    WORDS,
    is_same,
    physical_values,
    scale_of,
    short_text,
)
from cluttergen_jax.importing.readers.source import ObjectFile, own_up, says_something
from cluttergen_jax.schema import convert, parse_yaml

_MAX_BYTES = 16 << 20
"""Larger files are no description of objects."""
# Letters of a label or a licence, and of a value in a message.
_MAX_WORD = 300
_MAX_SHOWN = 60

_MAX_DEPTH = 4
"""So deep, and in so many values, a JSON of no known set is searched."""
_MAX_MEMBERS = 10_000
_MAX_ALARMS = 4
_HANDLED = ("label.json",)
"""Read with a URDF (`urdf`)."""


class Family(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The files of one published set, as sidecars.yaml explains them."""

    title: str
    files: tuple[str, ...]
    asset: str = ""
    pieces: tuple[str, ...] = ()
    entries: tuple[str, ...] = ("",)
    signs: tuple[str, ...] = ()
    title_of_folder: bool = False
    keys: dict[str, str] = {}
    unused: dict[str, Any] = {}


@dataclass(frozen=True)
class Stated:
    """What is stated of one object.

    Attributes:
      file: the JSON of a known set; None if there is none.
      set_title: what people call that set.
      values: scale, up, front, mass, density, friction and words, by name.
      stretch: factors along the file's x, y and z beside `scale`, of product 1.
      title: what the object is called; empty if its own file says that.
      alarms: what is stated and not used: its name as in `values`, and words.
    """

    file: Path | None = None
    set_title: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)
    stretch: tuple[float, float, float] = (1.0, 1.0, 1.0)
    title: str = ""
    alarms: tuple[tuple[str, str], ...] = ()


@cache
def families() -> dict[str, Family]:
    """All families by name, in the order in which they are tried."""
    document = parse_yaml(Path(__file__).with_suffix(".yaml").read_bytes())
    return convert(document, dict[str, Family])


def named_pieces(files: Sequence[Path]) -> dict[Path, Path]:
    """By real path, the files that a JSON of a known set names as pieces of another, with that JSON."""
    found: dict[Path, Path] = {}
    for family in families().values():
        patterns = {each.rpartition("/")[2] for each in family.files} if family.pieces else set()
        for file in files:
            if not any(fnmatchcase(file.name, each) for each in patterns):
                continue
            document = _content(file)
            asset = _place(file, document, family.asset)
            for key in family.pieces:
                piece = _place(file, document, key)
                if piece is not None and piece != asset:
                    found.setdefault(piece, file)
    return found


class Sidecars:
    """The JSON files around some objects.

    Args:
      sources: the objects.
      files: all files of their tree.
      is_known: whether what known sets state is used; else it is reported as that of others is.
    """

    def __init__(
        self, sources: Sequence[ObjectFile], files: Sequence[Path], is_known: bool = True
    ) -> None:
        self.used: set[Path] = set()
        self._is_known = is_known
        self._files = [each for each in files if each.suffix.lower() == ".json"]
        self._num_in = Counter(path.parent for path in {each.path for each in sources})
        self._stems = {(each.path.parent, each.path.stem.lower()) for each in sources}
        self._by_asset: dict[Path, list[Path]] = {}
        self._looked_in: set[Path] = set()
        self._json: dict[Path, list[Path]] = {}
        for family in families().values():
            if family.asset:
                self._index(self._files, family)

    def of(self, source: ObjectFile, place: str) -> Stated:
        """What is stated of an object.

        Args:
          place: its name in objects.toml.
        """
        for family in families().values() if self._is_known else ():
            for file in self._files_of(family, source):
                try:
                    document = read_json(file)
                except ValueError as error:
                    self.used.add(file.resolve())
                    return Stated(alarms=(("", _unreadable(file, error)),))
                entry = self._entry(document, source, family)
                if entry is not None and (
                    not family.signs or any(key in entry for key in family.signs)
                ):
                    self.used.add(file.resolve())
                    return self._stated(entry, file, family, source, place)
        return self._unknown(source, place)

    def _files_of(self, family: Family, source: ObjectFile) -> Iterator[Path]:
        folder = source.path.resolve().parent
        words = {
            "stem": source.path.stem,
            "folder": folder.name,
            "number": _number_of(source.path.stem),
        }
        if family.asset:
            if folder not in self._looked_in:
                self._looked_in.add(folder)
                self._index([each for name in family.files for each in _glob(folder, name)], family)
            about = self._by_asset.get(source.path.resolve(), [])
            own = [each for each in about if _stem(each) == source.path.stem.lower()]
            yield from (own or about)[:1]
            return
        for name in family.files:
            file = folder / name.format(**words)
            if file.is_file():
                yield file

    def _index(self, files: Sequence[Path], family: Family) -> None:
        for file in files:
            if any(fnmatchcase(file.name, each.rpartition("/")[2]) for each in family.files):
                asset = _place(file, _content(file), family.asset)
                called = (each for each in _meshes(file.parent) if _stem(each) == _stem(file))
                for path in (asset,) if asset else called:
                    about = self._by_asset.setdefault(path.resolve(), [])
                    if file not in about:
                        about.append(file)

    def _entry(self, document: Any, source: ObjectFile, family: Family) -> dict[str, Any] | None:
        """What a document says of one object; None if it says nothing."""
        folder = source.path.resolve().parent.name
        for each in family.entries:
            key = each.format(stem=source.path.stem, folder=folder)
            if key:
                found = (
                    document.get(key)
                    if isinstance(document, dict)
                    else _named(document, source.path)
                )
                if isinstance(found, dict):
                    return found
            elif isinstance(document, dict):
                is_alone = len(family.entries) == 1 or self._num_in[source.path.parent] == 1
                if is_alone or document.get("uid") in (source.path.stem, folder):
                    return document
        return None

    def _stated(
        self, entry: dict[str, Any], file: Path, family: Family, source: ObjectFile, place: str
    ) -> Stated:
        values: dict[str, Any] = {}
        alarms: list[tuple[str, str]] = []
        stretch = (1.0, 1.0, 1.0)
        for name, key, value in _keys_of(family, entry):
            try:
                found, factors = (
                    scale_of(value) if name == "scale" else (VALUES[name](value), stretch)
                )
                if name == "mass" and source.body:
                    raise ValueError(
                        "it is the mass of the whole file, and the object is one body of it"
                    )
                if factors != (1.0, 1.0, 1.0) and source.kind != "mesh":
                    raise ValueError("a model has one factor for all axes")
                if name == UNIT and "scale" in values and found != 1.0:
                    raise ValueError("a scale is stated, too")
            except ValueError as error:
                if name not in WORDS:
                    option = "scale" if name == UNIT else name
                    alarms.append(
                        (option, _alarm(file, key, value, str(error), option, place, None))
                    )
                continue
            values.setdefault("scale" if name == UNIT else name, found)
            stretch = factors
        for key, plain in family.unused.items():
            value = entry.get(key)
            if value is not None and not is_same(value, plain):
                reason = f"{family.title}'s {key} is not followed"
                alarms.append((key, _alarm(file, key, value, reason, key, "", None)))
        if others := self._other_files(source, file, family):
            text = f"{', '.join(others)} states something else than {file.name}, and is not used"
            alarms.append(("", text))
        title = self._title(source, file, family)
        return Stated(file, family.title, values, stretch, title, tuple(alarms))

    def _title(self, source: ObjectFile, file: Path, family: Family) -> str:
        """What an object is called, by its JSON or the folder that this lies in; else empty."""
        if family.title_of_folder:
            number = _number_of(source.path.stem)
            is_of_several = self._num_in[source.path.parent] > 1
            return file.resolve().parent.name + (f"-{number}" if is_of_several and number else "")
        return (
            file.name.split(".")[0] if family.asset and not says_something(source.path.stem) else ""
        )

    def _other_files(self, source: ObjectFile, file: Path, family: Family) -> list[str]:
        """Other files of a set about the same object that state something else."""
        own = [*_keys_of(family, _content(file))]
        return [
            each.name
            for each in self._by_asset.get(source.path.resolve(), [])
            if each.resolve() != file.resolve() and [*_keys_of(family, _content(each))] != own
        ]

    def _unknown(self, source: ObjectFile, place: str) -> Stated:
        """What JSON files of no known set state of an object's scale, mass, axis and unit."""
        alarms: list[tuple[str, str]] = []
        for file in self._around(source):
            try:
                document = read_json(file)
            except ValueError as error:
                alarms.append(("", _unreadable(file, error)))
                self.used.add(file.resolve())
                continue
            entry = _named(document, source.path)
            if isinstance(document, list) and len(document) == 1:
                document = document[0]
            for name, key, value, suggested in physical_values(
                document if entry is None else entry
            ):
                if name == "up" and suggested == own_up(source.path, source.kind).axis:
                    continue
                reason = "it is of no known set" if self._is_known else "sets are not asked for"
                alarms.append((name, _alarm(file, key, value, reason, name, place, suggested)))
                self.used.add(file.resolve())
        return Stated(alarms=tuple(alarms[:_MAX_ALARMS]))

    def _around(self, source: ObjectFile) -> list[Path]:
        """JSON files called after an object's file; else the only one of its folder.

        That is also the only one above, where the folder's own name says nothing.
        """
        folder = source.path.parent
        stem = source.path.stem.lower()
        handled = () if source.kind == "mesh" else _HANDLED
        here = [each for each in self._json_in(folder) if each.name not in handled]
        own = [each for each in here if _stem(each) == stem]
        others = [each for each in here if (folder, _stem(each)) not in self._stems]
        begun = [each for each in others if re.match(rf"{re.escape(stem)}[-_ ]", each.stem.lower())]
        if own or begun:
            return own or begun
        if here or says_something(folder.resolve().name):
            return others if len(here) == 1 else []
        above = self._json_in(folder.resolve().parent)
        return above if len(above) == 1 else []

    def _json_in(self, folder: Path) -> list[Path]:
        if folder not in self._json:
            self._json[folder] = list(_glob(folder, "*.json"))
        return self._json[folder]


def _keys_of(family: Family, entry: Any) -> Iterator[tuple[str, str, Any]]:
    """What a document states of what a family's table names: name, key and value."""
    for name, spellings in family.keys.items():
        key = next((each for each in spellings.split("|") if _at(entry, each) is not None), None)
        if key is not None:
            yield name, key, _at(entry, key)


@lru_cache(maxsize=8)
def _parsed(path: Path, time: int, size: int) -> tuple[Any, str]:
    """A file's JSON as of a time, and why there is none; NaN is judged where it stands."""
    if size > _MAX_BYTES:
        return None, f"it holds {size >> 20} MB"
    try:
        return schema.read_json(path, allow_nan=True, most=_MAX_BYTES), ""
    except OSError as error:
        return None, error.strerror or "it is damaged"
    except schema.SchemaError as error:
        return None, str(error)


def read_json(path: Path) -> Any:
    """What a JSON file says, packed or not.

    Raises:
      ValueError: it is no regular file of reasonable size, or not JSON, or has a key twice.
    """
    try:
        about = path.stat()
    except OSError as error:
        raise ValueError(error.strerror) from error
    document, fault = _parsed(path, about.st_mtime_ns, about.st_size)
    if fault:
        raise ValueError(fault)
    return document


def _content(path: Path) -> Any:
    """`read_json`, or None where it cannot be read."""
    try:
        return read_json(path)
    except ValueError:
        return None


def _place(file: Path, document: Any, key: str) -> Path | None:
    """The real path of a file that a JSON names; None if it names none."""
    name = document.get(key) if isinstance(document, dict) and key else None
    if not isinstance(name, str) or not name or "\0" in name:
        return None
    try:
        return (file.parent / name.replace("\\", "/")).resolve()
    except (OSError, RuntimeError, UnicodeError):
        return None


def _glob(folder: Path, pattern: str) -> Iterator[Path]:
    """Files that fit a pattern, whose folders before its last step are spelt out."""
    inner, _, name = pattern.rpartition("/")
    try:
        yield from sorted(each for each in (folder / inner).glob(name) if each.is_file())
    except OSError:
        return


def _meshes(folder: Path) -> Iterator[Path]:
    yield from (each for each in _glob(folder, "*") if each.suffix.lower() != ".json")


def _stem(path: Path) -> str:
    """A file's name up to its first dot."""
    return path.name.lower().split(".")[0]


def _number_of(stem: str) -> str:
    found = re.search(r"\d+$", stem)
    return found[0] if found else ""


def _at(entry: Any, key: str) -> Any:
    for step in key.split("/"):
        if isinstance(entry, list) and step.isdigit():
            entry = entry[int(step)] if int(step) < len(entry) else None
        else:
            entry = entry.get(step) if isinstance(entry, dict) else None
    return entry


def _named(document: Any, mesh: Path) -> dict[str, Any] | None:
    """The part of a document that is called as a mesh, or names it; None if there is none."""
    names = {mesh.stem, mesh.name, mesh.resolve().parent.name}
    tables = [document]
    if isinstance(document, dict):
        tables += [each for each in document.values() if isinstance(each, dict | list)]
    for table in tables:
        if isinstance(table, dict):
            called = next(
                (table[name] for name in names if isinstance(table.get(name), dict)), None
            )
            if called is not None:
                return called
        members = [*table.values()] if isinstance(table, dict) else table
        for each in members[:_MAX_MEMBERS] if isinstance(members, list) else ():
            said = (
                [v for v in each.values() if isinstance(v, str)] if isinstance(each, dict) else []
            )
            if any(
                v in names or v.replace("\\", "/").rpartition("/")[2] == mesh.name for v in said
            ):
                return each
    return None


def _unreadable(file: Path, error: ValueError) -> str:
    return f"{file.name} beside it cannot be read, and is not used: {error}"


def _alarm(
    file: Path,
    key: str,
    value: Any,
    reason: str,
    name: str,
    place: str,
    suggested: float | str | None,
) -> str:
    """What is stated and not used, why, and how it is used."""
    text = f"{file.name} states {short_text(key)} {short_text(value)}, which is not used: {reason}"
    if not place:
        return text
    quoted = json.dumps(place)
    if suggested is None:
        what = "one factor to metres goes" if name == "scale" else "it goes"
        return f"{text} ({what} into objects.toml as {quoted}.{name})"
    said = json.dumps(suggested) if isinstance(suggested, str) else f"{suggested:g}"
    return f"{text} (to use it: {quoted}.{name} = {said} in objects.toml, or `{name}` for all)"
