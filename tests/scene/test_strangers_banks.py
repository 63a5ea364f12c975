"""Banks of strangers: both readers refuse the same files before they wait, allocate or show anything.

The reader that travels beside a bank (`bank_reader`) and the package's own (`read_bank`) are driven side by
side; digests are computed anew wherever somebody who means harm would do so.
"""

import json
import os
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from cluttergen_jax import bank_reader
from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import BankError, ClutterGenError, printable
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.record import index_bytes
from cluttergen_jax.scene.bank.scene import read_scenes
from cluttergen_jax.scene.bank.stats import stats_of
from tests.helpers import banks

ROWS = "scenes-000000.parquet"
OBJECT = "assets/objects/box/object.json"


@pytest.fixture
def bank(tmp_path):
    folder = tmp_path / "bank"
    with banks.writer(folder, 8) as writer:
        writer.write_block(0, banks.rows(0, 8))
    return folder


def read_alone(folder):
    """With the reader that travels."""
    opened = bank_reader.Bank(folder)
    return opened.summary(), opened.arrays, opened.labels, list(opened)


def read_here(folder):
    """With the package."""
    opened = read_bank(folder)
    return stats_of(opened), opened.table, opened.support, list(read_scenes(opened))


BOTH = pytest.mark.parametrize(
    ("read", "error"), [(read_alone, bank_reader.BankError), (read_here, ClutterGenError)]
)


def sign(folder, **changes):
    """`bank.json` with these changes and without digests, signed anew."""
    record = json.loads((folder / "bank.json").read_bytes())
    record.pop("hash")
    (folder / "bank.json").write_bytes(index_bytes({**record, "files": {}, **changes}))


def change_rows(folder, change):
    """The rows of a bank as a stranger writes them."""
    table = pq.read_table(folder / ROWS)
    rows = table.to_pylist()
    change(rows)
    pq.write_table(pa.Table.from_pylist(rows, schema=table.schema), folder / ROWS)
    sign(folder)


@BOTH
def test_a_sound_bank_is_read(bank, read, error):
    assert len(read(bank)[3]) >= 6
    # And one of a version that wrote no digests.
    sign(bank)
    assert len(read(bank)[3]) >= 6


@BOTH
@pytest.mark.parametrize("name", ["bank.json", ROWS, OBJECT])
def test_pipes_are_not_waited_for(bank, read, error, name):
    (bank / name).unlink()
    os.mkfifo(bank / name)
    with pytest.raises(error, match="not a regular file"):
        read(bank)


@BOTH
@pytest.mark.parametrize("name", ["bank.json", ROWS, OBJECT])
def test_links_that_lead_out_of_the_bank_are_not_followed(bank, read, error, name):
    outside = bank.parent / "outside"
    shutil.move(bank / name, outside)
    (bank / name).symlink_to(outside)
    with pytest.raises(error, match="leads out"):
        read(bank)
    # One that stays within is.
    (bank / name).unlink()
    shutil.move(outside, (bank / name).with_name("beside"))
    (bank / name).symlink_to("beside")
    assert len(read(bank)[3]) >= 6


@BOTH
@pytest.mark.parametrize("name", ["bank.json", ROWS, OBJECT])
def test_the_size_of_a_file_is_limited(bank, read, error, name):
    # A sparse file takes no room on the disk.
    os.truncate(bank / name, 2**40)
    with pytest.raises(error, match="at most"):
        read(bank)


@BOTH
@pytest.mark.parametrize(
    "name",
    [
        "scenes-000000-999999999.parquet",
        "scenes-000000-000768.parquet",
        "scenes-000000-000001.parquet",
    ],
)
def test_a_name_that_states_more_blocks_than_its_file_has_is_refused(bank, read, error, name):
    (bank / ROWS).rename(bank / name)
    sign(bank)
    with pytest.raises(error, match=r"its name says \d+ blocks"):
        read(bank)


@BOTH
def test_blocks_in_a_falling_order_are_refused(bank, read, error):
    (bank / ROWS).rename(bank / "scenes-000005-000002.parquet")
    with pytest.raises(error, match="its name says 0 blocks"):
        read(bank)


@BOTH
def test_a_block_that_is_too_large_is_refused_before_it_is_unpacked(bank, read, error, monkeypatch):
    monkeypatch.setattr(bank_reader, "_MOST_UNPACKED", 100)
    with pytest.raises(error, match=r"8 scenes, \d+ bytes"):
        read(bank)


@BOTH
def test_a_block_of_too_many_scenes_is_refused(bank, read, error):
    table = banks.rows(0, 300)
    pq.write_table(table, bank / ROWS)
    sign(bank)
    with pytest.raises(error, match="300 scenes"):
        read(bank)


def pose(values):
    def change(rows):
        rows[0]["poses"][0][: len(values)] = values

    return change


def turned(rows):
    rows[0]["poses"][0][3:] = [0.5, 0, 0, 0]


def named(rows):
    rows[0]["objects"][0] = "../../x"


def twice(rows):
    rows[0]["objects"][1] = rows[0]["objects"][0]


def without_one(rows):
    next(row for row in rows if row["is_success"])["is_placed"][0] = False


@BOTH
@pytest.mark.parametrize(
    ("change", "says"),
    [
        (pose([float("nan")]), "pose"),
        (pose([float("inf")]), "pose"),
        (pose([1e30]), "farther away than 1000 m"),
        (turned, "pose|quaternion"),
        (named, "names an object"),
        (twice, "an object twice in one scene"),
        (without_one, "a scene that succeeded lacks an object"),
    ],
)
def test_poses_and_names_of_rows_are_checked(bank, read, error, change, says):
    change_rows(bank, change)
    with pytest.raises(error, match=says):
        read(bank)


@BOTH
def test_columns_have_their_types(bank, read, error):
    table = pq.read_table(bank / ROWS)
    texts = pa.array(
        [[[str(x) for x in pose] for pose in row] for row in table["poses"].to_pylist()]
    )
    place = table.schema.get_field_index("poses")
    pq.write_table(table.set_column(place, "poses", texts), bank / ROWS)
    sign(bank)
    with pytest.raises(error, match=r"column 'poses' is (missing or )?of another type"):
        read(bank)


def test_numbers_of_objects_lie_within_the_record(bank):
    def change(rows):
        rows[0]["object_index"][0] = 7

    change_rows(bank, change)
    with pytest.raises(BankError, match="object number 7 of 3"):
        read_here(bank)


@BOTH
def test_rows_have_their_digests(bank, read, error):
    read(bank)
    rows = banks.rows(0, 8).to_pylist()
    rows[0]["poses"][0][0] += 0.01
    pq.write_table(pa.Table.from_pylist(rows, schema=banks.rows(0, 8).schema), bank / ROWS)
    with pytest.raises(error, match=f"{ROWS} is damaged .it is not what was written"):
        read(bank)


def test_a_bank_that_is_written_while_it_is_open_is_what_bank_json_says_by_then(bank):
    known = read_alone(bank)
    shutil.rmtree(bank)
    with banks.writer(bank, 16) as writer:
        writer.write_block(0, banks.rows(0, 4))
        opened = bank_reader.Bank(bank)
        ours = read_bank(bank)
        writer.write_block(0, banks.rows(0, 8))
        np.testing.assert_array_equal(opened.arrays.poses, known[1].poses)
        assert ours.table.num_rows == 8


@BOTH
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("mass", 0.0),
        ("mass", -1.0),
        ("mass", 1e300),
        ("mass", "1"),
        ("center_of_mass", [0, 0, 1e9]),
        ("center_of_mass", [0, 0]),
        ("inertia", [[-1e-5, 0, 0], [0, 1e-5, 0], [0, 0, 1e-5]]),
        ("inertia", [[1e-5, 0, 0], [0, 1e-5, 0]]),
        ("parts", [[[0, 0, 1e9]]]),
        ("friction", 0.0),
        ("resting", [{"quaternion": [2, 0, 0, 0], "height": 0.1, "likelihood": 1.0}]),
        ("rgba", [[1, 1, 1]]),
    ],
)
def test_numbers_of_an_object_are_those_of_a_body(bank, read, error, name, value):
    file = bank / OBJECT
    record = json.loads(file.read_bytes())
    record.pop("hash")
    record[name] = value
    text = json.dumps(record, sort_keys=True, separators=(",", ":"))
    file.write_text(
        json.dumps({**record, "hash": bank_reader.hashlib.sha256(text.encode()).hexdigest()})
    )
    sign(bank)
    with pytest.raises(error, match=r"object\.json"):
        read(bank)


@pytest.mark.parametrize("text", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_a_record_holds_finite_numbers(bank, text):
    file = bank / "assets/support/support.json"
    file.write_text(file.read_text().replace('"yaw": 0.0', f'"yaw": {text}'))
    sign(bank)
    with pytest.raises(
        bank_reader.BankError, match=r"support\.json is damaged .it holds the number"
    ):
        read_alone(bank)


@pytest.mark.parametrize("name", ["bank.json", OBJECT])
def test_a_record_holds_no_key_twice(bank, name):
    sign(bank)
    file = bank / name
    file.write_text('{"format": 1, ' + file.read_text().lstrip()[1:])
    with pytest.raises(bank_reader.BankError, match="it holds the key 'format' twice"):
        read_alone(bank)
    if name == "bank.json":
        with pytest.raises(BankError, match="it holds the key 'format' twice"):
            read_bank(bank)


@BOTH
def test_a_link_in_place_of_a_cache_of_blobs_leads_nowhere(bank, read, error, tmp_path):
    """The Hugging Face Hub's cache links from snapshots to blobs, which is a folder."""
    outside = tmp_path / "outside"
    snapshot = tmp_path / "cache/snapshots/1"
    snapshot.parent.mkdir(parents=True)
    shutil.move(bank, snapshot)
    outside.mkdir()
    shutil.move(snapshot / ROWS, outside / "rows")
    (snapshot / ROWS).symlink_to("../../blobs/rows")
    outside.rename(tmp_path / "cache/blobs")
    assert len(read(snapshot)[3]) >= 6
    (tmp_path / "cache/blobs").rename(outside)
    (tmp_path / "cache/blobs").symlink_to(outside)
    with pytest.raises(error, match="leads out"):
        read(snapshot)


@pytest.mark.parametrize(
    ("part", "name", "value"),
    [
        ("stability", "timestep", 0),
        ("stability", "timestep", 1e308),
        ("contact", "gravity", -1),
        ("contact", "friction", [1]),
        ("contact", "cone", "round\x1b[2J"),
    ],
)
def test_rules_of_a_recipe_are_those_of_a_simulation(tmp_path, part, name, value):
    folder = shutil.copytree(GOLDEN, tmp_path / "golden")
    recipe = json.loads((folder / "bank.json").read_bytes())["recipe"]
    recipe[part][name] = value
    sign(folder, recipe=recipe)
    with pytest.raises(bank_reader.BankError, match=name):
        bank_reader.Bank(folder).xml(0)


GOLDEN = os.path.join(os.path.dirname(__file__), "..", "golden", "bank")
ESCAPE = "\x1b]0;owned\x07\x9b2J\u202e"


def test_what_is_printed_is_printable(bank, capsys):
    def change(rows):
        rows[3]["verdict"] = ESCAPE

    change_rows(bank, change)
    recipe = json.loads((bank / "bank.json").read_bytes())["recipe"]
    versions = {ESCAPE: ESCAPE}
    sign(bank, recipe={**recipe, "pool": ESCAPE, "method": ESCAPE, "versions": versions})
    assert bank_reader.main([str(bank)]) == 0
    said = capsys.readouterr().out
    assert r"\x1b]0;owned\x07\x9b2J\u202e" in said
    assert said.replace("\n", "").isprintable()
    # The package refuses such a record, and says so in plain letters.
    assert main(["stats", str(bank)]) == 2
    said = capsys.readouterr().err
    assert "control characters" in said
    assert said == printable(said)
    sign(bank, recipe=recipe)
    assert main(["stats", str(bank)]) == 2
    assert r"it has a verdict '\x1b]0;owned" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["../../outside", "/outside", "a/b", "", "..", "mug\n"])
def test_the_reader_that_travels_follows_no_name_out_of_the_bank(bank, name):
    recipe = json.loads((bank / "bank.json").read_bytes())["recipe"]
    sign(bank, assets={"objects": {name: ""}, "support": None})
    with pytest.raises(bank_reader.BankError, match="no files of an object"):
        _ = bank_reader.Bank(bank).labels
    sign(bank, recipe={**recipe, "names": [name]})
    with pytest.raises(bank_reader.BankError):
        _ = bank_reader.Bank(bank).names


@pytest.mark.parametrize("names", [7, "box", {"box": 1}, [7], [["box"]]])
def test_names_are_a_list_of_texts(bank, names):
    recipe = json.loads((bank / "bank.json").read_bytes())["recipe"]
    sign(bank, recipe={**recipe, "names": names})
    with pytest.raises(bank_reader.BankError, match="names objects that cannot be"):
        _ = bank_reader.Bank(bank).names
