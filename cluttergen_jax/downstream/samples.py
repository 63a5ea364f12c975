"""Data sets on disk: splits of rows in blocks of Parquet files, and a record of how each split was made.

    KIND.json               how each split was made, digests of its assets
    assets/                 the objects and the support, as a bank has them
    train-000000.parquet    block 0 of a split, a row for each of its first samples

A block is written as a whole or not at all. Record and blocks carry checksums (`schema`).
"""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from cluttergen_jax.errors import BankError, ConfigError, closest
from cluttergen_jax.files import folder_whole, is_partial, write_atomically, writing
from cluttergen_jax.scene.bank.bank import Bank
from cluttergen_jax.scene.bank.lock import LOCK
from cluttergen_jax.schema import (
    SEAL,
    SchemaError,
    check_seal,
    checked_record,
    typed,
    with_checksum,
    with_seal,
)

FORMAT = 1
SPLITS = {"train": 0, "val": 1_000_000, "test": 2_000_000}
"""The first seed of each split, of its banks and of all else that is drawn for it: nothing is drawn twice."""


@dataclass(frozen=True)
class SampleFormat:
    """A kind of data set.

    Attributes:
      kind: its plural, "views" or "pairs"; column: that numbers the rows of a split.
      command: that makes it, for messages.
      schema: of its rows; block_size: rows of a block.
      record: the class of its record (`schema.typed`).
      check_rows: raises a SchemaError where the rows of a block are none.
    """

    kind: str
    column: str
    command: str
    schema: pa.Schema
    block_size: int
    record: type
    check_rows: Callable[[pa.Table], None]

    @property
    def index(self) -> str:
        """The file's name of the record."""
        return f"{self.kind}.json"

    @property
    def again(self) -> str:
        """What mends a damaged folder."""
        return f"the same `cluttergen {self.command}` again, which makes what is missing"

    @property
    def number(self) -> str:
        """The record's name for how many rows a split has."""
        return f"num_{self.kind}"

    def check_place(self, path: Path) -> None:
        """Refuses a folder that holds something else.

        Raises:
          BankError: it does.
        """
        if not path.exists() or (path / self.index).exists():
            return
        begun = (LOCK, "assets")
        banks = tuple(f"bank-{split}" for split in SPLITS)
        with writing(path):
            names = [each.name for each in path.iterdir()] if path.is_dir() else [""]
        if any(name not in begun and not name.startswith(banks) and not is_partial(name) for name in names):
            raise BankError(
                f"{path} exists and holds no {self.kind}", "a new or empty folder", "another `out`"
            )

    def read_record(self, path: Path) -> dict[str, Any]:
        """The record of a folder.

        Raises:
          BankError: there is none, or it is damaged.
        """
        file = path / self.index
        try:
            data = file.read_bytes()
        except (FileNotFoundError, NotADirectoryError) as error:
            raise BankError(
                f"{path} holds no {self.kind}: it has no {self.index}",
                f"a folder that `cluttergen {self.command}` made",
            ) from error
        except OSError as error:
            raise BankError(f"{file} cannot be read ({error})", hint=self.again) from error
        try:
            record = checked_record(data)
            if (record.get("kind"), record.get("format")) != (self.kind, FORMAT):
                raise SchemaError(f"not the record of {self.kind} of format {FORMAT}")
            typed(record, self.record)
        except SchemaError as error:
            hint = f"a fresh copy of the folder, or `cluttergen {self.command}` into another"
            raise BankError(f"{file} cannot be read ({error})", hint=hint) from error
        return record

    def write_record(self, path: Path, record: dict[str, Any]) -> None:
        """Stores it."""
        text = json.dumps(with_checksum(record), indent=1) + "\n"
        write_atomically(path / self.index, text.encode(), is_durable=True)

    def split(self, path: Path, record: dict[str, Any], name: str) -> dict[str, Any]:
        """How a split was made.

        Raises:
          ConfigError: there is none of that name, or it holds nothing.
        """
        if name not in SPLITS:
            raise ConfigError(f"split = {name!r}", ", ".join(SPLITS), meant=closest(name, SPLITS))
        if name not in record["splits"]:
            raise ConfigError(
                f"{path} holds no {self.kind} of the split {name!r}",
                f"{', '.join(record['splits']) or 'none'} in that folder",
                f"cluttergen {self.command} --split {name} --out {path}",
            )
        return record["splits"][name]

    def with_split(
        self,
        path: Path,
        shared: dict[str, Any],
        split: str,
        made: dict[str, Any],
        number: int,
        overwrite: bool = False,
    ) -> dict[str, Any]:
        """The folder's record with a split in it, begun or continued; blocks of another go if asked.

        Args:
          shared: what all splits of a folder have in common; made: how this one is made.

        Raises:
          BankError: the folder holds something else, or that split made otherwise.
        """
        made = json.loads(json.dumps(made))
        record: dict[str, Any] = {"format": FORMAT, "kind": self.kind, **shared, "splits": {}}
        if (path / self.index).exists():
            record = self.read_record(path)
        if any(record.get(name) != value for name, value in shared.items()):
            raise BankError(
                f"{path} holds {self.kind} of other objects or of another support",
                "one set of objects and one support in a folder",
                "another `out`",
            )
        known = record["splits"].get(split)
        if known is not None and overwrite:
            known = None
            for file in path.glob(f"{split}-*.parquet"):
                file.unlink()
        if known is not None:
            changed = sorted(name for name in made if known.get(name) != made[name])
            if changed:
                raise BankError(
                    f"{path} holds {self.kind} of {split!r} made with another {', '.join(changed)}",
                    "the same settings and the same scenes, which continue it",
                    "another `out`, or `overwrite` to begin that split anew",
                )
            number = max(number, known[self.number])
        record["splits"][split] = {self.number: number, **made}
        return record

    # Blocks

    def block_path(self, path: Path, split: str, block: int) -> Path:
        """Where a block of a split is stored."""
        return path / f"{split}-{block:06d}.parquet"

    def sizes(self, number: int) -> dict[int, int]:
        """Rows of each block of so many in all."""
        size = self.block_size
        return {block: min(size, number - block * size) for block in range(-(-number // size))}

    def is_kept(self, path: Path, split: str, block: int, num_rows: int) -> bool:
        """Whether a block is there, sound, and holds so many rows."""
        try:
            self.read_block(path, split, block, num_rows)
        except BankError:
            return False
        return True

    def read_block(self, path: Path, split: str, block: int, num_rows: int) -> pa.Table:
        """The first rows of a block.

        Raises:
          BankError: it is missing, damaged or shorter, or a number in it is none.
        """
        file = self.block_path(path, split, block)
        try:
            data = file.read_bytes()
            check_seal(data)
            table = pq.read_table(
                pa.BufferReader(data), schema=self.schema, page_checksum_verification=True, partitioning=None
            )
            table.validate(full=True)
            first = block * self.block_size
            numbers = np.arange(first, first + table.num_rows)
            if table.num_rows < num_rows or not np.array_equal(table[self.column], numbers):
                raise SchemaError(f"{table.num_rows} rows where {num_rows} belong, or others")
            table = table.slice(0, num_rows)
            self.check_rows(table)
        except FileNotFoundError as error:
            raise BankError(f"{file} is missing or damaged", hint=self.again) from error
        except (pa.ArrowException, OSError, ValueError) as error:
            raise BankError(f"{file} is missing or damaged ({error})", hint=self.again) from error
        return table

    def write_block(self, path: Path, split: str, block: int, table: pa.Table) -> None:
        """Stores a block."""
        buffer = io.BytesIO()
        with pq.ParquetWriter(buffer, table.schema, compression="zstd", write_page_checksum=True) as writer:
            writer.write_table(table)
            writer.add_key_value_metadata(SEAL)
        write_atomically(self.block_path(path, split, block), with_seal(buffer.getvalue()), is_durable=True)

    def tables(self, path: Path, split: str, number: int) -> Iterator[pa.Table]:
        """The first rows of a split, block by block.

        Raises:
          BankError: a block is missing or damaged.
        """
        for block, rows in self.sizes(number).items():
            yield self.read_block(path, split, block, rows)


def store_assets(path: Path, bank: Bank) -> None:
    """A bank's own copies of the objects and the support, once."""
    if not (path / "assets").is_dir():
        with folder_whole(path / "assets", is_only_writer=True) as fresh:
            shutil.copytree(bank.path / "assets", fresh)


def numbers_of(table: pa.Table, name: str, *lengths: int) -> np.ndarray:
    """A column, of numbers or texts, as an array; lists of lists are flattened down to `lengths`.

    Args:
      lengths: of the inner axes, of which the first may be -1.

    Raises:
      SchemaError: a value is missing.
    """
    values = table[name].combine_chunks()
    while True:
        if values.null_count:
            raise SchemaError(f"{name!r} lacks a value")
        if not (pa.types.is_list(values.type) or pa.types.is_fixed_size_list(values.type)):
            break
        values = values.flatten()
    return values.to_numpy(zero_copy_only=False).reshape(-1, *lengths)


def lengths_of(table: pa.Table, name: str) -> np.ndarray:
    """i64[R]: how many entries, or bytes, each row of a column has; -1 where there is none."""
    column = table[name].combine_chunks()
    is_list = pa.types.is_list(column.type)
    found = (pa.compute.list_value_length if is_list else pa.compute.binary_length)(column)
    return found.cast(pa.int64()).fill_null(-1).to_numpy()


def labels_fault(table: pa.Table, name: str, most: np.ndarray) -> str:
    """What is wrong with images of labels u8, of which each row allows up to `most`, i[R]; "" if nothing."""
    for image, allowed in zip(table[name], most.tolist(), strict=True):
        if np.frombuffer(image.as_buffer(), np.uint8).max(initial=0) > allowed:
            return f"{name!r} holds a label beyond {allowed}"
    return ""
