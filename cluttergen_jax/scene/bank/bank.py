"""A bank on disk: `bank.json`, `scenes-*.parquet`, `assets/`, and a file per scene if wanted.

    bank.json               how it was made; what makes another run the same bank; digests of its files
    scenes-000000.parquet   block 0: scenes 0 to 255, a row each, failures included; and bank.json once more
    assets/objects/NAME/    each object once; assets/support/ the table
    assets/textures/        the objects' images, each once
    scenes/000000.xml .png  successful scenes as MJCF, meshes by relative path, and their pictures

A block is written as a whole or not at all, so an interrupted bank is continued where it stopped
(`scene.bank.writer`). Whatever is damaged is named when it is read, with what mends it.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import NAME_PATTERN, object_hash, read_object
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.assets.support_file import read_support, support_hash
from cluttergen_jax.errors import BankError, PoolError
from cluttergen_jax.files import inside
from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.scene.bank.table import (
    CERTIFICATE,
    CLUTTER,
    SCHEMA,
    BankRow,
    is_certified,
    rows_of,
    with_added,
)

FORMAT = 1
INDEX = "bank.json"
_BLOCK = re.compile(r"scenes-(\d{6,9})\.parquet")
_SLOT = re.compile(rf"{NAME_PATTERN.pattern}(#\d+)?")
_AGAIN = "the same `cluttergen generate` again, which mends what is damaged and makes what is missing"
_METADATA = b"cluttergen"
_OF_THE_INDEX = ("num_scenes", "files")
"""What `bank.json` alone holds: it changes while blocks stay as they are."""


@dataclass(frozen=True, eq=False)
class Bank:
    """A bank that is read. `record` is what `bank.json` holds."""

    path: Path
    record: dict[str, Any]

    @property
    def num_scenes(self) -> int:
        """How many scenes the bank was asked for."""
        return int(self.record["num_scenes"])

    @cached_property
    def table(self) -> pa.Table:
        """All rows that are there, in order; with their certificate, if all have it.

        Raises:
          BankError: there are none, or a block is damaged; the message names its file.
        """
        blocks = block_numbers(self.path)
        if not blocks:
            raise BankError(f"{self.path} holds no scenes yet", hint=_AGAIN)
        rows = [read_block(self.path, block) for block in blocks]
        names = [*SCHEMA.names, *CLUTTER.names, *(CERTIFICATE.names if all(map(is_certified, rows)) else [])]
        return pa.concat_tables([each.select(names).replace_schema_metadata(None) for each in rows])

    @property
    def files(self) -> dict[str, str] | None:
        """Digests of assets and scene files by path within the bank (`bank.digests`); None in older banks."""
        return self.record.get("files")

    def scenes(self) -> Iterator[BankRow]:
        """Every scene, failures included."""
        return rows_of(self.table)

    def object(self, name: str) -> ObjectAsset:
        """The asset called `name`, from the bank's own copy.

        Raises:
          BankError: its files are missing or damaged, or it is not the one that the scenes were made with.
          UnsafePathError: the name is none, or a file is a link that leads out of the bank.
        """
        with _mended_by_generate():
            images = inside(self.path, "assets/textures")
            asset = read_object(inside(self.path, f"assets/objects/{name}"), images)
        if asset.name != name:
            raise BankError(f"{self.path}: asset {name!r} calls itself {asset.name!r}", hint=_AGAIN)
        self._check_asset(name, object_hash(asset), self._hashes["objects"].get(name))
        return asset

    @cached_property
    def support(self) -> SupportAsset:
        """The table, from the bank's own copy; raises as `object` does."""
        with _mended_by_generate():
            support = read_support(inside(self.path, "assets/support"))
        self._check_asset("support", support_hash(support), self._hashes["support"])
        return support

    @property
    def _hashes(self) -> dict[str, Any]:
        return self.record.get("assets", {"objects": {}, "support": None})

    def _check_asset(self, name: str, digest: str, wanted: str | None) -> None:
        if wanted is not None and digest != wanted:
            raise BankError(
                f"{self.path}: asset {name!r} is not the one that the scenes were made with", hint=_AGAIN
            )


@contextmanager
def _mended_by_generate() -> Iterator[None]:
    """Errors of the bank's own copy of an asset, with the hint that `generate` repairs it."""
    try:
        yield
    except PoolError as error:
        raise BankError(error.given, error.allowed, _AGAIN) from error


def block_path(path: Path, block: int) -> Path:
    """Where block number `block` is stored."""
    return path / f"scenes-{block:06d}.parquet"


def block_numbers(path: Path) -> list[int]:
    """The blocks that a bank's folder holds, in order."""
    names = [_BLOCK.fullmatch(each.name) for each in path.iterdir()] if path.is_dir() else []
    return sorted(int(name[1]) for name in names if name)


def read_block(path: Path, block: int) -> pa.Table:
    """The rows of one block of the bank at `path`, every value looked at.

    Raises:
      BankError: the file cannot be read, is damaged, or does not hold what its name says.
    """
    file = block_path(path, block)
    try:
        table = with_added(pq.read_table(file, page_checksum_verification=True))
        table.validate(full=True)
        _check_rows(table, block)
    except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
        raise BankError(f"{file} is damaged ({error})", hint=_AGAIN) from error
    return table


def _check_rows(table: pa.Table, block: int) -> None:
    """ValueError if these are not the rows of block number `block`."""
    for field in SCHEMA:
        if field.name not in table.schema.names or table.schema.field(field.name).type != field.type:
            raise ValueError(f"its column {field.name!r} is missing or of another type")
        if table[field.name].null_count:
            raise ValueError(f"its column {field.name!r} has gaps")
    for field in CLUTTER:
        if table.schema.field(field.name).type != field.type:
            raise ValueError(f"its column {field.name!r} is of another type")
    first = block * BLOCK_SIZE
    if table["index"].to_pylist() != list(range(first, first + table.num_rows)):
        raise ValueError(f"its scenes are not those from {first} on")
    lists = [table[field.name].combine_chunks() for field in SCHEMA if pa.types.is_list(field.type)]
    lengths = [pc.list_value_length(each).to_pylist() for each in lists]
    if any(each != lengths[0] for each in lengths) or any(pc.list_flatten(each).null_count for each in lists):
        raise ValueError("its lists of objects are of different lengths, or have gaps")
    names = pc.unique(pc.list_flatten(table["objects"])).to_pylist()
    if strange := [name for name in names if not _SLOT.fullmatch(name)]:
        raise ValueError(f"it names an object {strange[0]!r}")
    # Poses are lists in lists: slots, and seven numbers each.
    poses = np.array(pc.list_flatten(pc.list_flatten(table["poses"]))).reshape(-1, 7)
    if not np.isfinite(poses[np.array(pc.list_flatten(table["is_placed"]))]).all():
        raise ValueError("an object that was placed has a pose that is not finite")


def read_bank(path: str | Path) -> Bank:
    """Opens a bank.

    Raises:
      BankError: there is none, or `bank.json` is damaged or of another format.
    """
    index = Path(path) / INDEX
    try:
        record = json.loads(index.read_bytes())
    except (FileNotFoundError, NotADirectoryError) as error:
        raise BankError(
            f"{path} is not a bank: it has no {INDEX}", "a folder that `generate` made"
        ) from error
    except (OSError, ValueError, RecursionError) as error:
        raise BankError(f"{index} cannot be read ({error})", hint=_AGAIN) from error
    if not isinstance(record, dict) or record.get("format") != FORMAT:
        raise BankError(f"{index} is not the record of a bank of format {FORMAT}", hint=_AGAIN)
    digest = record.pop("hash", None)
    wrong = _wrong_part(record) if digest in (None, _digest(record)) else "it does not match its own digest"
    if wrong is not None:
        raise BankError(f"{index} is damaged: {wrong}", hint=_AGAIN)
    return Bank(Path(path), record)


def index_bytes(record: dict[str, Any]) -> bytes:
    """The content of `bank.json`: the record, and its digest, so that damage is noticed."""
    return (json.dumps({**record, "hash": _digest(record)}, indent=1) + "\n").encode()


def _digest(record: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


def with_record(table: pa.Table, record: dict[str, Any]) -> pa.Table:
    """The rows of a block with the bank's record in them, so that any block can stand in for `bank.json`."""
    kept = {name: value for name, value in record.items() if name not in _OF_THE_INDEX}
    return table.replace_schema_metadata({_METADATA: json.dumps(kept).encode()})


def recovered_record(path: Path) -> dict[str, Any] | None:
    """The bank's record as its first sound block has it, without `num_scenes`; None if no block has it."""
    for block in block_numbers(path):
        try:
            record = json.loads((read_block(path, block).schema.metadata or {})[_METADATA])
        except (BankError, KeyError, ValueError, RecursionError):
            continue
        if isinstance(record, dict) and _wrong_part(record | {"num_scenes": 1}) is None:
            return record
    return None


def _wrong_part(record: dict[str, Any]) -> str | None:
    """What is wrong with the record of a bank, in words; None if it is sound."""
    number = record.get("num_scenes")
    if isinstance(number, bool) or not isinstance(number, int) or number < 1:
        return f"num_scenes is {number!r}"
    if not isinstance(record.get("recipe"), dict):
        return "it has no recipe"
    assets = record.get("assets", {"objects": {}, "support": None})
    if not isinstance(assets, dict) or not isinstance(assets.get("objects"), dict) or "support" not in assets:
        return "its digests of assets are not understood"
    if strange := [name for name in assets["objects"] if not NAME_PATTERN.fullmatch(name)]:
        return f"it names an object {strange[0]!r}"
    files = record.get("files", {})
    if not isinstance(files, dict) or not all(isinstance(digest, str) for digest in files.values()):
        return "its digests of files are not understood"
    return None
