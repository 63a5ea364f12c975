"""The blocks of a bank on disk: a file each, or shards of many once all blocks of a shard are there.

    scenes-000000.parquet           block 0 alone
    scenes-000000-000767.parquet    the shard of blocks 0 to 767, a row group each, about 100 MB

A block that stands in a file of its own wins over the shard that holds it too: it was written later.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from cluttergen_jax.bank_reader import Blocks, RowDigests, file_blocks, files_of_rows
from cluttergen_jax.errors import BankError
from cluttergen_jax.files import check_regular, file_whole, inside, write_atomically, writing
from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.scene.bank.record import AGAIN, Record, block_record
from cluttergen_jax.scene.bank.remote import RemoteFolder, publish, remote_of
from cluttergen_jax.scene.bank.table import CLUTTER, SCHEMA, schema_of, with_added

SHARD_BLOCKS = 768
"""Blocks of a full shard: of ten-object scenes, about 100 MB. Shard s begins with block 768 s."""
_MOST_BYTES = 2**34
"""Of a file of rows."""
_METADATA = b"cluttergen"


def block_path(path: Path, block: int) -> Path:
    """Where block number `block` is stored as long as it has a file of its own."""
    return path / f"scenes-{block:06d}.parquet"


def shard_path(path: Path, blocks: range) -> Path:
    """Where the shard of these blocks is stored."""
    return path / f"scenes-{blocks[0]:06d}-{blocks[-1]:06d}.parquet"


class StoredBlocks(Blocks):
    """The blocks that lie in a folder now, or, of a mirror, where that is of; see `bank_reader.Blocks`.

    Attributes:
      remote: where those files are that the folder, a mirror, does not hold.
    """

    error = BankError
    again = AGAIN

    def __init__(self, path: Path, digests: RowDigests | None = None) -> None:
        self.remote: RemoteFolder | None = remote_of(path)
        super().__init__(path, digests)

    def read_block(self, block: int) -> pa.Table:
        """The rows of one block, with all columns of this version, every value looked at.

        Raises:
          BankError: there is none, the file cannot be read, is damaged, or does not hold what its name says.
        """
        return next(self.read(partial(_check_columns, None), blocks=[block]))

    def tables(
        self, columns: Sequence[str] | None = None, blocks: Iterable[int] | None = None
    ) -> Iterator[pa.Table]:
        """All rows in order, some blocks at a time, so that memory does not grow with the bank.

        Args:
          columns: those that are wanted, all if not given; every value in them is looked at.
          blocks: those that are wanted, all if not given; the others are not read.

        Raises:
          BankError: as `read_block`.
        """
        held = None if blocks is None else sorted(set(blocks).intersection(self.places))
        return self.read(partial(_check_columns, columns), columns, held)

    def names(self) -> Iterable[str]:
        """The files of rows of the folder, and of where it is from."""
        elsewhere = filter(file_blocks, self.remote.sizes()) if self.remote else ()
        return {*super().names(), *elsewhere}

    def open_file(self, name: str) -> pa.NativeFile:
        """A file of rows, from where it is (FileNotFoundError, OSError: it is gone, or cannot be read)."""
        path = self.path / name
        if self.remote is None or path.exists():
            check_regular(inside(self.path, name), _MOST_BYTES)
            self.check_digest(name, path)
            # pyarrow takes a relative path with a colon in it for a URL.
            return pa.OSFile(os.fspath(path.absolute()))
        try:
            return self.remote.open(name)
        except BankError as error:
            if isinstance(error.__cause__, FileNotFoundError):
                raise error.__cause__ from error
            raise

    @property
    def file_names(self) -> list[str]:
        """The files in which the blocks lie."""
        return sorted({name for name, _ in self.places.values()})

    def digest(self, name: str) -> str | None:
        """The digest of a file of rows as it is now, here or elsewhere; None if there is none."""
        with suppress(FileNotFoundError, IsADirectoryError):
            return digest_of_file(self.path / name)
        if self.remote is None or name not in self.remote.sizes():
            return None
        with self.remote.open(name) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def num_rows(self, block: int) -> int:
        """The rows of a block, as its file says; elsewhere, nothing but the file's end is fetched.

        Raises:
          BankError: the file cannot be read.
        """
        if self.remote is None or (self.path / self.places[block][0]).exists():
            return int(self.read_block(block).num_rows)
        return len(self.numbers(block))


def _check_columns(columns: Sequence[str] | None, rows: pa.Table) -> pa.Table:
    """Rows, sound as `check_rows` knows them, with those columns (ValueError: they are none of a bank)."""
    table = with_added(rows) if columns is None else rows.select(columns)
    for each in [*SCHEMA, *CLUTTER]:
        if columns is not None and each.name not in columns:
            continue
        if each.name not in table.schema.names or table.schema.field(each.name).type != each.type:
            raise ValueError(f"its column {each.name!r} is missing or of another type")
        if each.name in SCHEMA.names and table[each.name].null_count:
            raise ValueError(f"its column {each.name!r} has gaps")
    names = set(table.schema.names)
    lists = [
        table[each.name].combine_chunks()
        for each in SCHEMA
        if pa.types.is_list(each.type) and each.name in names
    ]
    lengths = [pc.list_value_length(each) for each in lists]
    if any(not each.equals(lengths[0]) for each in lengths) or any(
        pc.list_flatten(each).null_count for each in lists
    ):
        raise ValueError("its lists of objects are of different lengths, or have gaps")
    if "verdict" in names:
        verdicts = pc.unique(table["verdict"]).to_pylist()
        if strange := [text for text in verdicts if not text.isprintable()]:
            raise ValueError(f"it has a verdict {strange[0]!r}")
    return table


def with_record(table: pa.Table, record: Record) -> pa.Table:
    """The rows of a block with the bank's record in them, so that any block can stand in for `bank.json`."""
    return table.replace_schema_metadata({_METADATA: json.dumps(block_record(record)).encode()})


def digest_of_file(path: Path) -> str:
    """The digest of a file's content, of whatever size."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def record_in(table: pa.Table) -> Any:
    """The record that `with_record` put there.

    Raises:
      KeyError, ValueError, RecursionError: there is none that can be read.
    """
    return json.loads((table.schema.metadata or {})[_METADATA])


def block_files(path: Path) -> dict[str, range]:
    """The files of blocks and shards in a folder, and which blocks each is of."""
    return _block_files(files_of_rows(path))


def _block_files(names: Iterable[str]) -> dict[str, range]:
    return {name: blocks for name in names if (blocks := file_blocks(name))}


def is_shard(blocks: range) -> bool:
    """Whether a file of these blocks is a shard."""
    return len(blocks) > 1


def rows_bytes(table: pa.Table, record: Record) -> bytes:
    """The file of a block: its rows, with all columns that a bank has, and the bank's record."""
    buffer = io.BytesIO()
    rows = with_added(table)
    schema = schema_of(rows)
    # Equal rows make equal bytes, wherever they were read from.
    rows = rows.select(schema.names).cast(schema).combine_chunks()
    pq.write_table(with_record(rows, record), buffer, write_page_checksum=True)
    return buffer.getvalue()


def write_block(path: Path, block: int, data: bytes) -> None:
    """Stores the file of a block, `rows_bytes`, as a whole. For who holds the bank's lock (BankError)."""
    file = block_path(path, block)
    with writing(file):
        write_atomically(file, data, is_durable=True)


@dataclass(frozen=True)
class WrittenShard:
    """A shard that was written.

    Attributes:
      digest: of its file.
      removed: names of the files that it replaces.
    """

    digest: str
    removed: tuple[str, ...]


def write_shard(path: Path, blocks: range, record: Record) -> WrittenShard | None:
    """Puts blocks into one shard in place of their files, row group by row group; for who holds the lock.

    Nothing is lost wherever it is interrupted: what the shard is made of goes once the shard is on disk.

    Returns:
      None, and nothing is changed, where one is damaged or has other columns than the rest.

    Raises:
      BankError: it cannot be written.
    """
    target = shard_path(path, blocks)
    try:
        with writing(target), file_whole(target) as fresh:
            _write_row_groups(fresh, StoredBlocks(path), blocks, record)
            digest = digest_of_file(fresh)
    except _UnevenError:
        return None
    publish(path, target.name)
    removed = [
        name
        for name, held in block_files(path).items()
        if name != target.name and set(held) <= set(blocks)
    ]
    for name in removed:
        (path / name).unlink()
    if remote := remote_of(path):
        for name, held in _block_files(remote.sizes()).items():
            if name != target.name and set(held) <= set(blocks):
                remote.remove(name)
                removed.append(name)
    return WrittenShard(digest, tuple(removed))


class _UnevenError(Exception):
    """Blocks that one file cannot hold."""


def _write_row_groups(target: Path, stored: StoredBlocks, blocks: range, record: Record) -> None:
    schema: pa.Schema | None = None
    with target.open("wb") as file, ExitStack() as stack:
        for block in blocks:
            try:
                table = stored.read_block(block)
            except BankError as error:
                raise _UnevenError from error
            own = schema_of(table)
            if schema is None:
                schema = own
                stamped = with_record(own.empty_table(), record).schema
                writer = stack.enter_context(
                    pq.ParquetWriter(file, stamped, write_page_checksum=True)
                )
            elif own != schema:
                raise _UnevenError
            # One chunk a column: equal rows make equal bytes, wherever they were read from.
            writer.write_table(table.select(own.names).cast(stamped).combine_chunks(), BLOCK_SIZE)
        stack.close()
        file.flush()
        os.fsync(file.fileno())
