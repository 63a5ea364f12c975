"""Banks at URLs: an object store in memory, and a real S3 server of this machine."""

import os
import shutil
import socket
import subprocess
import time

import numpy as np
import pyarrow.fs as pafs
import pytest

import cluttergen_jax as cg
from cluttergen_jax.errors import BankError
from cluttergen_jax.placement.rollout import BLOCK_SIZE
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank import remote as module
from cluttergen_jax.scene.bank.remote import (
    RemoteFolder,
    fetch_mirror,
    fetch_scenes,
    publish_all,
)
from cluttergen_jax.scene.bank.scene import parse_reference
from tests.helpers import banks

fsspec = pytest.importorskip("fsspec", reason="needs the extra remote")
NUM_BLOCKS = 5


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("CLUTTERGEN_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


@pytest.fixture
def url(request):
    """A place of its own in the memory of this process."""
    system = fsspec.filesystem("memory")
    yield f"memory://{request.node.name}/bank"
    system.store.clear()


def write(place, num_blocks=NUM_BLOCKS, until=NUM_BLOCKS):
    """What is missing of a bank in shards of two blocks, but not beyond block `until`."""
    with banks.writer(place, num_blocks * BLOCK_SIZE, shard_blocks=2) as writer:
        made = []
        for block in range(min(num_blocks, until)):
            if not writer.has_block(block, BLOCK_SIZE):
                writer.write_block(block, banks.rows(block))
                made.append(block)
        if until >= num_blocks:
            writer.finish()
            publish_all(writer.path)
    return made


def contents(url):
    remote = RemoteFolder.of(url)
    return {name: remote.open(name).read() for name in remote.sizes()}


def files(path):
    return {
        each.relative_to(path).as_posix(): each.read_bytes()
        for each in path.rglob("*")
        if each.is_file()
    }


def test_a_bank_there_is_the_bank_here(url, tmp_path):
    write(url)
    write(tmp_path / "bank")
    assert contents(url) == files(tmp_path / "bank")
    here = read_bank(tmp_path / "bank")
    there = read_bank(url)
    assert there.table.equals(here.table)
    assert cg.stats_of(there) == cg.stats_of(here)
    one, two = (cg.load_bank(place, num_scenes=40) for place in (tmp_path / "bank", url))
    np.testing.assert_array_equal(one.qpos, two.qpos)
    # Blocks are read where they are.
    assert not list(there.path.glob("*.parquet"))


def test_a_reference_may_be_a_url(url):
    write(url)
    path = fetch_mirror(url)
    assert parse_reference(url) == (path, None)
    assert parse_reference(f"{url}:3") == (path, 3)


def test_scenes_of_a_bank_there_are_exported_and_a_whole_bank_is_not(url, tmp_path):
    write(url)
    folder = cg.export(f"{url}:0", tmp_path / "one")
    assert len(list(folder.glob("scenes/*.xml"))) == 1
    with pytest.raises(BankError, match="is not on this machine"):
        cg.export(url, tmp_path / "whole", "playground")
    assert not (tmp_path / "whole").exists()


def test_a_mirror_has_no_files_of_a_bank_that_was_made_anew(url):
    write(url)
    remote = RemoteFolder.of(url)
    mirror = fetch_mirror(url)
    for name, text in (("scenes/000000.xml", "old"), ("assets/objects/gone/object.xml", "old")):
        (mirror / name).parent.mkdir(parents=True, exist_ok=True)
        (mirror / name).write_text(text)
    remote.put("scenes/000000.xml", mirror)
    fetch_scenes(mirror)
    (mirror / "scenes/000001.xml").write_text("left over")
    (mirror / "scenes/000000.xml").write_text("changed here")
    fetch_scenes(fetch_mirror(url))
    assert (mirror / "scenes/000000.xml").read_text() == "old"
    assert not (mirror / "scenes/000001.xml").exists()
    assert not (mirror / "assets/objects/gone/object.xml").exists()


def test_a_bank_goes_on_where_it_stopped_even_without_its_mirror(url, home, tmp_path):
    assert write(url, until=3) == [0, 1, 2]
    # Block 2 is in no shard yet and waits in the mirror.
    assert {name for name in contents(url) if name.startswith("scenes")} == {
        "scenes-000000-000001.parquet"
    }
    shutil.copytree(home, tmp_path / "copy")
    assert write(url) == [3, 4]
    whole = contents(url)
    fsspec.filesystem("memory").store.clear()
    shutil.rmtree(home)
    write(url, until=3)
    shutil.rmtree(home)
    assert write(url) == [2, 3, 4]
    assert contents(url) == whole


def test_a_mirror_follows_what_was_made_anew_there(url, home):
    write(url)
    name = next(name for name in contents(url) if name.endswith("object.json"))
    remote = RemoteFolder.of(url)
    kept = fetch_mirror(url) / name
    before = kept.read_bytes()
    kept.write_bytes(before + b" ")
    assert read_bank(url).path == fetch_mirror(url)
    assert kept.read_bytes() == before == remote.open(name).read()


@pytest.mark.parametrize(
    "place", ["nowhere://bucket/bank", "file:///no such place/bank", "memory://empty/bank"]
)
def test_what_cannot_be_opened_is_explained(place):
    with pytest.raises(BankError, match=r"no such|not a bank|does not answer"):
        read_bank(place)


@pytest.fixture
def bucket(tmp_path, monkeypatch):
    """A bucket of a real S3 server, moto's, in an environment of its own for its older python-dateutil."""
    python = os.environ.get("CLUTTERGEN_MOTO_PYTHON")
    if not python:
        pytest.skip(
            "CLUTTERGEN_MOTO_PYTHON names no interpreter of an environment that has moto[server]"
        )
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = subprocess.Popen(
        [python, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)],
        env={key: value for key, value in os.environ.items() if key != "PYTHONPATH"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    for name, value in {"AWS_ACCESS_KEY_ID": "me", "AWS_SECRET_ACCESS_KEY": "secret"}.items():
        monkeypatch.setenv(name, value)
    place = f"endpoint_override=http://127.0.0.1:{port}&region=us-east-1&allow_bucket_creation=true"
    while True:
        try:
            pafs.FileSystem.from_uri(f"s3://tests/?{place}")[0].create_dir("tests")
            break
        except OSError:
            assert server.poll() is None
            time.sleep(0.2)
    yield "s3://tests/bank?" + place
    server.terminate()
    server.wait()


def test_what_reads_a_mirror_leaves_it_to_who_writes_it(url, monkeypatch):
    """What a reader fetched took away objects that the writer had not published yet."""
    monkeypatch.setattr(module, "FETCHING", 0.0)
    with banks.writer(url, BLOCK_SIZE) as writer:
        writer.write_block(0, banks.rows(0))
        late = writer.path / "assets/objects/late/object.json"
        late.parent.mkdir()
        late.write_text("{}")
        assert read_bank(url).table.num_rows == BLOCK_SIZE
        assert late.is_file()
        with pytest.raises(BankError, match="is being written by process"):
            banks.writer(url, BLOCK_SIZE)
    # Nobody writes now: what is there counts.
    read_bank(url)
    assert not late.exists()
