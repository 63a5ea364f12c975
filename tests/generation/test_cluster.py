"""Work on a real Ray cluster of this machine: nothing lost, nothing twice, and equal banks."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

import cluttergen_jax as cg
from cluttergen_jax import cluster as clusters
from cluttergen_jax.cluster import MOST_DEATHS, Cluster, each_on
from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.scene.bank import BankWriter, read_bank
from tests.helpers import clusters as work
from tests.helpers.accidents import small_disk, why_no_disk

pytest.importorskip("ray", reason="needs the extra ray")
TWO = Cluster("local", 2)


@pytest.fixture(scope="module")
def ray():
    """One Ray for all quick tests; `each_on` takes what is connected."""
    import ray

    ray.init(
        "local", num_cpus=4, include_dashboard=False, log_to_driver=False, logging_level="ERROR"
    )
    yield ray
    ray.shutdown()


def test_every_item_has_one_result_and_workers_share_them(ray, tmp_path):
    found = list(each_on(TWO, work.Meeting(tmp_path, 2), range(300), "number"))
    assert sorted((place, square) for place, (square, _) in found) == [
        (n, n * n) for n in range(300)
    ]
    processes = {process for _, (_, process) in found}
    assert len(processes) == 2
    assert os.getpid() not in processes


def test_an_item_whose_worker_dies_is_given_to_another(ray, tmp_path):
    found = list(each_on(TWO, work.Deaths(tmp_path, MOST_DEATHS - 1), range(12), "number"))
    assert sorted(found) == [(n, -n) for n in range(12)]
    assert len(list(tmp_path.iterdir())) == MOST_DEATHS - 1


@pytest.mark.slow
def test_an_item_that_always_kills_its_worker_is_named(ray, tmp_path):
    with pytest.raises(ClutterGenError, match="3 worker processes died over number 4 of 12"):
        list(each_on(TWO, work.Deaths(tmp_path, 100), range(12), "number"))
    # And once more if it was not alone at first.
    assert MOST_DEATHS <= len(list(tmp_path.iterdir())) <= MOST_DEATHS + 1


def test_workers_of_other_versions_are_refused(ray, monkeypatch):
    versions = clusters.versions_here()
    monkeypatch.setattr(clusters, "versions_here", lambda: versions | {"mujoco": "1.2.3"})
    with pytest.raises(ClutterGenError, match=rf"has mujoco {versions['mujoco']} \(here 1\.2\.3\)"):
        list(each_on(TWO, work.squares, range(3), "number"))


@pytest.mark.slow
def test_two_workers_of_which_one_is_killed_make_the_bank_of_one_process(
    ray, pool, tmp_path, monkeypatch
):
    """The test of four workers below in miniature, in the Ray of all quick tests."""
    options = {"pool": pool, "num_scenes": 1100, "method": "random", "max_files": 0, "budget": 4}
    cg.generate(tmp_path / "one" / "bank", **options)
    # Of five blocks the workers have four in hand at first: one that dies is missed.
    killed = []
    hired = []
    write = BankWriter.write_block
    hire = clusters._Crew._start_worker

    def write_and_kill(writer, block, table):
        nonlocal killed
        write(writer, block, table)
        if not killed and (killed := at_work(psutil.Process())[:1]):
            killed[0].send_signal(signal.SIGKILL)

    monkeypatch.setattr(BankWriter, "write_block", write_and_kill)
    monkeypatch.setattr(
        clusters._Crew, "_start_worker", lambda crew: hired.append(crew) or hire(crew)
    )
    cg.generate(tmp_path / "two" / "bank", **options, cluster="local", workers=2)
    assert len(hired) == 3
    assert contents(tmp_path / "one") == contents(tmp_path / "two")


@pytest.fixture
def disk(tmp_path):
    """A small file system, and what sets its size in bytes."""
    if reason := why_no_disk():
        pytest.skip(f"nothing can be mounted here: {reason}")
    folder = tmp_path / "disk"
    with small_disk(folder) as resize:
        yield folder, resize


@pytest.mark.slow
def test_a_bank_whose_disk_is_full_is_refused_and_goes_on_where_there_is_room(
    ray, pool, tmp_path, disk
):
    options = {"pool": pool, "num_scenes": 1100, "method": "random", "max_files": 0, "budget": 4}
    cg.generate(tmp_path / "one" / "bank", **options)
    size = sum(map(len, contents(tmp_path / "one").values()))
    folder, resize = disk
    resize(int(0.7 * size))
    on_cluster = options | {"cluster": "local", "workers": 2}
    with pytest.raises(ClutterGenError, match=r"No space left.*making room on the disk"):
        cg.generate(folder / "two" / "bank", **on_cluster)
    # What is there is whole.
    held = sum(rows.num_rows for rows in read_bank(folder / "two" / "bank").tables())
    assert 0 < held < 1100
    assert not list(folder.rglob("*.partial"))
    resize(4 * size + 1_000_000)
    cg.generate(folder / "two" / "bank", **on_cluster)
    assert contents(tmp_path / "one") == contents(folder / "two")


@pytest.mark.slow
def test_workers_whose_disk_is_full_make_the_bank_of_one_process(pool, tmp_path, disk):
    """Ray's folder and the cache of compiled programs are on a disk that fills up while they work."""
    options = {"pool": pool, "num_scenes": 1100, "method": "random", "max_files": 0, "budget": 4}
    cg.generate(tmp_path / "one" / "bank", **options)
    folder, resize = disk
    resize(100_000_000)
    command = [sys.executable, "-m", "cluttergen_jax", "generate", "--out", tmp_path / "two/bank"]
    for name, value in (options | {"cluster": "local", "workers": 2}).items():
        command += [f"--{name.replace('_', '-')}", value]
    # Sockets have short paths.
    short = Path("/tmp") / f"cgd{os.getpid()}"
    short.symlink_to(folder)
    settings = {"RAY_TMPDIR": str(short), "JAX_COMPILATION_CACHE_DIR": str(folder / "programs")}
    try:
        running = subprocess.Popen(
            [str(word) for word in command],
            env=os.environ | settings,
            cwd=Path(__file__).parents[2],
            stderr=subprocess.PIPE,
            text=True,
        )
        first = tmp_path / "two/bank/scenes-000000.parquet"
        while running.poll() is None and not first.exists():
            time.sleep(0.05)
        # Unbuffered: what does not fit is an error of the call, not of closing the file.
        with (
            suppress(OSError),
            (folder / "filler").open("wb", buffering=0) as filler,
        ):
            while True:
                filler.write(bytes(4096))
        missing = running.poll() is None
        is_full = shutil.disk_usage(folder).free == 0
        _, said = running.communicate(timeout=300)
    finally:
        short.unlink()
    assert running.returncode == 0, said
    # It was full while some blocks were still missing.
    assert is_full
    assert missing
    assert contents(tmp_path / "one") == contents(tmp_path / "two")


def contents(path):
    return {
        str(each.relative_to(path)): each.read_bytes() for each in path.rglob("*") if each.is_file()
    }


def at_work(process):
    """Likewise of a process, as psutil knows it."""
    found = []
    for each in process.children(recursive=True):
        # Some end while they are looked at.
        with suppress(psutil.Error):
            if re.match(r"ray::.*run", " ".join(each.cmdline())):
                found.append(each)
    return found
