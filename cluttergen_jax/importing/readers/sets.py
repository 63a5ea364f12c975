"""Published sets of objects, known by what their folders hold; what JSON files beside objects state.

A layout (sets.yaml) says which files are models, what is no table-top object, and what the files themselves
do not say (unit, axis, licence, label). Families (sidecars.yaml) are JSON beside an object's file that
states its scale, mass, axes, friction, names and terms. Options and settings of the user go before both. Of
a JSON of no known set it is not known whether a "scale" is a factor to metres, and of which mesh: what it
states is reported, and not used.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cache, lru_cache
from glob import escape
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

from cluttergen_jax import schema
from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.importing.readers.source import (
    AXES,
    ObjectFile,
    ReadOptions,
    label_of,
    own_up,
    says_something,
)
from cluttergen_jax.schema import convert, parse_yaml

ANY_SET = "auto"
NO_SET = "none"
_LAYOUTS = Path(__file__).with_name("sets.yaml")
_FAMILIES = Path(__file__).with_name("sidecars.yaml")
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
    document = parse_yaml(_LAYOUTS.read_bytes())
    return convert(document, dict[str, SetLayout])


def known_sets(root: Path, files: Iterable[Path], name: str = ANY_SET) -> tuple[KnownSet, ...]:
    """The sets that files belong to.

    Args:
      root: the folder that the user gave: home of a set that is named and not recognised.
      files: what lies in it, at any depth; folders above count as well.
      name: "auto", "none", or the one set that it is.

    Raises:
      ConfigError: there is no layout of that name.
    """
    if name == NO_SET:
        return ()
    if name not in (ANY_SET, *layouts()):
        allowed = ", ".join((ANY_SET, NO_SET, *layouts()))
        raise ConfigError(f"set = {name!r}", allowed, meant=closest(name, layouts()))
    real = [each.resolve() for each in files]
    tried = layouts() if name == ANY_SET else {name: layouts()[name]}
    at: dict[Path, KnownSet] = {}
    for key, each in tried.items():
        # Google's scans in SDF are folders as Gazebo's models are: the first that fits a folder is it.
        at |= {home: KnownSet(key, each, home) for home in _homes(each, real) if home not in at}
    found = tuple(at.values())
    return found or (() if name == ANY_SET else (KnownSet(name, layouts()[name], root.resolve()),))


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
    value = _at(_content(file), where.key.format(**words))
    return value.strip() if isinstance(value, str) else ""


Option = TypeVar("Option", float, str)
WORDS = ("label", "synset", "licence", "attribution")
UNIT = "unit"
_NUMBERS = ("mass", "density", "friction")
_MAX_WORD = 300
"""Letters of a label or a licence."""
_MAX_SHOWN = 60
"""Letters of a value in a message."""
_MAX_DEPTH = 4
"""So deep, and in so many values, a JSON of no known set is searched."""
_MAX_VALUES = 10_000
_NEAR = 1e-3
"""Factors of one object differ by rounding, and a direction is along an axis, within this share."""


def _number(value: Any) -> float:
    """A finite number; ValueError says what is given instead."""
    try:
        number = (
            float(value)
            if isinstance(value, int | float | str) and not isinstance(value, bool)
            else None
        )
    except (ValueError, OverflowError):
        number = None
    if number is None or not math.isfinite(number):
        raise ValueError("it is no finite number")
    return number


def positive(value: Any) -> float:
    number = _number(value)
    if number <= 0:
        raise ValueError("it is not above zero")
    return number


def scale_of(value: Any) -> tuple[float, tuple[float, float, float]]:
    """A factor, and factors along x, y and z beside it, of product 1."""
    if not isinstance(value, list):
        return positive(value), (1.0, 1.0, 1.0)
    if len(value) not in (1, 3):
        raise ValueError("one factor, or three, are asked for")
    factors = [positive(each) for each in value]
    if max(factors) <= min(factors) * (1 + _NEAR):
        return factors[0], (1.0, 1.0, 1.0)
    mean = float(np.prod(factors) ** (1 / 3))
    if not 0 < mean < math.inf:
        raise ValueError("it is no factor")
    x, y, z = (each / mean for each in factors)
    return mean, (x, y, z)


_AXIS = re.compile(r"([+-]?)([xyz])(?:[-_ ]?(?:up|axis|forward))?")


def _axis(value: Any) -> str:
    """One of `AXES`, from a name or a direction."""
    if isinstance(value, str) and (named := _AXIS.fullmatch(value.strip().lower())):
        return named[1].replace("+", "") + named[2]
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(f"it is neither one of {', '.join(AXES)} nor a direction of 3 numbers")
    vector = np.array([_number(each) for each in value])
    length = float(np.linalg.norm(vector))
    main = int(np.abs(vector).argmax())
    if not 0 < length < math.inf or abs(vector[main]) < (1 - _NEAR) * length:
        raise ValueError("it is along none of the file's axes")
    return ("-" if vector[main] < 0 else "") + "xyz"[main]


def _word(value: Any) -> str:
    text = " ".join(value.split()) if isinstance(value, str) else ""
    text = "".join(each for each in text if each.isprintable())[:_MAX_WORD]
    if not text:
        raise ValueError("it is no text")
    return text


def is_same(value: Any, plain: Any) -> bool:
    """Whether two JSON values are equal, numbers nearly."""
    if isinstance(value, list) and isinstance(plain, list):
        return len(value) == len(plain) and all(
            is_same(*pair) for pair in zip(value, plain, strict=True)
        )
    try:
        return math.isclose(_number(value), _number(plain), abs_tol=1e-9)
    except ValueError:
        return bool(value == plain)


def short_text(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    text = "".join(each if each.isprintable() else "?" for each in text)
    return text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}..."


_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")
_OF_OTHERS = frozenset(
    [
        "log",
        "down",
        "upscale",
        "texture",
        "textures",
        "normal",
        "uv",
        "gray",
        "grey",
        "color",
        "colour",
        "emission",
        "alpha",
        "opacity",
        "loss",
        "depth",
        "camera",
        "image",
        "light",
        "font",
        "time",
        "ui",
        "icon",
        "text",
        "line",
        "center",
        "centre",
        "com",
        "inertia",
        "class",
        "sample",
        "price",
        "version",
        "test",
        "random",
        "min",
        "max",
        "confidence",
        "id",
        "ids",
    ]
)
"""Words of keys whose scale, weight or unit is not that of an object."""
_UNITS = {
    "mm millimeter millimetre": 0.001,
    "cm centimeter centimetre": 0.01,
    "dm decimeter decimetre": 0.1,
    "m meter metre": 1.0,
    "in inch inche": 0.0254,
    "ft foot feet": 0.3048,
    "um micron micrometer micrometre": 1e-6,
    "km kilometer kilometre": 1000.0,
}
_LENGTHS = {name: factor for names, factor in _UNITS.items() for name in names.split()}
_LENGTH_WORDS = frozenset({"unit", "units", "meter", "meters", "metre", "metres"})
_AXIS_WORDS = frozenset({"up", "axis", "vector", "dir", "direction", "world", "orient", *"xyz"})


def physical_values(entry: Any) -> Iterator[tuple[str, str, Any, float | str | None]]:
    """Which option a value of a JSON speaks of, its key, itself, and what the option would be, if known."""
    for key, value in _leaves(entry):
        *above, words = [[each.lower() for each in _WORD.findall(step)] for step in key.split("/")]
        kinds = {
            "".join(words).removesuffix("scale"),
            *words,
            *(each for step in above for each in step),
        }
        if words and value is not None and not isinstance(value, dict) and not _OF_OTHERS & kinds:
            yield from ((name, key, value, option) for name, option in _options(words, value))


def _options(words: list[str], value: Any) -> Iterator[tuple[str, float | str | None]]:
    """The option that a key of these words speaks of, and what its value makes of it."""
    joined = "".join(words)
    kinds = set(words)
    is_factor = bool({"per", "to"} & kinds and _LENGTH_WORDS & kinds)
    if is_factor or "scales" in kinds or joined.endswith(("scale", "scaling")) or "scale" in kinds:
        unit = _length(value) if isinstance(value, str) else None
        if _is_figure(value) and not _asks_for_nothing(value):
            yield "scale", _or_none(_scale_alone, value)
        elif unit not in (None, 1.0):
            yield "scale", unit
    elif {"mass", "weight"} & kinds or joined.rstrip("kg") in ("mass", "weight"):
        if _is_figure(value):
            kilograms = _or_none(positive, value)
            yield (
                "mass",
                kilograms / 1000 if kilograms and {"g", "gram", "grams"} & kinds else kilograms,
            )
    elif "up" in kinds and kinds <= _AXIS_WORDS:
        named = next((each for each in words if each in ("x", "y", "z")), "")
        if not named:
            yield "up", _or_none(_axis, value)
        elif value is True:
            yield "up", named
    elif {"unit", "units"} & kinds and (factor := _length(value)) not in (None, 1.0):
        yield "scale", factor


def _is_figure(value: Any) -> bool:
    """Whether a value is meant as a number, or as several: NaN and "0.3 kg" are."""
    if isinstance(value, list):
        return 0 < len(value) <= 16 and all(_is_figure(each) for each in value)
    if isinstance(value, str):
        return re.match(r"\s*[-+]?(\.?\d|nan|inf)", value.lower()) is not None
    return isinstance(value, int | float) and not isinstance(value, bool)


def _scale_alone(value: Any) -> float:
    factor, stretch = scale_of(value)
    if stretch != (1.0, 1.0, 1.0):
        raise ValueError("three factors")
    return factor


def _asks_for_nothing(value: Any) -> bool:
    try:
        return scale_of(value) == (1.0, (1.0, 1.0, 1.0))
    except ValueError:
        return False


def _or_none(make: Callable[[Any], Option], value: Any) -> Option | None:
    try:
        return make(value)
    except ValueError:
        return None


def _length(value: Any) -> float | None:
    """Metres of a unit of length, by its name or as a number; None if it is none."""
    if isinstance(value, str) and (word := value.strip().lower()):
        return _LENGTHS.get(word, _LENGTHS.get(word.rstrip("s")))
    try:
        return None if isinstance(value, str) else positive(value)
    except ValueError:
        return None


def _leaves(value: Any) -> Iterator[tuple[str, Any]]:
    """Keys of a document, those inside others with / between, and their values."""
    rest = [("", value, 0)]
    count = 0
    while rest and count < _MAX_VALUES:
        above, table, depth = rest.pop()
        count += 1
        if not isinstance(table, dict):
            continue
        for key, each in list(table.items())[:_MAX_VALUES]:
            path = f"{above}{key}"
            yield path, each
            if isinstance(each, dict) and depth < _MAX_DEPTH:
                rest.append((f"{path}/", each, depth + 1))


def _unit(value: Any) -> float:
    factor = _length(value)
    if factor is None:
        raise ValueError("it is no unit of length")
    return factor


VALUES: dict[str, Callable[[Any], Any]] = {
    **dict.fromkeys(("up", "front"), _axis),
    **dict.fromkeys(_NUMBERS, positive),
    **dict.fromkeys(WORDS, _word),
    UNIT: _unit,
}
"""By name, what makes an option of a value; ValueError says why it is none. For scale see `scale_of`."""


_MAX_BYTES = 16 << 20
"""Larger files are no description of objects."""
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
    document = parse_yaml(_FAMILIES.read_bytes())
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
                    return self._statement(entry, file, family, source, place)
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
                    else _entry_of(document, source.path)
                )
                if isinstance(found, dict):
                    return found
            elif isinstance(document, dict):
                is_alone = len(family.entries) == 1 or self._num_in[source.path.parent] == 1
                if is_alone or document.get("uid") in (source.path.stem, folder):
                    return document
        return None

    def _statement(
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
            entry = _entry_of(document, source.path)
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
def _parse(path: Path, time: int, size: int) -> tuple[Any, str]:
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
    document, fault = _parse(path, about.st_mtime_ns, about.st_size)
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


def _entry_of(document: Any, mesh: Path) -> dict[str, Any] | None:
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
