"""Banks on a hub: what is pushed is pulled to the bit, is looked at first, and errors say what to do.

The Hugging Face library is the real one; the server that it speaks to is `tests.helpers.hub_server`.
"""

import json
import shutil

import pytest

import cluttergen_jax as cg
from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import BankError, UnsafePathError
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.hub import find_bank, pulled_path
from cluttergen_jax.scene.bank.record import index_bytes
from tests.helpers.hub_server import TOKEN, hub_server

NAME = "me/few-scenes"


@pytest.fixture(autouse=True)
def nobody(home, monkeypatch):
    """Nobody's own folders, token or hub."""
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    monkeypatch.delenv("CLUTTERGEN_HUB", raising=False)


@pytest.fixture
def folder(tmp_path):
    """A folder that acts as the hub."""
    (tmp_path / "hub").mkdir()
    return tmp_path / "hub"


@pytest.fixture
def server(monkeypatch):
    """A server that acts as the Hugging Face Hub."""
    constants = pytest.importorskip("huggingface_hub.constants", reason="needs the extra hub")
    # Its own protocol for large files needs a server of its own; without it Git LFS is spoken.
    monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)
    with hub_server() as server:
        yield server


@pytest.fixture(params=["folder", "server"])
def hub(request):
    """Each kind of hub, by its address."""
    value = request.getfixturevalue(request.param)
    return f"file://{value}" if request.param == "folder" else value.url


def contents(path):
    return {
        str(each.relative_to(path)): each.read_bytes() for each in path.rglob("*") if each.is_file()
    }


def test_what_is_pushed_is_pulled_to_the_bit(bank, tmp_path, hub, capsys):
    (bank / "notes.txt").write_text("mine")
    assert main(["push", str(bank), NAME, "--hub", hub]) == 0
    assert "pushed     " in capsys.readouterr().out
    assert main(["pull", NAME, "--out", str(tmp_path / "here"), "--hub", hub]) == 0
    assert "3 scenes" in capsys.readouterr().out
    sent = contents(bank)
    # The card is made when it is pushed; what is no part of a bank stays at home.
    assert sent.pop("notes.txt")
    assert sent["README.md"].startswith(b"---\nlicense: apache-2.0\n")
    assert contents(tmp_path / "here") == sent
    assert [each.name for each in tmp_path.glob(".*")] == []


def test_a_bank_is_loaded_by_its_name_and_pulled_once(bank, folder, monkeypatch):
    cg.push_bank(bank, NAME, hub=str(folder))
    monkeypatch.setenv("CLUTTERGEN_HUB", str(folder))
    assert len(cg.load_bank(NAME)) == 2
    # It is kept where one's own things are: the hub may be gone.
    shutil.rmtree(folder)
    assert find_bank(NAME) == pulled_path(NAME)
    assert read_bank(find_bank(NAME)).num_scenes == 3
    # Another hub's bank of that name is another bank, and so is another revision.
    with pytest.raises(BankError, match="is not a bank"):
        find_bank(NAME, hub=str(folder / "other"))
    assert (
        len(
            {
                pulled_path(NAME, *asked)
                for asked in ((), (None, "v1"), ("here", None), ("here", "v1"))
            }
        )
        == 4
    )


def test_an_interrupted_pull_goes_on(bank, tmp_path, server):
    cg.push_bank(bank, NAME, hub=server.url)
    server.fails_after = 9
    with pytest.raises(BankError, match="out of order"):
        cg.pull_bank(NAME, tmp_path / "here", hub=server.url)
    assert not (tmp_path / "here").exists()
    server.fails_after = None
    cg.pull_bank(NAME, tmp_path / "here", hub=server.url)
    assert contents(tmp_path / "here") == contents(bank)
    assert set(server.served.values()) == {1}


def test_a_link_where_a_pull_would_work_is_not_followed(bank, tmp_path, folder):
    cg.push_bank(bank, NAME, hub=str(folder))
    precious = tmp_path / "precious"
    (precious / "deep").mkdir(parents=True)
    (precious / "deep" / "letter").write_text("mine")
    for name in (".pulled.partial", ".pulled.old", ".pulled.00000000-1-00000000.begun"):
        (tmp_path / name).symlink_to(precious)
    pulled = cg.pull_bank(NAME, tmp_path / "pulled", hub=str(folder))
    assert read_bank(pulled).table.num_rows == read_bank(bank).table.num_rows
    assert contents(precious) == {"deep/letter": b"mine"}


def test_without_a_network_it_is_said(bank, tmp_path, monkeypatch):
    pytest.importorskip("huggingface_hub", reason="needs the extra hub")
    with hub_server() as gone:
        url = gone.url
    for call in (
        lambda: cg.pull_bank(NAME, tmp_path / "x", hub=url),
        lambda: cg.push_bank(bank, NAME, hub=url),
    ):
        with pytest.raises(BankError, match="does not answer") as caught:
            call()
        assert "goes on where it stopped" in str(caught.value)
    monkeypatch.setenv("CLUTTERGEN_HUB", url)
    with pytest.raises(
        BankError, match=r"no such folder, and as a name on a hub: .*does not answer"
    ):
        cg.load_bank("runs/bank")


def test_only_what_is_whole_is_pushed(bank, folder):
    part = bank / "assets/objects/box/part-00.obj"
    data = part.read_bytes()
    part.write_bytes(data + b"# more\n")
    with pytest.raises(BankError, match="part-00"):
        cg.push_bank(bank, NAME, hub=str(folder))
    part.write_bytes(data)
    record = read_bank(bank).record
    (bank / "bank.json").write_bytes(index_bytes(record | {"num_scenes": 9}))
    with pytest.raises(BankError, match="3 of 9 scenes"):
        cg.push_bank(bank, NAME, hub=str(folder))
    with pytest.raises(BankError, match="not a bank"):
        cg.push_bank(folder, NAME, hub=str(folder))
    assert not any(folder.iterdir())


def harm_part(files):
    files["assets/objects/box/part-00.obj"] += b"# more\n"


def harm_block(files):
    files["scenes-000000.parquet"] = files["scenes-000000.parquet"][:-9]


def lose_support(files):
    del files["assets/support/support.json"]


def lose_index(files):
    del files["bank.json"]


def add_path(files):
    files["assets/../../outside.txt"] = b"gotcha"


def name_path(files):
    record = json.loads(files["bank.json"])
    record.pop("hash")
    record["files"]["../outside.txt"] = "0" * 64
    files["bank.json"] = index_bytes(record)


@pytest.mark.parametrize(
    ("harm", "says"),
    [
        (harm_part, "part-00.obj"),
        (harm_block, "scenes-000000.parquet"),
        (lose_support, "support"),
        (lose_index, "not a bank"),
        (add_path, "outside.txt"),
        (name_path, "outside.txt"),
    ],
)
def test_what_is_pulled_is_looked_at_first(bank, tmp_path, server, harm, says):
    cg.push_bank(bank, NAME, hub=server.url)
    harm(server.files(NAME))
    before = contents(tmp_path)
    with pytest.raises((BankError, UnsafePathError), match=says):
        cg.pull_bank(NAME, tmp_path / "here", hub=server.url)
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    "name", ["bank", "a/b/c", "../bank", "me/..", "/me/bank", "me/ba nk", "me/a..b", "", "me/-x"]
)
def test_names_are_plain(bank, tmp_path, folder, name):
    with pytest.raises(BankError, match="OWNER/NAME"):
        cg.push_bank(bank, name, hub=str(folder))
    with pytest.raises(BankError, match="OWNER/NAME"):
        cg.pull_bank(name, tmp_path / "x", hub=str(folder))
