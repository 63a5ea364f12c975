"""`bank.json` of a bank that is being written, and whether a bank's files are still what was written.

It holds a digest of every file in `assets/`, of each MJCF file of a scene, of every file of rows and of the
reader, and is kept in step with them. A scene is there twice, as a row and as an MJCF file for other
programs: both must have the same objects at the same poses.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pyarrow as pa

from cluttergen_jax.bank_reader import file_blocks
from cluttergen_jax.errors import BankError
from cluttergen_jax.files import inside, write_atomically, writing
from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.scene.bank.bank import Bank, read_bank
from cluttergen_jax.scene.bank.blocks import (
    StoredBlocks,
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
from cluttergen_jax.scene.bank.table import BankRow
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


_ASSETS = "assets"
_SCENES = "scenes"
_SCENE_FILE = re.compile(rf"{_SCENES}/(\d+)\.xml")


@dataclass(frozen=True)
class Change:
    """A file that is not what was written.

    Attributes:
      name: its path within the bank, parts divided by "/".
      what: "changed", "missing" or "not in bank.json".
    """

    name: str
    what: str


def digests_in(path: Path, folder: str) -> dict[str, str]:
    """The digest of each file below `folder` of the bank at `path`, by its path within the bank."""
    files = sorted(each for each in (path / folder).rglob("*") if each.is_file())
    return {each.relative_to(path).as_posix(): digest_of(each.read_bytes()) for each in files}


def changes_of(bank: Bank) -> list[Change] | None:
    """The files of a bank that are not what was written; None if the bank is older than digests.

    Where another process has changed `bank.json` meanwhile, files are held against what it says now.

    Raises:
      UnsafePathError: `bank.json` names a path outside of the bank.
    """
    with suppress(BankError):
        while (found := _changes_of(bank)) and (now := read_bank(bank.path)).record != bank.record:
            bank = now
    return found


def _changes_of(bank: Bank) -> list[Change] | None:
    known = bank.files
    if known is None:
        return None
    stored = StoredBlocks(bank.path)
    found = []
    for name in known:
        if file_blocks(name):
            now = stored.digest(name)
        else:
            file = inside(bank.path, name)
            now = digest_of_file(file) if file.is_file() else None
        if now != known[name]:
            found.append(Change(name, "missing" if now is None else "changed"))
    files = [*(bank.path / _ASSETS).rglob("*"), *(bank.path / _SCENES).glob("*.xml")]
    there = [each.relative_to(bank.path).as_posix() for each in files if each.is_file()]
    there += stored.file_names
    found += [Change(name, "not in bank.json") for name in there if name not in known]
    if not any(file_blocks(change.name) for change in found):
        found += _unlike_rows(bank, known.keys() - {change.name for change in found})
    return sorted(found, key=lambda change: change.name)


def _unlike_rows(bank: Bank, names: Iterable[str]) -> Iterator[Change]:
    """Those of the scenes' files that do not have the objects and poses of their rows."""
    files = {int(match[1]): name for name in names if (match := _SCENE_FILE.fullmatch(name))}
    numbers = sorted(files)
    for first in range(0, len(numbers), BLOCK_SIZE):
        some = numbers[first : first + BLOCK_SIZE]
        try:
            rows = bank.rows(some)
        except BankError:
            # Reading a file of rows that is damaged is an error elsewhere.
            continue
        for number in some:
            if number not in rows or not _is_scene_of(
                rows[number], inside(bank.path, files[number])
            ):
                yield Change(files[number], "not the scene of its row")


def _is_scene_of(row: BankRow, file: Path) -> bool:
    """Whether an MJCF file has the objects of a row at its poses, in its bodies and in its keyframe."""
    try:
        root = ET.parse(file).getroot()
        bodies = [
            each for each in root.iterfind("worldbody/body") if each.find("freejoint") is not None
        ]
        names = [base_name(body.get("name", "")) for body in bodies]
        texts = [f"{body.get('pos')} {body.get('quat')}" for body in bodies]
        texts += [
            key.get("qpos", "")
            for key in root.iterfind("keyframe/key")
            if key.get("name") == "scene"
        ]
        numbers = np.array(" ".join(texts).split(), np.float32)
    except (OSError, ET.ParseError, ValueError):
        return False
    wanted = np.tile(row.poses.ravel(), 2)
    return (
        row.is_success
        and names == [*map(base_name, row.objects)]
        and np.array_equal(numbers, wanted)
    )


def changes_to_scene(changes: Iterable[Change], file: str, objects: Iterable[str]) -> list[str]:
    """Those of the changed files that a scene is made of: its own, its objects', and what all scenes share.

    Args:
      file: the name of the scene's file in `scenes`.
      objects: the names of its bodies.
    """
    names = {base_name(name) for name in objects}
    block = int(stem) // BLOCK_SIZE if (stem := Path(file).stem).isdecimal() else -1

    def is_of_scene(parts: Sequence[str]) -> bool:
        if blocks := file_blocks(parts[0]):
            return block in blocks
        if parts[0] == _SCENES:
            return parts[1:] == [file]
        if parts == [READER]:
            return False
        return parts[1:2] != ["objects"] or len(parts) < 3 or parts[2] in names

    return [change.name for change in changes if is_of_scene(change.name.split("/"))]
