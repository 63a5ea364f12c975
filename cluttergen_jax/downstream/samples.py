"""Samples on disk: splits of rows in blocks of Parquet files, and a record of how each split was made.

    KIND.json               how each split was made, digests of its assets
    assets/                 the objects and the support, as a bank has them
    train-000000.parquet    block 0 of a split, a row for each of its first samples

A block is written as a whole or not at all. Record and blocks carry checksums (`schema`).
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import pyarrow as pa

from cluttergen_jax.errors import BankError, ConfigError, closest, range_text
from cluttergen_jax.files import folder_whole, remove_partial, write_atomically, writing
from cluttergen_jax.kept_folder import check_recipe
from cluttergen_jax.scene import Bank
from cluttergen_jax.schema import (
    Numbers,
    SchemaError,
    check_numbers,
    convert,
    read_sealed_parquet,
    sealed_parquet,
)
from cluttergen_jax.stores import BlockStore

MOST_PIXELS = 4096
"""Of an image's side."""
FAR = 100.0
"""Metres beyond which nothing of a table's scene is."""
_UNIT = 1e-3
"""By which the length of a quaternion may differ from 1."""


def read_columns(table: pa.Table, numbers: Mapping[str, Numbers]) -> dict[str, np.ndarray]:
    """Columns of a block as arrays (`numbers_of`).

    Raises:
      SchemaError: a number is missing, not finite or out of its range.
    """
    found = {name: numbers_of(table, name) for name in numbers}
    check_numbers(found, numbers)
    return found


def numbers_of(table: pa.Table, name: str) -> np.ndarray:
    """A column of numbers or texts as an array; lists are flattened, a fixed size is that of the last axis.

    Raises:
      SchemaError: a value is missing.
    """
    values = table[name].combine_chunks()
    last = list[int]()
    while True:
        if values.null_count:
            raise SchemaError(f"{name!r} lacks a value")
        if pa.types.is_fixed_size_list(values.type):
            last = [values.type.list_size]
        elif not pa.types.is_list(values.type):
            break
        values = values.flatten()
    return values.to_numpy(zero_copy_only=False).reshape(-1, *last)


def lengths_of(table: pa.Table, name: str) -> np.ndarray:
    """i64[R]: how many entries, or bytes, each row of a column has; -1 where there is none."""
    column = table[name].combine_chunks()
    is_list = pa.types.is_list(column.type)
    found = (pa.compute.list_value_length if is_list else pa.compute.binary_length)(column)
    return found.cast(pa.int64()).fill_null(-1).to_numpy()


def faults_of(table: pa.Table, lengths: Mapping[str, np.ndarray], *poses: np.ndarray) -> list[str]:
    """What is wrong with lengths i[R] of columns, and with quaternions of poses f[..., 7]."""
    faults = [
        f"{name!r} is not as long as it should be"
        for name, length in lengths.items()
        if not np.array_equal(lengths_of(table, name), length)
    ]
    turns = np.concatenate([np.linalg.norm(each[:, 3:], axis=1) for each in poses])
    return faults + ["a quaternion is not of length 1"] * bool(
        np.abs(turns - 1).max(initial=0) > _UNIT
    )


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
    def store(self) -> BlockStore:
        """Folders of this kind, in which banks that are made along may lie already."""
        begun = ("assets", *(f"bank-{split}" for split in SPLITS))
        return BlockStore(self.kind, f"{self.kind}.json", self.kind, self.command, begun)

    @property
    def again(self) -> str:
        """What mends a damaged folder."""
        return f"the same `{self.command}` again, which makes what is missing"

    @property
    def number(self) -> str:
        """The record's name for how many rows a split has."""
        return f"num_{self.kind}"

    def read_record(self, path: Path) -> dict[str, Any]:
        """The record of a folder. Raises BankError: there is none, or it is damaged."""
        record = self.store.read_record(path)
        try:
            convert(record, self.record)
        except SchemaError as error:
            raise BankError(
                f"{path / self.store.index} cannot be read ({error})", hint=self.again
            ) from error
        return record

    def with_split(
        self,
        path: Path,
        shared: Mapping[str, object],
        split: str,
        made: Mapping[str, object],
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
        record: dict[str, Any] = {**shared, "splits": {}}
        if (path / self.store.index).exists():
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
            theirs = {name: known.get(name) for name in made}
            hint = "another `out`, or `overwrite` to begin that split anew"
            check_recipe(path, f"{self.kind} of {split!r} made", made, theirs, hint)
            number = max(number, known[self.number])
        record["splits"][split] = {self.number: number, **made}
        return record

    def write(
        self,
        path: Path,
        bank: Bank,
        shared: Mapping[str, object],
        split: str,
        made: Mapping[str, object],
        number: int,
        overwrite: bool,
        fill: Callable[[dict[str, Any], dict[int, int]], None],
    ) -> dict[str, Any]:
        """Begins or continues a split, one writer at a time; the folder's record.

        Args:
          bank: whose objects and support are stored, once.
          shared, made, number, overwrite: see `with_split`.
          fill: given the record, makes the blocks that are missing, damaged or shorter, of so many rows.

        Raises:
          BankError: see `hold` and `with_split`, or another process writes there.
        """
        with self.store.hold(path), writing(path):
            remove_partial(path)
            record = self.with_split(path, shared, split, made, number, overwrite)
            if not (path / "assets").is_dir():
                with folder_whole(path / "assets", is_only_writer=True) as fresh:
                    shutil.copytree(bank.path / "assets", fresh)
            self.store.write_record(path, record)
            # More than were asked for, where an earlier call that was interrupted asked for more.
            sizes = self.sizes(record["splits"][split][self.number])
            kept = {
                block for block, rows in sizes.items() if self.is_kept(path, split, block, rows)
            }
            fill(record, {block: rows for block, rows in sizes.items() if block not in kept})
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
            table = read_sealed_parquet(file.read_bytes(), self.schema)
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
        file = self.block_path(path, split, block)
        write_atomically(file, sealed_parquet(table, compression="zstd"), is_durable=True)


@dataclass(frozen=True, eq=False)
class SampleSet:
    """A folder of samples that is read. `record` is what its JSON file holds."""

    path: Path
    record: dict[str, Any]
    form: ClassVar[SampleFormat]

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Opens a folder. Raises BankError: it holds no samples of this kind, or is damaged."""
        return cls(Path(path), cls.form.read_record(Path(path)))

    @property
    def splits(self) -> tuple[str, ...]:
        """Those that it holds."""
        return tuple(self.record["splits"])

    def split(self, name: str) -> dict[str, Any]:
        """How a split was made. Raises ConfigError: there is none of that name, or it holds nothing."""
        form = self.form
        splits = self.record["splits"]
        if name not in SPLITS:
            raise ConfigError(f"split = {name!r}", ", ".join(SPLITS), meant=closest(name, SPLITS))
        if name not in splits:
            making = f"{form.command} --split {name} --out {self.path}"
            raise ConfigError(
                f"{self.path} holds no {form.kind} of the split {name!r}",
                f"{', '.join(splits) or 'none'} in that folder",
                making,
            )
        return splits[name]

    def num_samples(self, split: str, asked: int | None = None) -> int:
        """How many of a split are asked for; all if None.

        Raises:
          ConfigError: there is no such split, or it has fewer.
        """
        total = int(self.split(split)[self.form.number])
        kind = self.form.kind
        if asked is not None and not 1 <= asked <= total:
            allowed = f"{range_text(1, total)}, the {kind} of {split!r} in {self.path}"
            raise ConfigError(f"num_{kind} = {asked}", allowed)
        return asked or total

    def tables(self, split: str, number: int | None = None) -> Iterator[pa.Table]:
        """The first rows of a split, all if no number is given, block by block.

        Raises:
          ConfigError: see `num_samples`; BankError: a block is missing or damaged.
        """
        for block, rows in self.form.sizes(self.num_samples(split, number)).items():
            yield self.form.read_block(self.path, split, block, rows)
