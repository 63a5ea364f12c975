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
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from cluttergen_jax.assets.object_files import NAME_PATTERN
from cluttergen_jax.errors import BankError
from cluttergen_jax.files import check_regular, file_whole, inside, write_atomically, writing
from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.scene.bank.record import AGAIN, Record, block_record
from cluttergen_jax.scene.bank.remote import RemoteFolder, publish, remote_of
from cluttergen_jax.scene.bank.table import CLUTTER, COLUMNS, SCHEMA, schema_of, with_added

SHARD_BLOCKS = 768
"""Blocks of a full shard: of ten-object scenes, about 100 MB. Shard s begins with block 768 s."""
_AT_ONCE = 32
"""Blocks that are read together: a few megabytes of rows."""
_TRIES = 100
"""So often a folder is listed again that changes while it is read."""
_MOST_BYTES = 2**34
"""Of a file of rows."""
_MOST_UNPACKED = 2**30
"""Bytes of a block once it is unpacked."""
_FAR = 1000.0
"""Metres beyond which no object of a scene that succeeded is."""
_FILE = re.compile(r"scenes-(\d{6,9})(?:-(\d{6,9}))?\.parquet")
_SLOT = re.compile(rf"{NAME_PATTERN.pattern}(#\d+)?")
_METADATA = b"cluttergen"
_T = TypeVar("_T")


def block_path(path: Path, block: int) -> Path:
    """Where block number `block` is stored as long as it has a file of its own."""
    return path / f"scenes-{block:06d}.parquet"


def shard_path(path: Path, blocks: range) -> Path:
    """Where the shard of these blocks is stored."""
    return path / f"scenes-{blocks[0]:06d}-{blocks[-1]:06d}.parquet"


@dataclass(frozen=True, eq=False)
class StoredBlocks:
    """The blocks that lie in a folder at one time.

    Attributes:
      path: the bank's folder.
      places: by block, in order, the name of its file and its row group there.
      remote: where those files are that the folder, a mirror, does not hold.
    """

    path: Path
    places: dict[int, tuple[str, int]]
    remote: RemoteFolder | None = None
    _open: dict[str, pq.ParquetFile] = field(default_factory=dict)

    @classmethod
    def of(cls, path: Path) -> StoredBlocks:
        """What lies in a folder now; nothing if there is none."""
        places: dict[int, tuple[str, int]] = {}
        # The last one wins: long shards over short ones that they were made of, single blocks over all.
        files = block_files(path)
        remote = remote_of(path)
        if remote is not None:
            files |= _block_files(remote.sizes())
        for name, blocks in files.items():
            if len(blocks) > SHARD_BLOCKS:
                raise BankError(
                    f"{path / name} is damaged: its name says {len(blocks)} blocks",
                    f"1 to {SHARD_BLOCKS} in a file",
                    AGAIN,
                )
        for name in sorted(files, key=lambda name: (not is_shard(files[name]), files[name][-1])):
            places.update({block: (name, row_group) for row_group, block in enumerate(files[name])})
        return cls(path, dict(sorted(places.items())), remote)

    def read(self, block: int) -> pa.Table:
        """The rows of one block, every value looked at.

        Raises:
          BankError: there is none, the file cannot be read, is damaged, or does not hold what its name says.
        """
        return self._use([block], partial(_rows_of, block, None))[1]

    def tables(
        self, columns: Sequence[str] | None = None, blocks: Iterable[int] | None = None
    ) -> Iterator[pa.Table]:
        """All rows in order, some blocks at a time, so that memory does not grow with the bank.

        Args:
          columns: those that are wanted, all if not given; every value in them is looked at.
          blocks: those that are wanted, all if not given; the others are not read.

        Raises:
          BankError: likewise.
        """

        rest = (
            list(self.places) if blocks is None else sorted(set(blocks).intersection(self.places))
        )
        while rest:
            number, table = self._use(rest, partial(_rows_of, rest[0], columns))
            rest = rest[number:]
            yield table

    def _use(
        self, blocks: Sequence[int], use: Callable[[pq.ParquetFile, list[int]], _T]
    ) -> tuple[int, _T]:
        """What `use` makes of the first ones of some blocks, those that lie together; and how many these are.

        A writer may put blocks into another file after they were listed: listing and reading are one step,
        which is done again. Damaged is what was read, and is not what was written.

        Args:
          use: given a file, and row groups of it.
        """
        for _ in range(_TRIES):
            if blocks[0] not in self.places:
                break
            name, row_groups = self._together(blocks)
            try:
                file = self._file(name)
                _check_sizes(file.metadata, name, row_groups)
                return len(row_groups), use(file, row_groups)
            except _GoneError:
                self.places.clear()
                self.places.update(StoredBlocks.of(self.path).places)
            except (pa.ArrowException, OSError, ValueError, KeyError, MemoryError) as error:
                raise BankError(f"{self.path / name} is damaged ({error})", hint=AGAIN) from error
        raise BankError(f"{block_path(self.path, blocks[0])} is missing", hint=AGAIN)

    def _together(self, blocks: Sequence[int]) -> tuple[str, list[int]]:
        """The file of the first block, and the row groups of it and of those that follow it there."""
        name, row_group = self.places[blocks[0]]
        row_groups = [row_group]
        for block in blocks[1:]:
            row_group += 1
            is_next = block == blocks[0] + len(row_groups) and row_group % _AT_ONCE
            if not is_next or self.places.get(block) != (name, row_group):
                break
            row_groups.append(row_group)
        return name, row_groups

    def _file(self, name: str) -> pq.ParquetFile:
        if name not in self._open:
            # One at a time: blocks are read in order, and each open file costs memory.
            self._open.clear()
            self._open[name] = pq.ParquetFile(self._opened(name), page_checksum_verification=True)
        return self._open[name]

    def _opened(self, name: str) -> pa.NativeFile:
        # pyarrow takes a relative path with a colon in it for a URL.
        path = (self.path / name).absolute()
        try:
            if self.remote is None or path.exists():
                check_regular(inside(self.path, name), _MOST_BYTES)
                return pa.OSFile(os.fspath(path))
            return self.remote.open(name)
        except FileNotFoundError as error:
            raise _GoneError from error
        except OSError as error:
            given = f"{self.path / name} cannot be read ({error.strerror or error})"
            raise BankError(given, hint=AGAIN) from error
        except BankError as error:
            if isinstance(error.__cause__, FileNotFoundError):
                raise _GoneError from error
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
            return self.read(block).num_rows
        return self._use(
            [block], lambda file, groups: int(file.metadata.row_group(groups[0]).num_rows)
        )[1]


class _GoneError(Exception):
    """A file that was listed is not there any more."""


def _rows_of(
    block: int, columns: Sequence[str] | None, file: pq.ParquetFile, row_groups: list[int]
) -> pa.Table:
    """Row groups of a file, the first of which is that of a block, every value looked at."""
    table = file.read_row_groups(row_groups, columns)
    table = with_added(table) if columns is None else table.select(columns)
    table.validate(full=True)
    _check_rows(table, block, columns)
    return table


def _check_sizes(metadata: pq.FileMetaData, name: str, groups: Iterable[int]) -> None:
    """ValueError if a file states more than its name allows, before memory is taken for it."""
    if metadata.num_row_groups != len(file_blocks(name)):
        blocks = len(file_blocks(name))
        raise ValueError(f"its name says {blocks} blocks, and it holds {metadata.num_row_groups}")
    for group in map(metadata.row_group, groups):
        # What it states of its columns is not asked: Arrow ends the process where that is damaged.
        if not (0 < group.num_rows <= BLOCK_SIZE and 0 <= group.total_byte_size <= _MOST_UNPACKED):
            raise ValueError(f"a block has {group.num_rows} scenes, {group.total_byte_size} bytes")


def _check_rows(table: pa.Table, block: int, columns: Sequence[str] | None) -> None:
    """ValueError if these are not rows of blocks from number `block` on, as far as their columns tell."""
    for each in [*SCHEMA, *CLUTTER]:
        if columns is not None and each.name not in columns:
            continue
        if each.name not in table.schema.names or table.schema.field(each.name).type != each.type:
            raise ValueError(f"its column {each.name!r} is missing or of another type")
        if each.name in SCHEMA.names and table[each.name].null_count:
            raise ValueError(f"its column {each.name!r} has gaps")
    first = block * BLOCK_SIZE
    names = set(table.schema.names)
    if "index" in names and not np.array_equal(
        table["index"], np.arange(first, first + table.num_rows)
    ):
        raise ValueError(f"its scenes are not those from {first} on")
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
    if "objects" in names:
        known = pc.unique(pc.list_flatten(table["objects"])).to_pylist()
        if strange := [name for name in known if not _SLOT.fullmatch(name)]:
            raise ValueError(f"it names an object {strange[0]!r}")
    if "verdict" in names:
        verdicts = pc.unique(table["verdict"]).to_pylist()
        if strange := [text for text in verdicts if not text.isprintable()]:
            raise ValueError(f"it has a verdict {strange[0]!r}")
    if {"objects", "is_placed", "is_success"} <= names:
        row = np.repeat(
            np.arange(table.num_rows), np.array(pc.list_value_length(table["is_placed"]))
        )
        placed = np.array(pc.list_flatten(table["is_placed"]), bool)
        objects = pc.list_flatten(table["objects"]).combine_chunks().dictionary_encode().indices
        pairs = np.stack([row, np.array(objects)])[:, placed]
        if np.unique(pairs, axis=1).shape != pairs.shape:
            raise ValueError("it has an object twice in one scene")
        if not placed[np.array(table["is_success"], bool)[row]].all():
            raise ValueError("a scene that succeeded lacks an object")
    if {"poses", "is_placed"} <= names:
        # Poses are lists in lists: slots, and seven numbers each.
        poses = np.array(pc.list_flatten(pc.list_flatten(table["poses"]))).reshape(-1, 7)
        placed = np.array(pc.list_flatten(table["is_placed"]), bool)
        if not np.isfinite(poses[placed]).all():
            raise ValueError("an object that was placed has a pose that is not finite")
        if (np.abs(np.linalg.norm(poses[placed, 3:], axis=1) - 1) > 1e-3).any():
            raise ValueError("an object that was placed has a quaternion that is not of length 1")
        if "is_success" in names:
            number = pc.list_value_length(table["is_placed"])
            placed &= np.repeat(np.array(table["is_success"], bool), np.array(number))
            if (np.abs(poses[placed, :3]) > _FAR).any():
                raise ValueError(
                    f"an object of a scene that succeeded is farther away than {_FAR:g} m"
                )


def with_record(table: pa.Table, record: Record) -> pa.Table:
    """The rows of a block with the bank's record in them, so that any block can stand in for `bank.json`."""
    return table.replace_schema_metadata({_METADATA: json.dumps(block_record(record)).encode()})


def is_whole(path: Path) -> bool:
    """Whether a file of rows has all columns that this version writes; True for one that is damaged."""
    try:
        return set(COLUMNS.names) <= set(pq.read_schema(path.absolute()).names)
    except (pa.ArrowException, OSError):
        return True


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
    if not path.is_dir():
        return {}
    # A listing that is made while files are exchanged may have neither the old ones nor the new one.
    found = _block_files(os.listdir(path))
    for _ in range(_TRIES):
        before, found = found, _block_files(os.listdir(path))
        if found == before:
            break
    return found


def _block_files(names: Iterable[str]) -> dict[str, range]:
    return {name: blocks for name in names if (blocks := file_blocks(name))}


def file_blocks(name: str) -> range:
    """The blocks of a file of rows, by its name; none for any other file."""
    match = _FILE.fullmatch(name)
    return range(int(match[1]), int(match[2] or match[1]) + 1) if match else range(0)


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
            _write_row_groups(fresh, StoredBlocks.of(path), blocks, record)
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
                table = stored.read(block)
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
