"""Shards: the same rows in fewer files, whatever happened on the way; and memory that does not grow."""

import os
import random
from functools import partial

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from cluttergen_jax import bank_reader
from cluttergen_jax.errors import BankError
from cluttergen_jax.placement.rollout import BLOCK_SIZE
from cluttergen_jax.scene.bank import blocks as module
from cluttergen_jax.scene.bank import index as module_index
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.bank import recover_record
from cluttergen_jax.scene.bank.blocks import StoredBlocks, block_path, shard_path, write_shard
from cluttergen_jax.scene.bank.hub import check_whole
from cluttergen_jax.scene.bank.index import BankIndex, changes_of
from cluttergen_jax.scene.bank.stats import stats_of
from tests.helpers import banks

NUM_BLOCKS = 8
IN_A_SHARD = 3


def write(path, num_blocks=NUM_BLOCKS, order=None, shard_blocks=IN_A_SHARD):
    """What is missing of a bank of whole blocks, in any order."""
    with banks.writer(path, num_blocks * BLOCK_SIZE, shard_blocks=shard_blocks) as writer:
        missing = [block for block in range(num_blocks) if not writer.has_block(block, BLOCK_SIZE)]
        for block in sorted(missing, key=(order or list(range(num_blocks))).index):
            writer.write_block(block, banks.rows(block))
        writer.finish()


def files(path):
    return {each.name: each.read_bytes() for each in path.iterdir() if each.is_file()}


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """The bank as a file for each block."""
    path = tmp_path_factory.mktemp("banks") / "plain"
    banks.write(path, NUM_BLOCKS)
    return path


@pytest.fixture(scope="module")
def sharded(tmp_path_factory):
    path = tmp_path_factory.mktemp("banks") / "bank"
    write(path)
    return path


def test_shards_hold_what_block_files_hold(plain, sharded):
    names = sorted(each.name for each in sharded.glob("*.parquet"))
    assert names == [f"scenes-{a:06d}-{b:06d}.parquet" for a, b in ((0, 2), (3, 5), (6, 7))]
    one = read_bank(plain)
    two = read_bank(sharded)
    assert one.table.equals(two.table)
    assert stats_of(one) == stats_of(two)
    assert {number: row.verdict for number, row in two.rows([3, 1000, 9999]).items()} == {
        3: "displaced",
        1000: "stable",
    }
    check_whole(two)
    assert pq.ParquetFile(sharded / names[0]).metadata.num_row_groups == IN_A_SHARD
    assert recover_record(sharded) == recover_record(plain)


def test_any_order_and_any_interruption_make_the_same_files(sharded, tmp_path):
    draw = random.Random(0)
    order = draw.sample(range(NUM_BLOCKS), NUM_BLOCKS)
    write(tmp_path / "shuffled", order=order)
    assert files(tmp_path / "shuffled") == files(sharded)
    # Smaller first: its last blocks are in a shard that has to grow.
    write(tmp_path / "grown", num_blocks=5)
    write(tmp_path / "grown")
    assert files(tmp_path / "grown") == files(sharded)


def test_a_writer_that_ends_anywhere_in_a_shard_loses_nothing(plain, sharded, tmp_path):
    """The shard is there, and all that it is made of, or some of it; or it is not there at all."""
    whole = read_bank(plain).table
    for number in (0, 2, 5):
        path = tmp_path / str(number)
        with pytest.MonkeyPatch.context() as patch:
            left = [number]
            unlink = module.Path.unlink

            def counted(self, missing_ok=False, left=left, unlink=unlink):
                if self.name.startswith("scenes-") and not missing_ok:
                    left[0] -= 1
                    if left[0] < 0:
                        raise KeyboardInterrupt
                unlink(self, missing_ok)

            patch.setattr(module.Path, "unlink", counted)
            with pytest.raises(KeyboardInterrupt):
                write(path)
        stored = read_bank(path).table
        assert stored.equals(whole.slice(0, stored.num_rows))
        write(path)
        assert files(path) == files(sharded)


def test_a_damaged_row_group_is_named_and_mended_alone(sharded, tmp_path):
    path = tmp_path / "bank"
    write(path)
    file = shard_path(path, range(3, 6))
    data = bytearray(file.read_bytes())
    place = pq.ParquetFile(file).metadata.row_group(1).column(0).data_page_offset
    data[place + 40] ^= 1
    file.write_bytes(data)
    with pytest.raises(BankError, match=r"scenes-000003-000005\.parquet is damaged"):
        _ = read_bank(path).table
    stored = StoredBlocks(path)
    assert stored.read_block(3).num_rows == stored.read_block(5).num_rows == BLOCK_SIZE
    # Others of its shard cannot be moved without it.
    assert not write_shard(path, range(3, 6), read_bank(path).record)
    write(path)
    assert files(path) == files(sharded)


def test_a_writer_that_is_killed_between_rows_and_digest_leaves_nothing_that_looks_changed(
    tmp_path,
):
    write(tmp_path)
    index = BankIndex.of(read_bank(tmp_path))
    rows = StoredBlocks(tmp_path).read_block(7)
    shake = pa.array(np.ones(rows.num_rows, np.float32))
    rows = rows.set_column(rows.schema.names.index("shake"), "shake", shake)
    index.write_block(7, rows)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module_index, "write_shard", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            index.merge_shards()
    found = {change.what for change in changes_of(read_bank(tmp_path))}
    assert found == {"not in bank.json"}
    write(tmp_path)
    assert changes_of(read_bank(tmp_path)) == []
    assert read_bank(tmp_path).table["shake"].null_count == (NUM_BLOCKS - 1) * BLOCK_SIZE


def merged_behind(patch, path, times=1):
    """From now on the bank's next file that is opened is gone: its blocks have become shards meanwhile."""
    left = [times]

    def open_late(opened, *args, **kwargs):
        if left[0]:
            left[0] -= 1
            BankIndex.of(read_bank(path)).write_shard(range(IN_A_SHARD))
        return opened(*args, **kwargs)

    patch.setattr(pa, "OSFile", partial(open_late, pa.OSFile))
    patch.setattr(pq, "ParquetFile", partial(open_late, pq.ParquetFile))


def ours(path):
    return ((row.index, row.poses) for row in read_bank(path).scenes())


def theirs(path):
    return ((scene.index, scene.poses) for scene in bank_reader.Bank(path))


@pytest.mark.parametrize("read", [ours, theirs])
@pytest.mark.parametrize("is_open", [False, True], ids=["listed", "half_read"])
def test_a_bank_is_read_while_its_blocks_become_a_shard(tmp_path, monkeypatch, read, is_open):
    write(tmp_path, shard_blocks=1000)
    whole = list(read(tmp_path))
    scenes = read(tmp_path)
    # The first block is read, the second one is in a file of its own when the folder is listed.
    begun = [next(scenes)] if is_open else []
    merged_behind(monkeypatch, tmp_path)
    read_now = begun + list(scenes)
    assert shard_path(tmp_path, range(IN_A_SHARD)).exists()
    assert [index for index, _ in read_now] == [index for index, _ in whole]
    assert all(np.array_equal(one, two) for (_, one), (_, two) in zip(read_now, whole, strict=True))


@pytest.mark.parametrize(
    ("read", "error"), [(ours, BankError), (theirs, bank_reader.BankError)], ids=["ours", "theirs"]
)
def test_damaged_is_said_of_what_was_read_alone(tmp_path, read, error):
    write(tmp_path, shard_blocks=1000)
    scenes = read(tmp_path)
    file = block_path(tmp_path, 1)
    next(scenes)
    file.unlink()
    with pytest.raises(error, match=r"scenes-000001\.parquet is missing"):
        list(scenes)
    # A link that leads nowhere is listed, and never there.
    file.symlink_to(tmp_path / "nowhere")
    with pytest.raises(error, match=r"scenes-000001\.parquet is missing"):
        list(read(tmp_path))
    file.unlink()
    file.write_bytes(b"PAR1")
    with pytest.raises(error, match=r"scenes-000001\.parquet is damaged"):
        list(read(tmp_path))


def test_a_listing_that_is_overtaken_by_a_shard_is_made_again(tmp_path, monkeypatch):
    """A folder's listing may lack both a shard that came and the blocks that went while it was made."""
    write(tmp_path, shard_blocks=1000)
    whole = read_bank(tmp_path).table
    listed = os.listdir
    BankIndex.of(read_bank(tmp_path)).write_shard(range(IN_A_SHARD))
    first = [
        each for each in listed(tmp_path) if each != shard_path(tmp_path, range(IN_A_SHARD)).name
    ]
    for read in (lambda: read_bank(tmp_path).table.num_rows, lambda: len(list(theirs(tmp_path)))):
        overtaken = iter([first])
        monkeypatch.setattr(
            os, "listdir", lambda place, late=overtaken: next(late, None) or listed(place)
        )
        assert read() == whole.num_rows
