"""Strangers' banks and pools: names that lead out of their folder are refused, and nothing is written there.

Every digest is computed anew, as somebody would who means harm.
"""

import hashlib
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pytest

import cluttergen_jax as cg
from cluttergen_jax.assets.object_files import read_object, write_object
from cluttergen_jax.assets.pool import Pool, read_pool, write_pool
from cluttergen_jax.assets.support_file import read_support
from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import BankError, ClutterGenError, PoolError, UnsafePathError
from cluttergen_jax.files import inside, write_atomically
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.blocks import StoredBlocks
from cluttergen_jax.scene.bank.index import digests_in
from cluttergen_jax.scene.bank.record import index_bytes
from cluttergen_jax.scene.bank.scene import read_scenes, region_of
from cluttergen_jax.scene.bank.table import SCHEMA
from cluttergen_jax.scene.export import export_scenes
from cluttergen_jax.schema import digest_of
from tests.helpers import banks
from tests.helpers.exports import PLAIN_FORMATS
from tests.helpers.worlds import box, trio

OUTSIDE = "../../../../outside"
COMMANDS = {
    "stats": [],
    "stats --card": [],
    "verify": ["--seconds", "0.1"],
    "certify": ["--seconds", "0.1"],
    "render": ["--out", "OUT", "--samples", "1"],
    **{f"export --format {name}": ["--out", "OUT"] for name in PLAIN_FORMATS},
}


@pytest.fixture
def bank(whole, tmp_path):
    """A bank deep enough that what leads out of it stays in the test's own folder."""
    (tmp_path / "a/b/c/d").mkdir(parents=True)
    return Path(shutil.copytree(whole, tmp_path / "a/b/c/d/bank"))


def signed(record):
    """A JSON record of an object with its digest."""
    record.pop("hash", None)
    text = json.dumps(record, sort_keys=True, separators=(",", ":"))
    return json.dumps(record | {"hash": hashlib.sha256(text.encode()).hexdigest()})


def rename_object(folder, name):
    record = json.loads((folder / "object.json").read_text())
    (folder / "object.json").write_text(signed(record | {"name": name}))
    record.pop("hash")
    text = json.dumps(record | {"name": name}, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def rename_in_bank(bank, old, new):
    """The bank as a stranger would make it: rows, record, assets and all digests name `new` for `old`."""
    digest = rename_object(bank / "assets/objects" / old, new)
    there = bank / "assets/objects" / new
    os.renames(bank / "assets/objects" / old, there)
    record = read_bank(bank).record
    record["recipe"]["names"] = [new if name == old else name for name in record["recipe"]["names"]]
    record["assets"]["objects"].pop(old)
    record["assets"]["objects"][new] = digest
    record["files"] |= digests_in(bank, "assets")
    rows = StoredBlocks(bank).read_block(0).select(SCHEMA.names).to_pylist()
    for row in rows:
        row["objects"] = [new if name == old else name for name in row["objects"]]
    banks.write_rows(bank, 0, pa.Table.from_pylist(rows, schema=SCHEMA), record)
    sign_index(bank, record)


def sign_index(bank, record):
    there = [name for name in record["files"] if (bank / name).is_file()]
    record["files"] = {name: digest_of((bank / name).read_bytes()) for name in there}
    (bank / "bank.json").write_bytes(index_bytes(record))


def tree(root, *without):
    """Every file below a folder, but for those in `without`, with its content."""
    files = [each for each in root.rglob("*") if each.is_file() or each.is_symlink()]
    files = [each for each in files if not any(each.is_relative_to(other) for other in without)]
    return {each: each.read_bytes() if each.is_file() else b"" for each in files}


def refused(command, bank, capsys):
    """Runs a command on the bank; whether it was refused. Nothing may be written outside of bank and out."""
    root = bank.parents[4]
    out = bank.parent / "out"
    before = tree(root, bank, out)
    words = command.split()
    more = [str(out) if word == "OUT" else word for word in COMMANDS[command]]
    status = main([words[0], str(bank), *words[1:], *more])
    assert tree(root, bank, out) == before
    said = capsys.readouterr()
    assert status in (0, 1, 2)
    if status == 2:
        assert "error: " in said.err
    # What many scenes are asked of tells of each that failed, and ends with 1.
    return status == 2 or (status == 1 and OUTSIDE in said.out + said.err)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_name_that_leads_out_is_refused_by_every_command(bank, capsys, command):
    rename_in_bank(bank, "prism", OUTSIDE)
    assert refused(command, bank, capsys)
    with pytest.raises(ClutterGenError, match="outside"):
        cg.load_bank(bank)


@pytest.mark.parametrize("command", [name for name in COMMANDS if name not in ("stats", "verify")])
def test_an_object_that_calls_itself_a_path_is_refused(bank, capsys, command):
    # Rows and record are innocent; the object alone says what it is called.
    record = read_bank(bank).record
    record["assets"]["objects"]["prism"] = rename_object(bank / "assets/objects/prism", OUTSIDE)
    record["files"] |= digests_in(bank, "assets")
    sign_index(bank, record)
    assert refused(command, bank, capsys)
    with pytest.raises(ClutterGenError, match="outside"):
        cg.load_bank(bank)


@pytest.mark.parametrize("name", [OUTSIDE, "/outside", "a/b", "A", "", "mug#2", "..", "mug\n"])
def test_rows_and_records_name_objects_plainly(bank, name):
    record = read_bank(bank).record
    (bank / "bank.json").write_bytes(
        index_bytes(record | {"assets": {"objects": {name: ""}, "support": ""}})
    )
    with pytest.raises(BankError, match="names an object"):
        read_bank(bank)
    (bank / "bank.json").write_bytes(index_bytes(record))
    rows = StoredBlocks(bank).read_block(0).select(SCHEMA.names).to_pylist()
    rows[0]["objects"] = [name, name]
    banks.write_rows(bank, 0, pa.Table.from_pylist(rows, schema=SCHEMA), record)
    sign_index(bank, record)
    if name != "mug#2":
        with pytest.raises(BankError, match="names an object"):
            _ = read_bank(bank).table


def test_an_object_in_anothers_folder_is_refused(bank):
    shutil.copytree(bank / "assets/objects/prism", bank / "assets/objects/box", dirs_exist_ok=True)
    with pytest.raises(BankError, match="'box' calls itself 'prism'"):
        read_bank(bank).object("box")


@pytest.mark.parametrize(
    "change", [{"name": OUTSIDE}, {"name": 7}, {"pieces": "../../outside.obj"}]
)
def test_a_support_names_itself_and_its_files_plainly(bank, change):
    file = bank / "assets/support/support.json"
    if "pieces" in change:
        change = {"pieces": [{"file": change["pieces"], "rgba": [1, 1, 1, 1]}]}
    file.write_text(json.dumps(json.loads(file.read_text()) | change))
    with pytest.raises((PoolError, UnsafePathError), match=r"outside|called 7"):
        read_support(file.parent)


def test_a_pool_names_its_objects_plainly(tmp_path):
    path = write_pool(tmp_path / "pools/trio", Pool("trio", tuple(trio())))
    index = json.loads((path / "pool.json").read_text())
    write_object(tmp_path / "outside", box("outside", (0.02, 0.02, 0.02)))
    for changed in ({"objects": ["../../outside"]}, {"name": "../trio"}):
        (path / "pool.json").write_text(json.dumps(index | changed))
        with pytest.raises(PoolError):
            read_pool(path)
    (path / "pool.json").write_text(json.dumps(index))
    rename_object(path / "box", "tall")
    with pytest.raises(PoolError, match="called 'tall'"):
        read_pool(path)
    rename_object(path / "box", OUTSIDE)
    with pytest.raises(PoolError, match="outside"):
        read_pool(path)
    with pytest.raises(PoolError, match="outside"):
        read_object(path / "box")


@pytest.mark.parametrize("name", PLAIN_FORMATS)
def test_an_export_of_objects_made_in_memory_stays_in_its_folder(whole, tmp_path, name):
    scene = next(read_scenes(read_bank(whole)))
    scene = replace(
        scene, objects=tuple(replace(each, name="../../../x") for each in scene.objects[:1] * 2)
    )
    with pytest.raises(UnsafePathError):
        export_scenes([scene], tmp_path / "a/b/out", name)
    assert tree(tmp_path) == {}


def test_links_that_lead_out_are_neither_read_nor_written_through(bank, tmp_path, capsys):
    precious = tmp_path / "precious.txt"
    precious.write_text("mine")
    # What each command writes first, made a link beforehand.
    for name in (".verification.json.partial", ".README.md.partial", ".lock", ".bank.json.partial"):
        (bank / name).symlink_to(precious)
    assert main(["verify", str(bank), "--seconds", "0.1"]) == 0
    assert main(["stats", str(bank), "--card"]) == 2
    assert main(["certify", str(bank), "--seconds", "0.1"]) == 2
    with pytest.raises(BankError):
        banks.writer(bank, 3)
    (bank / ".lock").unlink()
    assert main(["stats", str(bank), "--card"]) == 0
    banks.with_files(bank)
    assert precious.read_text() == "mine"
    # A folder of the bank that lies elsewhere.
    (tmp_path / "elsewhere").mkdir()
    for folder in ("scenes", "assets/objects/prism"):
        shutil.rmtree(bank / folder)
        (bank / folder).symlink_to(tmp_path / "elsewhere")
        with pytest.raises(UnsafePathError, match="leads out"):
            banks.with_files(bank)
        (bank / folder).unlink()
    assert not any((tmp_path / "elsewhere").iterdir())
    banks.with_files(bank)
    cloud = bank / "assets/objects/prism/cloud.npy"
    cloud.rename(tmp_path / "cloud.npy")
    cloud.symlink_to(tmp_path / "cloud.npy")
    with pytest.raises(UnsafePathError, match="leads out"):
        read_bank(bank).object("prism")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('meshdir="../assets"', 'meshdir="/usr/share"', "000000.xml names the folder"),
        ('meshdir="../assets"', 'meshdir="../../../assets"', "000000.xml names the folder"),
        ('file="objects/box/part-00.obj"', 'file="../../part.obj"', "names the path"),
        (
            "<worldbody>",
            '<include file="/etc/hostname"/><worldbody>',
            "000000.xml includes another file",
        ),
    ],
)
def test_a_scene_file_of_a_bank_names_files_of_the_bank(bank, capsys, old, new, said):
    file = bank / "scenes/000000.xml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    record = read_bank(bank).record
    record["files"] |= digests_in(bank, "scenes")
    sign_index(bank, record)
    assert main(["verify", str(bank), "--seconds", "0.1"]) == 2
    assert said in capsys.readouterr().err


BAD = [
    OUTSIDE,
    "/etc/passwd",
    "a//b",
    "",
    ".",
    "a/..",
    "a\\b",
    "c:x",
    "a\0b",
    "a\nb",
    None,
    3,
    ["a"],
]


@pytest.mark.parametrize("name", BAD)
def test_no_name_leads_out_of_its_folder(tmp_path, name):
    with pytest.raises(UnsafePathError):
        inside(tmp_path, name)


def test_plain_names_and_links_within_are_joined(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to("folder")
    (tmp_path / "loop").symlink_to("loop")
    assert inside(tmp_path, "folder/mug-1.obj") == tmp_path / "folder" / "mug-1.obj"
    assert inside(tmp_path / "link", "mug.obj") == tmp_path / "link" / "mug.obj"
    assert inside(tmp_path, "link/mug.obj") == tmp_path / "link" / "mug.obj"
    assert inside(str(tmp_path), "..data") == tmp_path / "..data"
    write_atomically(inside(tmp_path, "link/mug.obj"), b"x")
    assert (tmp_path / "folder" / "mug.obj").read_bytes() == b"x"


@pytest.mark.parametrize(
    ("recipe", "words"),
    [
        ({"placement": None}, ["stats", "--json"]),
        ({"placement": None}, ["certify", "--seconds", "0.1"]),
        ({"placement": {"clutter": {"heaps": 1}}}, ["stats", "--json"]),
        ({"stability": {"timestep": -1}}, ["certify", "--seconds", "0.1"]),
        ({"stability": []}, ["export", "--out", "OUT"]),
    ],
)
def test_a_recipe_that_cannot_be_names_its_bank(bank, tmp_path, capsys, recipe, words):
    record = read_bank(bank).record
    record["recipe"] |= recipe
    sign_index(bank, record)
    assert (
        main(
            [words[0], str(bank), *(str(tmp_path / "out") if w == "OUT" else w for w in words[1:])]
        )
        == 2
    )
    said = capsys.readouterr().err
    assert f"{bank / 'bank.json'}: the record of how the bank was made is damaged" in said
    with pytest.raises(BankError, match="no 'region'"):
        region_of(read_bank(bank))
