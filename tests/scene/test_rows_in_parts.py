"""What reads a bank some rows at a time finds what its whole table says."""

import json
from collections import defaultdict

import pyarrow as pa
import pytest

import cluttergen_jax as cg
from cluttergen_jax.errors import BankError
from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.scene.bank import Bank, read_bank, read_scenes, select_rows, stats_of
from cluttergen_jax.scene.bank.table import rows_of
from cluttergen_jax.scene.export.folder import num_exported
from tests.helpers import banks

BLOCKS = 3
REPEATED = 40


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """Three blocks; every fourth scene failed, and the last block begins with the first block's poses."""
    path = tmp_path_factory.mktemp("banks") / "bank"
    first = banks.rows(0)["poses"].to_pylist()[:REPEATED]
    with banks.writer(path, BLOCKS * BLOCK_SIZE) as bank:
        for block in range(BLOCKS):
            rows = banks.rows(block)
            if block == BLOCKS - 1:
                place = rows.schema.get_field_index("poses")
                poses = first + rows["poses"].to_pylist()[REPEATED:]
                field = rows.schema.field(place)
                rows = rows.set_column(place, field, pa.array(poses, field.type))
            bank.write_block(block, rows)
    return path


def content(row):
    return row.index, row.objects, row.poses.tobytes(), row.verdict


def test_rows_that_succeeded_are_those_of_the_table_in_order(path):
    bank = read_bank(path)
    wanted = [content(row) for row in rows_of(bank.table) if row.is_success]
    assert [content(row) for row in select_rows(bank)] == wanted
    assert [scene.origin.index for scene in read_scenes(bank)] == [row[0] for row in wanted]
    assert [scene.origin.index for scene in bank] == list(range(BLOCKS * BLOCK_SIZE))


def test_chosen_rows_come_in_the_order_asked_for(path):
    numbers = [600, 0, *range(500, 800, 4)[:60], 2, 600]
    numbers = [number for number in numbers if number < BLOCKS * BLOCK_SIZE]
    assert [row.index for row in select_rows(read_bank(path), numbers)] == numbers


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ([0, 3], r"scene 3 failed \(displaced\)"),
        ([*range(700)], r"175 scenes failed: 3, 7.*\(displaced\)"),
        ([0, 768], "no scene 768 in it, which holds 0-767"),
    ],
)
def test_scenes_that_cannot_be_had_are_named_before_the_first_row(path, numbers, said):
    with pytest.raises(BankError, match=said):
        next(select_rows(read_bank(path), numbers))


def test_statistics_do_not_depend_on_how_many_rows_are_read_at_a_time(path, monkeypatch):
    whole = stats_of(path)
    tables = Bank.tables

    def in_sevens(bank, *args, **kwargs):
        for rows in tables(bank, *args, **kwargs):
            yield from (rows.slice(first, 7) for first in range(0, rows.num_rows, 7))

    monkeypatch.setattr(Bank, "tables", in_sevens)
    parts = stats_of(path)
    for name in vars(whole):
        if name != "clutter":
            assert getattr(parts, name) == getattr(whole, name), name
    # Sums of other parts are other in their last bits.
    for one, other in zip(parts.clutter, whole.clutter, strict=True):
        assert one.got == pytest.approx(other.got, rel=1e-12)


def test_repeated_scenes_are_those_that_the_table_has_twice(path):
    bank = read_bank(path)
    same = defaultdict(list)
    for row in rows_of(bank.table):
        if row.is_success:
            same[row.objects, row.poses.tobytes()].append(row.index)
    wanted = tuple(tuple(group) for group in same.values() if len(group) > 1)
    assert len(wanted) == REPEATED * 3 // 4
    assert stats_of(bank).duplicates == wanted


def test_a_manifest_is_plain_json_with_each_scene_once(path, tmp_path):
    numbers = [0, 1, 2, 300, 600]
    folder = cg.export(path, tmp_path / "out", "mjcf", scenes=numbers)
    text = (folder / "MANIFEST.json").read_text(encoding="utf-8")
    record = json.loads(text)
    # As one call of `json` writes it.
    assert text == json.dumps(record, indent=1) + "\n"
    assert list(record)[-1] == "scenes"
    assert [each["index"] for each in record["scenes"]] == numbers
    assert num_exported(folder) == len(numbers)
    bank = read_bank(path)
    for each in record["scenes"]:
        poses = [[*one["position"], *one["quaternion_wxyz"]] for one in each["objects"]]
        assert poses == bank[each["index"]].poses.tolist()
        assert (folder / each["file"]).is_file()
