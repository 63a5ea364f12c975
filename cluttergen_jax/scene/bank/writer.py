"""Writing a bank, block by block; an interrupted one is continued."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from cluttergen_jax.assets.obj import write_parts
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import object_hash, read_object, write_object
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.assets.support_file import read_support, support_hash, write_support
from cluttergen_jax.errors import BankError, ClutterGenError
from cluttergen_jax.files import check_utf8, folder_whole, inside, remove, remove_partial, writing
from cluttergen_jax.kept_folder import FolderLock, KeptFolder, check_recipe
from cluttergen_jax.placement.rollout import blocks_of
from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.scene.bank.bank import block_numbers, is_bank, read_bank, recover_record
from cluttergen_jax.scene.bank.blocks import (
    SHARD_BLOCKS,
    StoredBlocks,
    block_files,
    block_path,
    digest_of_file,
)
from cluttergen_jax.scene.bank.croissant import CROISSANT
from cluttergen_jax.scene.bank.hub import is_of_a_bank
from cluttergen_jax.scene.bank.index import BankIndex, digests_in
from cluttergen_jax.scene.bank.record import (
    FORMAT,
    INDEX,
    NO_ASSETS,
    READER,
    Bits,
    NewerBankError,
    Record,
    check_bits,
)
from cluttergen_jax.scene.bank.remote import (
    FETCHING,
    MARK,
    fetch_mirror,
    is_url,
    mirror_of,
    publish_all,
    remote_of,
)
from cluttergen_jax.scene.bank.table import with_columns_of

Objects = Mapping[str, ObjectAsset] | Callable[[str], ObjectAsset]
"""All objects of a bank by name; or what gives one when a block of scenes has it."""


class BankWriter:
    """Creates a bank, or continues one that was made with the same settings and assets.

    A context manager: it holds the bank's lock until it is closed.

    Args:
      path: the bank's folder, or a URL.
      recipe: JSON values that decide what the scenes are: two banks of equal recipes hold equal scenes.
      num_scenes: how many; a bank may be continued to a larger number.
      objects, support: stored once; damaged copies in the bank are mended. Of objects that are given by a
        function those are stored that blocks have.
      overwrite: begin anew if the folder holds another bank; the same one is continued.
      shard_blocks: how many blocks go into one file once all of them are there.
      bits: by what scenes that are missing will be computed (`numerics.bits_of_here`); None where that
        decides nothing.
      allow_other_bits: continue the bank even if its scenes were computed otherwise; its record tells both.
      open_support: the support with its doors open, as objects were placed on it, where scenes close them.
      known_bits: by what scenes were computed that are taken over from another bank.

    Raises:
      BankError: the folder holds something else, or a bank of another recipe, of other assets or, where
        scenes are missing, of other bits; another process is writing to it; or it cannot be written.
      ConfigError: its path is not UTF-8.
    """

    def __init__(
        self,
        path: str | Path,
        recipe: Mapping[str, Any],
        num_scenes: int,
        objects: Objects,
        support: SupportAsset,
        overwrite: bool = False,
        shard_blocks: int = SHARD_BLOCKS,
        bits: Bits | None = None,
        allow_other_bits: bool = False,
        open_support: SupportAsset | None = None,
        known_bits: Sequence[Bits] = (),
    ) -> None:
        self.path = mirror_of(str(path)) if is_url(path) else Path(path)
        check_utf8(self.path)
        self._shard_blocks = shard_blocks
        self._bits = bits
        self._known_bits = list(known_bits)
        self._allows_other_bits = allow_other_bits
        self._find = objects if callable(objects) else None
        self._assets: dict[str, ObjectAsset] = {} if callable(objects) else dict(objects)
        hashes: dict[str, Any] = {
            "objects": {name: object_hash(asset) for name, asset in self._assets.items()},
            "support": support_hash(support),
        }
        supports = {"support": support}
        if open_support is not None:
            hashes["support_open"] = support_hash(open_support)
            supports["support_open"] = open_support
        self._record: Record = json.loads(
            json.dumps({"format": FORMAT, "recipe": recipe, "assets": hashes})
        )
        with writing(self.path):
            self._lock = self._hold(path)
        try:
            with writing(self.path):
                self._begin(num_scenes, overwrite)
                self._store_assets(supports)
                self._index.write()
                publish_all(self.path, is_begun=True)
        except BaseException:
            self.close()
            raise

    _index: BankIndex

    def __enter__(self) -> BankWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Lets others write. The writer cannot be used after that."""
        self._lock.release()

    def has_block(self, block: int, num_rows: int) -> bool:
        """Whether block number `block` is there, sound, with at least `num_rows` rows."""
        if block not in self._stored.places or self._is_edited(block):
            return False
        try:
            is_there = self._stored.num_rows(block) >= num_rows
        except BankError:
            return False
        if is_there:
            self._sound.add(block)
        return is_there

    def write_block(self, block: int, table: pa.Table) -> None:
        """Stores the rows of a block as a whole; the last one of a shard makes it a shard.

        Rows that are there already, such as those of a block that grows, keep their certificate and whatever
        else was measured of them.

        Raises:
          BankError: it cannot be written, for instance because the disk is full.
        """
        self._store_objects_of(table)
        if block in self._sound or (block in self._stored.places and not self._is_edited(block)):
            with suppress(BankError):
                table = with_columns_of(StoredBlocks(self.path).read_block(block), table)
        self._index.write_block(block, table)
        self._sound.add(block)
        self._loose.add(block)
        self._write_shard(block // self._shard_blocks, is_last=False)

    def finish(self) -> None:
        """Makes a shard of the last blocks, too, in a bank of more than one shard.

        Raises:
          BankError: it cannot be written.
        """
        is_last = len(self._sound) > self._shard_blocks
        for shard in sorted({block // self._shard_blocks for block in self._loose}):
            self._write_shard(shard, is_last)

    def _write_shard(self, shard: int, is_last: bool) -> None:
        """Makes a shard of its blocks if all are known; of the last one, as many as there are."""
        first = shard * self._shard_blocks
        blocks = range(first, first + self._shard_blocks)
        if is_last:
            known = self._sound.union(self._stored.places).intersection(blocks)
            blocks = range(first, max(known) + 1)
        # A single block stays in the file that it has.
        if len(blocks) > 1 and self._sound.issuperset(blocks) and self._index.write_shard(blocks):
            self._loose -= set(blocks)

    def extend(self, num_scenes: int) -> None:
        """The bank is asked for at least so many scenes from now on (BankError: it cannot be written)."""
        self._index.num_scenes = max(self._index.num_scenes, num_scenes)
        self._index.add({})

    def keep_digests(self, files: dict[str, str]) -> None:
        """Enters the digests of scene files, by path within the bank, into `bank.json` (BankError)."""
        self._index.add(files)

    def _hold(self, path: str | Path) -> FolderLock:
        """The lock of the bank's folder, which is looked at once it is held; a mirror is fetched then."""
        folder = KeptFolder(
            self.path, is_bank, "{path} exists and is not a bank", lambda path: path.name == MARK
        )
        if not is_url(path):
            return folder.lock()

        def check() -> None:
            remote = remote_of(fetch_mirror(str(path), is_held=True))
            if remote is not None and not is_bank(self.path) and remote.sizes():
                given = f"{remote.url} holds something that is no bank"
                raise BankError(given, "a new place", "another `out`")
            folder.check_place()

        return FolderLock(self.path, check=check, patience=FETCHING)

    def _begin(self, num_scenes: int, overwrite: bool) -> None:
        remove_partial(self.path)
        if overwrite:
            try:
                is_ours = bool(self._check_continued(num_scenes))
            except BankError:
                is_ours = False
            if not is_ours:
                _remove_bank(self.path)
        try:
            theirs = self._check_continued(num_scenes)
        except NewerBankError as error:
            hint = f"{error.hint}, another `out`, or `overwrite` to begin anew"
            raise BankError(error.given, hint=hint) from error
        if theirs and self._find is not None:
            # What earlier blocks have is known by its digest.
            self._record["assets"]["objects"] = dict(theirs.get("assets", NO_ASSETS)["objects"])
        # By what the scenes are made, where that is known of all of them.
        known = theirs.get("bits") if theirs else self._known_bits
        if self._bits and (not theirs or self._brings_other_bits(theirs, num_scenes)):
            known = [*(known or []), self._bits]
        if known:
            self._record["bits"] = known
        # What an interrupted writer left beside its shard counts, too: the shard is made again.
        places = self._stored.places.items()
        self._loose = {
            block for block, (name, _) in places if name == block_path(self.path, block).name
        }
        rows = {name for _, (name, _) in places}
        files = {
            n: digest for n, digest in theirs.get("files", {}).items() if "/" in n or n in rows
        }
        number = max(num_scenes, theirs.get("num_scenes", 1))
        self._index = BankIndex(self.path, self._record, number, files)
        self._index.add_unknown_rows()
        self._index.write()

    def _check_continued(self, num_scenes: int) -> Record:
        """What is continued, empty where nothing is; refuses another bank, and scenes of other bits."""
        theirs = self._stored_record()
        self._stored = StoredBlocks(self.path)
        self._sound = set[int]()
        self._edited = self._edited_files(theirs.get("files", {}))
        if theirs:
            _check_same(self.path, self._record, theirs)
            if (
                self._bits
                and not self._allows_other_bits
                and self._brings_other_bits(theirs, num_scenes)
            ):
                check_bits(self.path, self._bits, theirs["bits"])
        return theirs

    def _edited_files(self, files: dict[str, str]) -> set[str]:
        """Files of rows that a user has changed: sound, unlike damaged ones, but not what was written."""
        edited = set()
        for name, blocks in block_files(self.path).items():
            if files.get(name) not in (None, digest_of_file(self.path / name)):
                own = [block for block in blocks if self._stored.places[block][0] == name]
                with suppress(BankError):
                    for block in own:
                        self._stored.read_block(block)
                    edited.add(name)
        return edited

    def _is_edited(self, block: int) -> bool:
        return self._stored.places[block][0] in self._edited

    def _brings_other_bits(self, theirs: Record, num_scenes: int) -> bool:
        """Whether the bank says by what it was made, and scenes are missing that would be made otherwise."""
        is_other = self._bits is not None and "bits" in theirs and self._bits not in theirs["bits"]
        return is_other and not all(
            self.has_block(block, rows) for block, rows in blocks_of(num_scenes)
        )

    def _stored_record(self) -> Record:
        """What the folder says it holds: `bank.json`, or a block in its stead; empty if it holds nothing."""
        try:
            return read_bank(self.path).record
        except NewerBankError:
            raise
        except BankError as error:
            blocks = block_numbers(self.path)
            record = recover_record(self.path)
            if record is not None:
                return {"num_scenes": blocks[-1] * BLOCK_SIZE + 1, **record}
            if blocks or _is_json(self.path / INDEX):
                raise BankError(
                    f"{self.path} holds a bank of which nothing tells how it was made ({error.given})",
                    "a bank that this version wrote",
                    "another `out`, or `overwrite` to begin anew",
                ) from error
            return {}

    def _store_assets(self, supports: Mapping[str, SupportAsset]) -> None:
        """Writes what is missing, damaged, or of no known digest; the index then tells what is there."""
        hashes: Mapping[str, Any] = self._record["assets"]
        for name in hashes["objects"]:
            self._store_object(name)
        for name, support in supports.items():
            folder = f"assets/{name}"
            known = hashes[name]
            if not self._is_as_written(
                folder, known, lambda path: support_hash(read_support(path))
            ):
                with folder_whole(inside(self.path, folder), is_only_writer=True) as fresh:
                    write_support(fresh, support)
        # Digests of rows, and of scenes' files that an earlier run wrote and that are still there.
        kept = {
            name: digest
            for name, digest in self._index.files.items()
            if "/" not in name or (name.startswith("scenes/") and inside(self.path, name).is_file())
        }
        self._index.files = kept | digests_in(self.path, "assets")
        self._index.write_reader()

    def _store_object(self, name: str) -> None:
        """Writes an object's files, unless they are there as they were written."""
        images = inside(self.path, "assets/textures")
        digest = self._record["assets"]["objects"][name]
        folder = f"assets/objects/{name}"
        if self._is_as_written(folder, digest, lambda path: object_hash(read_object(path, images))):
            return
        asset = self._asset(name)
        if object_hash(asset) != digest:
            raise _other_assets(self.path, [name])
        with folder_whole(inside(self.path, folder), is_only_writer=True) as fresh:
            write_parts(fresh, asset)
            write_object(fresh, asset, images)

    def _asset(self, name: str) -> ObjectAsset:
        if name in self._assets or self._find is None:
            return self._assets[name]
        return self._find(name)

    def _store_objects_of(self, table: pa.Table) -> None:
        """Writes the objects of a block's scenes that the bank does not have yet.

        Raises:
          BankError: one is not what it was when an earlier block was made.
        """
        if self._find is None:
            return
        hashes = self._record["assets"]["objects"]
        files = self._index.files
        names = sorted(
            {base_name(each) for each in pc.unique(pc.list_flatten(table["objects"])).to_pylist()}
        )
        with writing(self.path):
            for name in names:
                digest = object_hash(self._find(name))
                if hashes.setdefault(name, digest) != digest:
                    raise _other_assets(self.path, [name])
                if not any(each.startswith(f"assets/objects/{name}/") for each in files):
                    self._store_object(name)
                    self._index.files |= digests_in(self.path, f"assets/objects/{name}")
            self._index.files |= digests_in(self.path, "assets/textures")

    def _is_as_written(
        self, folder: str, wanted: str | None, hash_of: Callable[[Path], str]
    ) -> bool:
        """Whether the bank's copy of an asset is what its digests say, if there are any, and the asset."""
        known = {
            name: digest
            for name, digest in self._index.files.items()
            if name.startswith(f"{folder}/")
        }
        with suppress(ClutterGenError):
            is_kept = bool(known) and digests_in(self.path, folder) == known
            return is_kept and hash_of(self.path / folder) == wanted
        return False


_ELSEWHERE = "another `out`, or `overwrite` to begin anew"


def _is_json(path: Path) -> bool:
    try:
        return isinstance(json.loads(path.read_bytes()), dict)
    except (OSError, ValueError, RecursionError):
        return False


def _check_same(path: Path, ours: Record, theirs: Record) -> None:
    """Refuses to continue a bank of another recipe, or of other assets."""
    check_recipe(path, "a bank made", ours["recipe"], theirs["recipe"], _ELSEWHERE)
    known = theirs.get("assets", ours["assets"])
    other = sorted(
        n for n, digest in ours["assets"]["objects"].items() if known["objects"].get(n) != digest
    )
    other += ["its support"] * (known["support"] != ours["assets"]["support"])
    if other:
        raise _other_assets(path, other)


def _other_assets(path: Path, names: Sequence[str]) -> BankError:
    return BankError(
        f"{path} holds a bank made with other assets of the same name: {', '.join(names)}",
        "the assets that it was made with",
        f"{_ELSEWHERE}; the bank's own copies are in its folder `assets`",
    )


def _remove_bank(path: Path) -> None:
    """Removes what a bank consists of, and nothing else that may lie in the folder."""
    for name in block_files(path):
        (path / name).unlink()
    if remote := remote_of(path):
        for name in filter(is_of_a_bank, remote.sizes()):
            remote.remove(name)
    for folder in ("assets", "scenes"):
        remove(path / folder)
    for name in ("overview.png", "verification.json", CROISSANT, READER, INDEX):
        (path / name).unlink(missing_ok=True)


def names_of(objects: Sequence[ObjectAsset]) -> dict[str, ObjectAsset]:
    """Assets by their own name: an asset that stands in a world more than once is stored once."""
    return {asset.name: asset for asset in objects}
