"""A bank of some scenes of another: `cg.cut`."""

import json
import shutil

import numpy as np
import pyarrow as pa
import pytest

import cluttergen_jax as cg
from cluttergen_jax.assets.pool import Pool, write_pool
from cluttergen_jax.bank_reader import Bank as PlainBank
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.generation.sources import open_source
from cluttergen_jax.judging.verify import VerifyConfig
from cluttergen_jax.scene.bank import BankIndex, BankWriter, cut, number_of_seed, read_bank
from cluttergen_jax.scene.bank.hub import check_whole
from cluttergen_jax.scene.bank.table import COLUMNS
from tests.helpers import banks
from tests.helpers.worlds import trio


@pytest.fixture(scope="module")
def long(tmp_path_factory):
    """Two blocks, with a number of its own in a column of the certificate of each scene."""
    path = tmp_path_factory.mktemp("banks") / "long"
    banks.write(path)
    index = BankIndex.of(read_bank(path))
    for block in range(2):
        rows = read_bank(path).blocks().read_block(block)
        place = rows.schema.get_field_index("num_contacts")
        numbers = pa.array(rows["index"].to_numpy() * 7, pa.int32())
        index.write_block(block, rows.set_column(place, "num_contacts", numbers))
    return path


def told(bank, numbers=None):
    """Rows as values, without the number, in order."""
    table = bank.table
    rows = {row.pop("index"): row for row in table.to_pylist()}
    return [rows[number] for number in (sorted(rows) if numbers is None else numbers)]


@pytest.mark.parametrize(
    "numbers", [[5], [*range(100, 400)], [300, 7, 511, 8, 0, 255, 256], [*range(512)]]
)
def test_rows_are_those_of_the_bank_in_the_order_asked_for(long, tmp_path, numbers):
    source = read_bank(long)
    bank = cg.cut(source, tmp_path / "out", numbers)
    assert len(bank) == len(numbers)
    assert bank.table["index"].to_pylist() == list(range(len(numbers)))
    assert set(bank.table.schema.names) == set(COLUMNS.names)
    assert told(bank) == told(source, numbers)
    assert [number_of_seed(bank.recipe, place) for place in range(len(numbers))] == numbers
    # All that somebody who gets it looks at: rows, assets, digests, models beside their rows.
    check_whole(bank)
    shares = [bank.recipe["names"], bank.recipe["seed"], bank.assets]
    assert shares == [source.recipe["names"], source.recipe["seed"], source.assets]


def test_files_of_scenes_come_along_and_are_those_of_their_rows(whole, tmp_path):
    (whole / "scenes/000001.png").write_bytes(b"a picture")
    source = read_bank(whole)
    bank = cg.cut(whole, tmp_path / "out", "1-2")
    check_whole(bank)
    names = sorted(each.name for each in (bank.path / "scenes").iterdir())
    assert names == ["000000.png", "000000.xml"]
    for ending in ("png", "xml"):
        own = (bank.path / f"scenes/000000.{ending}").read_bytes()
        assert own == (whole / f"scenes/000001.{ending}").read_bytes()
    report = cg.verify(bank.path, VerifyConfig(seconds=0.1))
    assert report.is_sound
    (one,) = PlainBank(bank.path).successes()
    np.testing.assert_array_equal(one.poses, source.rows([1])[1].poses)
    card = (bank.path / "README.md").read_text()
    assert "cut of: bank, scenes 1-2 of the seed, here numbered from 0" in card
    assert "2 cluttered tabletop scenes, of which 1 stand" in card


def test_a_cut_of_a_cut_still_knows_the_seed(long, tmp_path):
    first = cg.cut(long, tmp_path / "first", "100-199")
    second = cg.cut(first, tmp_path / "second", [50, 3, 4])
    assert second.recipe["cut"] == {"bank": "long", "scenes": [[150, 150], [103, 104]]}
    assert told(second) == told(read_bank(long), [150, 103, 104])
    assert cg.cut(second, tmp_path / "third", "all").recipe == second.recipe


def test_what_blocks_drew_objects_of_has_those_of_its_scenes(tmp_path):
    """As of a pool of thousands."""
    path = tmp_path / "bank"
    banks.with_files(path)
    bank = read_bank(path)
    shelved = tmp_path / "shelved"
    recipe = {**bank.recipe, "shelf": 3}
    table = bank.table
    with BankWriter(shelved, recipe, 3, bank.object, bank.support) as writer:
        writer.write_block(0, table)
    first = cg.cut(shelved, tmp_path / "out", [0])
    assert set(first.assets["objects"]) == set(bank.rows([0])[0].objects)
    assert sorted(each.name for each in (first.path / "assets/objects").iterdir()) == sorted(
        first.assets["objects"]
    )
    check_whole(first)


def test_an_interrupted_cut_goes_on_and_ends_equal(long, tmp_path, monkeypatch):
    done = cg.cut(long, tmp_path / "whole" / "out", "100-400")
    rows = cut._rows
    calls = []

    def fail_second(*args):
        calls.append(args)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return rows(*args)

    out = tmp_path / "broken" / "out"
    with monkeypatch.context() as patch:
        patch.setattr(cut, "_rows", fail_second)
        with pytest.raises(KeyboardInterrupt):
            cg.cut(long, out, "100-400")
    assert not (out / "README.md").exists()
    bank = cg.cut(long, out, "100-400")
    assert told(bank) == told(done)
    files = [
        {
            each.relative_to(path).as_posix(): each.read_bytes()
            for each in path.rglob("*")
            if each.is_file()
        }
        for path in (out, done.path)
    ]
    assert files[0] == files[1]


def test_what_cannot_be_cut_is_said_and_leaves_nothing(whole, tmp_path):
    before = {each: each.read_bytes() for each in whole.rglob("*") if each.is_file()}
    cases = [
        ([], ConfigError, "no scenes"),
        ("1,7", BankError, "no scene 7 in it, which holds 0-2"),
        ([1, 1], ConfigError, "twice"),
        ("x", ConfigError, "numbers and ranges"),
    ]
    for scenes, error, says in cases:
        with pytest.raises(error, match=says):
            cg.cut(whole, tmp_path / "out", scenes)
        assert not (tmp_path / "out").exists()
    with pytest.raises(ConfigError, match="is the bank that is cut"):
        cg.cut(whole, whole, "0", overwrite=True)
    assert {each: each.read_bytes() for each in whole.rglob("*") if each.is_file()} == before
    with pytest.raises(BankError, match="is not a bank"):
        cg.cut(tmp_path, tmp_path / "out", "0")


def test_another_cut_is_not_continued_but_may_be_replaced(whole, tmp_path):
    cg.cut(whole, tmp_path / "out", "0")
    with pytest.raises(BankError, match="holds a bank made with another cut"):
        cg.cut(whole, tmp_path / "out", "1")
    bank = cg.cut(whole, tmp_path / "out", "1", overwrite=True)
    assert told(bank) == told(read_bank(whole), [1])
    check_whole(bank)


def test_a_model_that_was_changed_is_not_passed_on(whole, tmp_path):
    path = shutil.copytree(whole, tmp_path / "bank")
    model = path / "scenes/000001.xml"
    model.write_text(model.read_text() + " ")
    with pytest.raises(BankError, match="is not what was written"):
        cg.cut(path, tmp_path / "out", "0-1")
    assert len(cg.cut(path, tmp_path / "other", "0")) == 1


@pytest.mark.parametrize(
    "damage", [{}, {"scenes": [[1]]}, {"scenes": [["a", "b"]]}, {"scenes": []}]
)
def test_a_record_that_does_not_tell_is_an_error(damage):
    with pytest.raises(BankError):
        number_of_seed({"cut": damage}, 3)


def test_formats_of_whole_banks_advise_it(whole, tmp_path):
    with pytest.raises(ConfigError, match="cluttergen cut"):
        cg.export(whole, tmp_path / "out", "mjlab", scenes="0")
    bank = cg.cut(whole, tmp_path / "bank", "0")
    folder = cg.export(bank, tmp_path / "out", "mjlab")
    assert json.loads((folder / "MANIFEST.json").read_text())["scenes"] == [0]
    with pytest.raises(ConfigError, match="none of these options"):
        cg.export(bank, tmp_path / "other", "mjlab", cameras=("front",))


@pytest.mark.slow
def test_attempts_of_a_cut_scene_are_made_again_and_generate_leaves_it_alone(tmp_path):
    pool = write_pool(tmp_path / "trio", Pool("trio", tuple(trio())))
    asked = {"pool": str(pool), "method": "random", "num_objects": 2, "render": False}
    whole = cg.generate(tmp_path / "bank", num_scenes=6, **asked)
    bank = cg.cut(whole.path, tmp_path / "cut", [4, 1])
    source, _ = open_source(str(bank.path))
    first, _ = open_source(str(whole.path))
    for own, number in enumerate([4, 1]):
        # It refuses what ends elsewhere than the stored scene.
        again = source.replay(own)
        then = first.replay(number)
        assert [each.verdict for each in again.attempts] == [each.verdict for each in then.attempts]
        np.testing.assert_array_equal(again.poses, then.poses)
    with pytest.raises(BankError, match="another cut"):
        cg.generate(bank.path, num_scenes=6, **asked)
