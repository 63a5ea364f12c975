"""What files say, checked: records typed by classes, arrays by what they must be, bytes by a checksum.

A reader declares what it expects, and gets that or a `SchemaError`, which it turns into its own error with
the file's name and what to try. Files of older versions have no checksum; the other checks hold for them too.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import math
import os
import re
import tomllib
import zlib
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec
import numpy as np
import yaml

from cluttergen_jax.files import MOST_WORDS, fault_of_file

if TYPE_CHECKING:
    import pyarrow as pa

T = TypeVar("T")
Record = dict[str, Any]
"""JSON values by name, as a file keeps them; what a reader needs of them it has by `convert`."""
CHECKSUM = "sha256"
"""Of a record: the digest of all else in it."""
_SEAL = b"cluttergen_sha256"
_BLANK = b"0" * 64
_SEALED = re.compile(re.escape(_SEAL) + rb"..(.{64})", re.DOTALL)
"""As Parquet stores a key and its value: the value's length stands between."""
_SHOWN = 3


class SchemaError(ValueError):
    """A file does not say what its reader expects; the text says where and what."""


_MOST_DEEP = 50
"""Lists and mappings within each other."""


def parse_json(data: bytes, allow_nan: bool = False) -> Any:
    """What JSON says, each key once.

    Args:
      allow_nan: it may hold numbers that are none (NaN, Infinity) or beyond any, as others write them.

    Raises:
      SchemaError: it is none, has a key twice, is nested too deeply, or has a text or a number that is none.
    """
    parse_float = float if allow_nan else _finite
    parse_constant = float if allow_nan else _refuse_constant
    try:
        value = json.loads(
            data,
            object_pairs_hook=_unique,
            parse_float=parse_float,
            parse_constant=parse_constant,
        )
        if _ESCAPED.search(data):
            # Half a pair of UTF-16 can be written as an escape, and is no text.
            json.dumps(value, ensure_ascii=False).encode()
    except RecursionError as error:
        raise SchemaError("not JSON: nested too deeply") from error
    except ValueError as error:
        raise SchemaError(f"not JSON: {error}") from error
    _check_depth(value)
    return value


_ESCAPED = re.compile(rb"\\u[dD]")


_LONGEST_KEY = 60


def _unique(pairs: list[tuple[str, Any]]) -> Record:
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = Counter(key for key, _ in pairs)
        raise ValueError(f"the key {keys.most_common(1)[0][0][:_LONGEST_KEY]!r} comes twice")
    return found


def _finite(text: str) -> float:
    number = float(text)
    return number if math.isfinite(number) else _refuse_constant(text)


def _refuse_constant(text: str) -> float:
    raise ValueError(f"{text} is no number of JSON")


def read_json(path: str | os.PathLike[str], allow_nan: bool = False, most: int = MOST_WORDS) -> Any:
    """What a JSON file of other people says, packed (.gz) or not; see `parse_json`.

    Args:
      most: bytes that it may have, packed and unpacked.

    Raises:
      SchemaError: it is no regular file, too large, damaged or no JSON; the text does not name it.
      OSError: it cannot be opened.
    """
    data = read_written(path, most)
    if str(path).endswith(".gz"):
        data = _unpack(data, most)
    return parse_json(data, allow_nan)


def _unpack(data: bytes, most: int) -> bytes:
    try:
        with gzip.open(io.BytesIO(data)) as file:
            found = file.read(most + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise SchemaError("it is damaged") from error
    if len(found) > most:
        raise SchemaError(f"it unpacks to more than {most >> 20} MB")
    return found


def _check_depth(value: Any) -> None:
    level = [value]
    depth = 0
    while level:
        depth += 1
        if depth > _MOST_DEEP:
            raise SchemaError(f"lists and mappings within each other, more than {_MOST_DEEP} deep")
        level = [
            inner
            for each in level
            if isinstance(each, dict | list)
            for inner in (each.values() if isinstance(each, dict) else each)
        ]


def parse_toml(text: str) -> Record:
    """What TOML says; the language itself allows no key twice.

    Raises:
      SchemaError: it is none, or is nested too deeply.
    """
    try:
        value = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise SchemaError(f"not TOML: {error or 'nested too deeply'}") from error
    _check_depth(value)
    return value


def parse_yaml(data: bytes) -> Any:
    """What YAML says: one document whose keys are texts, each once, in UTF-8.

    Raises:
      SchemaError: it is none, has a key twice or one that is no text, is nested too deeply, or
        grows without bound by what it repeats.
    """
    try:
        return yaml.load(data.decode("utf-8-sig"), _YamlLoader)
    except (
        yaml.YAMLError,
        ValueError,
        TypeError,
        LookupError,
        AttributeError,
        ArithmeticError,
    ) as error:
        said = " ".join(str(error).replace('in "<unicode string>", ', "at ").split())
        raise SchemaError(f"not YAML: {said}") from error
    except RecursionError as error:
        raise SchemaError("not YAML: nested too deeply") from error


class _YamlLoader(yaml.SafeLoader):
    """The safe loader, with the checks of `parse_yaml`."""

    _MOST_ALIASES = 100
    _MOST_MERGED = 10_000

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = self._num_aliases = 0
        self._open: list[str] = []

    def compose_node(self, parent: Any, index: Any) -> Any:
        """One node, at most so deep; what repeats another may not be part of it."""
        event = self.peek_event()
        if self.check_event(yaml.AliasEvent):
            self._num_aliases += 1
            if event.anchor in self._open or self._num_aliases > self._MOST_ALIASES:
                is_own = event.anchor in self._open
                fault = (
                    "repeats what it is part of"
                    if is_own
                    else f"is one of over {self._MOST_ALIASES}"
                )
                raise yaml.MarkedYAMLError(
                    problem=f"*{event.anchor} {fault}", problem_mark=event.start_mark
                )
            return super().compose_node(parent, index)
        self._depth += 1
        if self._depth > _MOST_DEEP:
            fault = f"lists and mappings within each other, more than {_MOST_DEEP} deep"
            raise yaml.MarkedYAMLError(problem=fault, problem_mark=event.start_mark)
        self._open.append(event.anchor or "")
        node = super().compose_node(parent, index)
        self._open.pop()
        self._depth -= 1
        return node

    def compose_mapping_node(self, anchor: Any) -> Any:
        """One mapping, whose keys are texts, each once."""
        node = super().compose_mapping_node(anchor)
        seen: set[str] = set()
        for key, _ in node.value:
            is_text = isinstance(key, yaml.ScalarNode) and key.tag.rpartition(":")[2] in (
                "str",
                "merge",
            )
            if not is_text or key.value in seen:
                shown = (
                    repr(key.value) if isinstance(key, yaml.ScalarNode) else "a list or a mapping"
                )
                fault = "comes twice" if is_text else "is no text as a key (quotes make it one)"
                raise yaml.MarkedYAMLError(problem=f"{shown} {fault}", problem_mark=key.start_mark)
            seen.add(key.value)
        return node

    def flatten_mapping(self, node: Any) -> None:
        """Puts in what `<<` repeats, up to a limit."""
        super().flatten_mapping(node)
        if len(node.value) > self._MOST_MERGED:
            raise yaml.MarkedYAMLError(
                problem=f"more than {self._MOST_MERGED:,} keys by <<", problem_mark=node.start_mark
            )


def read_written(path: str | os.PathLike[str], most: int = MOST_WORDS) -> bytes:
    """The bytes of a file that people write, `most` of them.

    Raises:
      SchemaError: it is no regular file, or too large; the text does not name it.
      OSError: it cannot be opened.
    """
    if fault := fault_of_file(path, most):
        raise SchemaError(fault)
    with open(path, "rb") as file:
        return file.read()


def convert(value: Any, kind: type[T]) -> T:
    """A value of JSON as a class that declares its fields: a `msgspec.Struct` or a data class.

    Fields that the class does not name are passed over; nothing is converted but whole numbers to floats.

    Raises:
      SchemaError: a field is missing, of another type or out of its range; the text names it.
    """
    try:
        return msgspec.convert(value, kind)
    except (msgspec.ValidationError, RecursionError) as error:
        raise SchemaError(str(error)) from error


_CONTROL = re.compile(r"\x7f|(?<!\\)(?:\\\\)*\\u00(?:[01]|7f|[89])")
"""As `json.dumps` writes control characters other than the ends of lines and tabs."""


def refuse_control_characters(record: Any) -> None:
    """Refuses a value of JSON with texts that a terminal obeys instead of showing them (SchemaError)."""
    if _CONTROL.search(json.dumps(record)):
        raise SchemaError("a text in it has control characters")


def digest_of(data: bytes) -> str:
    """Hex digest of bytes."""
    return hashlib.sha256(data).hexdigest()


def with_checksum(record: Mapping[str, Any], allow_nan: bool = False) -> Record:
    """A record of JSON values with its checksum."""
    plain = json.loads(json.dumps(record, allow_nan=allow_nan))
    return {**plain, CHECKSUM: _digest(plain)}


def record_bytes(record: Mapping[str, Any], allow_nan: bool = False) -> bytes:
    """The file of a record, with its checksum; `checked_record` reads it."""
    return (json.dumps(with_checksum(record, allow_nan), indent=1) + "\n").encode()


def checked_record(data: bytes, allow_nan: bool = False) -> Record:
    """The record in a file, without its checksum.

    Args:
      allow_nan: it may hold figures that are none, as measures of nothing.

    Raises:
      SchemaError: it is no record, or not the one whose checksum it has.
    """
    record = parse_json(data, allow_nan)
    if not isinstance(record, dict):
        raise SchemaError(f"not a record but {type(record).__name__}")
    if CHECKSUM in record and record.pop(CHECKSUM) != _digest(record):
        raise SchemaError(
            f"it does not match its checksum (its entry {CHECKSUM!r}; without one it is read)"
        )
    refuse_control_characters(record)
    return record


def _digest(record: Mapping[str, Any]) -> str:
    return digest_of(json.dumps(record, sort_keys=True, separators=(",", ":")).encode())


def sealed_parquet(table: pa.Table, **options: Any) -> bytes:
    """A Parquet file with checksums of its pages, and one of all of it among its metadata.

    Args:
      options: more of `pyarrow.parquet.ParquetWriter`.
    """
    from pyarrow.parquet import ParquetWriter

    buffer = io.BytesIO()
    with ParquetWriter(buffer, table.schema, write_page_checksum=True, **options) as writer:
        writer.write_table(table)
        writer.add_key_value_metadata({_SEAL.decode(): _BLANK.decode()})
    data = buffer.getvalue()
    found = _SEALED.search(data)
    assert found is not None, "a file without a place for its checksum"
    start = found.start(1)
    return data[:start] + digest_of(data).encode() + data[start + len(_BLANK) :]


def read_sealed_parquet(data: bytes, schema: pa.Schema | None = None) -> pa.Table:
    """The table of a file of `sealed_parquet`; files without a checksum are read, too.

    Args:
      schema: that it must have.

    Raises:
      SchemaError: it is not the file whose checksum it has.
      pyarrow.ArrowException, OSError: it is no Parquet file, or a damaged one.
    """
    from pyarrow import BufferReader
    from pyarrow.parquet import read_table

    found = _SEALED.search(data)
    if found is not None:
        start, end = found.span(1)
        if digest_of(data[:start] + _BLANK + data[end:]).encode() != found[1]:
            raise SchemaError("its content does not match its checksum")
    table = read_table(
        BufferReader(data), schema=schema, page_checksum_verification=True, partitioning=None
    )
    table.validate(full=True)
    return table


@dataclass(frozen=True)
class Numbers:
    """What an array must be.

    Attributes:
      dtype: its type, "f4" and so on; shape: its lengths, None for any; a name stands for the same length
        wherever it occurs.
      low, high: the range of its numbers, which are finite in any case.
    """

    dtype: str
    shape: tuple[int | str | None, ...]
    low: float = -math.inf
    high: float = math.inf

    def fault(self, value: Any, lengths: dict[str, int]) -> str:
        """What is wrong with an array, in words; "" if it is sound. Named lengths are added to `lengths`."""
        if not isinstance(value, np.ndarray) or value.dtype != np.dtype(self.dtype):
            return f"is of type {getattr(value, 'dtype', type(value).__name__)}, not {np.dtype(self.dtype)}"
        asked = [lengths.get(each) if isinstance(each, str) else each for each in self.shape]
        if value.ndim != len(asked) or any(
            each not in (None, n) for each, n in zip(asked, value.shape, strict=True)
        ):
            wanted = ", ".join("any" if each is None else str(each) for each in asked)
            return f"is of shape {value.shape}, not ({wanted})"
        lengths |= {
            each: n
            for each, n in zip(self.shape, value.shape, strict=True)
            if isinstance(each, str)
        }
        if value.dtype.kind == "f" and not np.isfinite(value).all():
            return "holds numbers that are not finite"
        if value.size and not (self.low <= value.min() and value.max() <= self.high):
            span = f"{value.min():g} to {value.max():g}"
            asked_span = f"{self.low:g} to {self.high:g}"
            return f"holds numbers from {span}, not within {asked_span}"
        return ""


def check_numbers(arrays: Mapping[str, Any], asked: Mapping[str, Numbers]) -> None:
    """Refuses arrays that are not what was asked for.

    Raises:
      SchemaError: one is missing, unknown, of another type or shape, or holds a number that is not finite or
        out of its range; the text names it.
    """
    lengths: dict[str, int] = {}
    faults = [f"{name!r} is missing" for name in asked if name not in arrays]
    faults += [f"{name!r} is unknown" for name in arrays if name not in asked]
    known = [name for name in asked if name in arrays]
    faults += [
        f"{name!r} {fault}" for name in known if (fault := asked[name].fault(arrays[name], lengths))
    ]
    refuse(faults)


def refuse(faults: list[str]) -> None:
    """Raises a SchemaError of faults, if there are any: the first few of them."""
    if faults:
        more = f"; and {len(faults) - _SHOWN} more" if len(faults) > _SHOWN else ""
        raise SchemaError("; ".join(faults[:_SHOWN]) + more)
