"""A bank knows its files: a changed part, mass or friction is named, does not count, and is mended."""

import json
import re
import shutil

import pytest

from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import BankError, UnsafePathError
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.blocks import StoredBlocks
from cluttergen_jax.scene.bank.hub import check_whole
from cluttergen_jax.scene.bank.index import changes_of
from cluttergen_jax.scene.bank.record import index_bytes
from tests.helpers import banks

PART = "assets/objects/prism/part-00.obj"
SCENE = "scenes/000000.xml"
ROWS = "scenes-000000.parquet"


def all_bytes(path):
    files = [
        each for each in path.rglob("*") if each.is_file() and each.name != "verification.json"
    ]
    return {each.relative_to(path): each.read_bytes() for each in files}


def scaled(text):
    grown = re.compile(r"^v (\S+) (\S+) (\S+)$", re.M)
    return grown.sub(lambda v: "v " + " ".join(f"{1.3 * float(x):.6g}" for x in v.groups()), text)


def heavier(text):
    return re.sub(r'mass="([\d.]+)" ful', lambda mass: f'mass="{100 * float(mass[1])}" ful', text)


def rougher(text):
    return text.replace('friction="0.5 ', 'friction="5 ')


def verify(path):
    return main(["verify", str(path), "--seconds", "0.1"])


@pytest.mark.parametrize(
    ("name", "change", "stand"),
    # The prism stands in the first scene alone, and a part of it is of no other.
    [
        (PART, scaled, 1),
        (SCENE, heavier, 1),
        (SCENE, rougher, 1),
        ("assets/support/support.json", str.upper, 0),
    ],
)
def test_what_was_changed_is_named_does_not_count_and_is_mended(
    bank, whole, capsys, name, change, stand
):
    text = (bank / name).read_text()
    (bank / name).write_text(change(text))
    assert (bank / name).read_text() != text
    assert verify(bank) == 1
    out = capsys.readouterr().out
    assert f"  {name}: changed\n" in out
    assert f"{stand} of 2 scenes stand" in out
    records = json.loads((bank / "verification.json").read_text())
    assert [each["stands"] for each in records] == [False, stand == 1]
    assert records[0]["changed_files"] == [name]
    banks.with_files(bank)
    assert all_bytes(bank) == all_bytes(whole)
    assert verify(bank) == 0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: text[:-20], "cannot be loaded"),
        (
            lambda text: text.replace('key name="scene"', 'key name="other"'),
            "has no keyframe called 'scene'",
        ),
    ],
)
def test_a_file_that_cannot_be_simulated_is_reported_and_the_others_are_checked(
    bank, capsys, change, said
):
    text = (bank / SCENE).read_text()
    (bank / SCENE).write_text(change(text))
    assert (bank / SCENE).read_text() != text
    assert verify(bank) == 1
    out = capsys.readouterr().out
    assert "1 of 2 scenes stand" in out
    assert f"  000000.xml: {bank / SCENE} {said}" in out
    broken, whole = json.loads((bank / "verification.json").read_text())
    assert said in broken["fault"]
    assert (broken["stands"], whole["stands"]) == (False, True)
    assert "fault" not in whole


def test_what_is_missing_or_was_added_is_named(bank, whole, capsys):
    (bank / "assets/objects/tall/visual-9.obj").write_text("v 0 0 0\n")
    shutil.copy(bank / SCENE, bank / "scenes/000077.xml")
    (bank / "assets/objects/tall/object.xml").unlink()
    found = {(change.name, change.what) for change in changes_of(read_bank(bank))}
    assert found == {
        ("assets/objects/tall/visual-9.obj", "not in bank.json"),
        ("scenes/000077.xml", "not in bank.json"),
        ("assets/objects/tall/object.xml", "missing"),
    }
    assert verify(bank) == 1
    assert "1 of 3 scenes stand" in capsys.readouterr().out


def test_a_bank_older_than_digests_opens_and_gets_them(bank, whole, capsys):
    record = {name: value for name, value in read_bank(bank).record.items() if name != "files"}
    (bank / "bank.json").write_bytes(index_bytes(record))
    (bank / PART).write_text((bank / PART).read_text() + "# changed\n")
    (bank / SCENE).write_text(heavier((bank / SCENE).read_text()))
    assert verify(bank) == 2
    assert "no digests of the bank's files" in capsys.readouterr().err
    assert main(["verify", str(bank), "--seconds", "0.1", "--allow-unchecked"]) == 0
    assert "has no digests of its files" in capsys.readouterr().out
    banks.with_files(bank)
    assert all_bytes(bank) == all_bytes(whole)


def moved(rows):
    rows[0]["poses"][0][0] += 0.001
    return rows


def renamed(rows):
    rows[0]["objects"] = [rows[0]["objects"][1], rows[0]["objects"][0]]
    return rows


@pytest.mark.parametrize("change", [moved, renamed])
def test_rows_that_were_changed_are_named_do_not_count_and_are_mended(bank, whole, capsys, change):
    table = StoredBlocks(bank).read_block(0)
    record = {k: v for k, v in read_bank(bank).record.items() if k not in ("num_scenes", "files")}
    banks.write_rows(
        bank, 0, table.from_pylist(change(table.to_pylist()), schema=table.schema), record
    )
    assert verify(bank) == 1
    assert f"  {ROWS}: changed\n" in (out := capsys.readouterr().out)
    assert "0 of 2 scenes stand" in out
    with pytest.raises(BankError, match=rf"{ROWS} is damaged \(it is not what was written\)"):
        check_whole(read_bank(bank))
    with banks.writer(bank, 3) as writer:
        assert not writer.has_block(0, 3)
        writer.write_block(0, StoredBlocks(whole).read_block(0))
    assert all_bytes(bank) == all_bytes(whole)


@pytest.mark.parametrize(
    "name", ["../outside.txt", "/etc/hostname", "scenes/../../outside.txt", "assets/link"]
)
def test_a_list_that_leads_out_of_the_bank_is_refused(bank, name, capsys):
    (bank.parent / "outside.txt").write_text("not the bank's")
    (bank / "assets" / "link").symlink_to(bank.parent / "outside.txt")
    record = read_bank(bank).record
    record["files"][name] = "0" * 64
    (bank / "bank.json").write_bytes(index_bytes(record))
    with pytest.raises(UnsafePathError):
        changes_of(read_bank(bank))
    assert verify(bank) == 2
    assert "error: " in capsys.readouterr().err
