"""`bank.json` of a bank that is being written, kept in step with the files that it has digests of."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path

import pyarrow as pa

from cluttergen_jax.files import write_atomically, writing
from cluttergen_jax.scene.bank.bank import Bank
from cluttergen_jax.scene.bank.blocks import (
    block_files,
    block_path,
    digest_of_file,
    is_shard,
    rows_bytes,
    shard_path,
    write_block,
    write_shard,
)
from cluttergen_jax.scene.bank.record import INDEX, READER, Record, block_record, index_bytes
from cluttergen_jax.schema import digest_of


class BankIndex:
    """The record of a bank and the digests of its files, written to `bank.json` at every change.

    For the process that holds the bank's lock. A file of rows that is replaced has no digest meanwhile: one
    that a killed writer left is not taken for one that a user has changed.

    Args:
      path: the bank's folder.
      record: what `bank.json` holds beside `num_scenes` and `files`.
      num_scenes: how many scenes were asked for.
      files: digests by path within the bank.
    """

    def __init__(self, path: Path, record: Record, num_scenes: int, files: dict[str, str]) -> None:
        self.path = path
        self.record = record
        self.num_scenes = num_scenes
        self.files = files
        self.has_digests = True

    @classmethod
    def of(cls, bank: Bank) -> BankIndex:
        """That of a bank in a folder of this machine. Files of rows without a digest get one.

        A bank that has no digests at all stays without.
        """
        index = cls(bank.path, block_record(bank.record), bank.num_scenes, dict(bank.files or {}))
        index.has_digests = bank.files is not None
        index.add_unknown_rows()
        return index

    def write(self) -> None:
        """Writes `bank.json` (OSError: it cannot be written)."""
        files = {"files": dict(sorted(self.files.items()))} if self.has_digests else {}
        record = {"num_scenes": self.num_scenes, **self.record, **files}
        write_atomically(self.path / INDEX, index_bytes(record), is_durable=True)

    def add(self, files: dict[str, str]) -> None:
        """Enters digests (BankError: `bank.json` cannot be written)."""
        self.files |= files
        with writing(self.path):
            self.write()

    def write_reader(self) -> bool:
        """Puts this version's reader beside the bank, for programs that cannot have this package.

        Its digest is entered, without writing `bank.json`.

        Returns:
          Whether another one, or none, was there (OSError: it cannot be written).
        """
        path = self.path / READER
        data = (resources.files("cluttergen_jax") / READER).read_bytes()
        self.files[READER] = digest_of(data)
        is_ours = path.is_file() and path.read_bytes() == data
        if not is_ours:
            write_atomically(path, data)
        return not is_ours

    def add_unknown_rows(self) -> None:
        """Enters the digests of those files of rows that have none, without writing `bank.json`."""
        unknown = [name for name in block_files(self.path) if name not in self.files]
        self.files |= {name: digest_of_file(self.path / name) for name in unknown}

    def write_block(self, block: int, table: pa.Table) -> None:
        """Stores the rows of a block in a file of their own (BankError)."""
        name = block_path(self.path, block).name
        data = rows_bytes(table, self.record)
        with self._replacing([name]):
            write_block(self.path, block, data)
            self.files[name] = digest_of(data)

    def write_shard(self, blocks: range) -> bool:
        """Puts blocks into one file in place of theirs; False where `blocks.write_shard` cannot.

        Raises:
          BankError: it cannot be written.
        """
        name = shard_path(self.path, blocks).name
        with self._replacing([name]):
            written = write_shard(self.path, blocks, self.record)
            if written is None:
                if (self.path / name).is_file():
                    self.files[name] = digest_of_file(self.path / name)
                return False
            for old in written.removed:
                self.files.pop(old, None)
            self.files[name] = written.digest
        return True

    def merge_shards(self) -> None:
        """Puts blocks that were written again, and lie beside their shard, back into it (BankError)."""
        files = block_files(self.path).values()
        loose = {blocks[0] for blocks in files if not is_shard(blocks)}
        for blocks in filter(is_shard, files):
            if loose.intersection(blocks):
                self.write_shard(blocks)

    @contextmanager
    def _replacing(self, names: Iterable[str]) -> Iterator[None]:
        """`bank.json` knows nothing of these files inside the block, and what `self.files` says after it."""
        known = {
            name: digest for name in names if (digest := self.files.pop(name, None)) is not None
        }
        if known:
            self.add({})
        yield
        self.add({})
