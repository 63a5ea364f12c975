"""Banks under bad luck: damage, other assets, a full disk, a second writer, a killed one. Nothing is lost."""

import errno
import fcntl
import json
import multiprocessing
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import pyarrow as pa
import pytest

import cluttergen_jax as cg
from cluttergen_jax.assets.pool import Pool, write_pool
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import BankError, ClutterGenError, ConfigError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.kept_folder import FolderLock
from cluttergen_jax.placement.rollout import BLOCK_SIZE
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.blocks import block_path
from cluttergen_jax.scene.bank.card import CARD, write_card
from cluttergen_jax.scene.bank.record import index_bytes
from cluttergen_jax.scene.bank.stats import stats_of, stats_text
from cluttergen_jax.scene.bank.table import SCHEMA
from cluttergen_jax.scene.bank.writer import BankWriter
from tests.helpers import banks
from tests.helpers.worlds import box, trio

ROOT = Path(__file__).parents[2]
# Writers in processes of their own, which begin with everything imported.
PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(["tests.helpers.banks"])


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("banks") / "whole"
    banks.write(path)
    return path


def assert_complete(path, whole):
    assert read_bank(path).table.equals(read_bank(whole).table)
    names = {each.relative_to(path) for each in path.rglob("*") if each.is_file()}
    assert names == {each.relative_to(whole) for each in whole.rglob("*") if each.is_file()}
    for name in names:
        assert (path / name).read_bytes() == (whole / name).read_bytes(), name


@pytest.mark.parametrize("name", ["bank.json", "scenes-000000.parquet", "scenes-000001.parquet"])
@pytest.mark.parametrize("harm", ["gone", "empty", "cut", "flipped", "noise"])
def test_damage_is_named_and_the_same_command_mends_it(bank, whole, name, harm):
    data = (bank / name).read_bytes()
    middle = len(data) // 2
    harmed = {
        "empty": b"",
        "cut": data[:middle],
        "flipped": data[:middle] + bytes([data[middle] ^ 0x55]) + data[middle + 1 :],
        "noise": random.Random(0).randbytes(len(data)),
    }
    (bank / name).unlink() if harm == "gone" else (bank / name).write_bytes(harmed[harm])
    if harm != "gone" or name == "bank.json":
        with pytest.raises(BankError, match=re.escape(name)) as caught:
            _ = read_bank(bank).table
        assert "generate" in str(caught.value)
    banks.write(bank)
    assert_complete(bank, whole)


def test_a_block_under_another_name_is_noticed(bank):
    shutil.copy(block_path(bank, 0), block_path(bank, 1))
    with pytest.raises(BankError, match="not what was written"):
        _ = read_bank(bank).table
    record = read_bank(bank).record
    (bank / "bank.json").write_bytes(index_bytes({**record, "files": {}}))
    with pytest.raises(BankError, match="scenes are not those that its name says"):
        _ = read_bank(bank).table


def test_a_bank_that_nothing_explains_is_not_touched(bank):
    (bank / "bank.json").write_text("{")
    for block in (0, 1):
        block_path(bank, block).write_bytes(b"PAR1")
    with pytest.raises(BankError, match="overwrite"):
        banks.write(bank)
    assert block_path(bank, 0).read_bytes() == b"PAR1"
    with banks.writer(bank, 1, overwrite=True) as writer:
        assert not writer.has_block(0, 1)


def test_a_bank_of_a_later_format_is_not_touched(tmp_path):
    (tmp_path / "bank").mkdir()
    (tmp_path / "bank" / "bank.json").write_text('{"format": 99}')
    with pytest.raises(BankError, match=r"newer version \(format 99; this one reads 1\)"):
        banks.write(tmp_path / "bank")
    assert json.loads((tmp_path / "bank" / "bank.json").read_text()) == {"format": 99}


@pytest.mark.parametrize("is_index_lost", [False, True])
def test_a_whole_bank_of_a_later_format_is_refused_and_kept(bank, capsys, is_index_lost):
    record = read_bank(bank).record | {"format": 7}
    for block in (0, 1):
        banks.write_rows(bank, block, banks.rows(block, 3), record)
    (bank / "bank.json").write_bytes(b"{" if is_index_lost else index_bytes(record))
    kept = {each: each.read_bytes() for each in bank.glob("*.*")}
    with pytest.raises(BankError, match=r"newer version .*a newer cluttergen_jax.*`overwrite`"):
        banks.write(bank)
    assert all(each.read_bytes() == data for each, data in kept.items())
    if not is_index_lost:
        assert main(["stats", str(bank)]) == 2
        assert "this one reads 1). Try: a newer cluttergen_jax." in capsys.readouterr().err
    with banks.writer(bank, 1, overwrite=True) as writer:
        assert not writer.has_block(0, 1)


@pytest.mark.parametrize("name", ["object.json", "cloud.npy", "part-00.obj"])
def test_damaged_assets_are_named_and_mended(bank, whole, name):
    file = bank / "assets" / "objects" / "prism" / name
    file.unlink() if name == "part-00.obj" else file.write_bytes(file.read_bytes()[:50])
    if name != "part-00.obj":
        with pytest.raises(ClutterGenError, match=name):
            read_bank(bank).object("prism")
    banks.write(bank)
    assert_complete(bank, whole)


def test_other_assets_of_the_same_name_are_refused(bank, whole):
    other = {asset.name: asset for asset in trio()} | {"tall": box("tall", (0.01, 0.01, 0.09))}
    with pytest.raises(BankError, match="other assets of the same name: tall") as caught:
        banks.writer(bank, 600, objects=other)
    assert "`overwrite`" in str(caught.value)
    assert_complete(bank, whole)
    # Swapped behind the bank's back: sound in themselves, but not what the scenes were made with.
    shutil.rmtree(bank / "assets")
    with banks.writer(bank.parent / "other", 1, objects=other):
        pass
    shutil.copytree(bank.parent / "other" / "assets", bank / "assets")
    with pytest.raises(BankError, match="'tall' is not the one"):
        read_bank(bank).object("tall")
    record = json.loads((bank / "bank.json").read_text())
    record["assets"]["support"] = "0" * 64
    del record["hash"]
    (bank / "bank.json").write_text(json.dumps(record))
    with pytest.raises(BankError, match="'support' is not the one"):
        _ = read_bank(bank).support


def error_of_writing(path):
    try:
        banks.write(path)
    except BankError as error:
        return error
    return None


class SmallDisk:
    """Files that together take so many bytes, and not one more."""

    def __init__(self, monkeypatch, room):
        self.room = room
        self.open = Path.open
        monkeypatch.setattr(
            Path, "open", lambda path, *args, **kwargs: self.opened(path, *args, **kwargs)
        )
        monkeypatch.setattr(Path, "write_bytes", lambda path, data: self.store(path, data))
        monkeypatch.setattr(
            Path, "write_text", lambda path, text, **_: self.store(path, text.encode())
        )

    def store(self, path, data):
        with path.open("wb") as file:
            return file.write(data)

    def opened(self, path, mode="r", *args, **kwargs):
        file = self.open(path, mode, *args, **kwargs)
        if "w" not in mode:
            return file
        return Limited(self, file)


class Limited:
    """A file on a small disk: what still fits is written, then the error comes, as from the system."""

    def __init__(self, disk, file):
        self.disk = disk
        self.file = file

    def write(self, data):
        fits = data[: max(self.disk.room, 0)]
        self.disk.room -= len(data)
        self.file.write(fits)
        if len(fits) < len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return len(data)

    def __getattr__(self, name):
        return getattr(self.file, name)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.file.close()


def test_a_full_disk_loses_nothing_wherever_it_strikes(whole, tmp_path):
    size = sum(each.stat().st_size for each in whole.rglob("*") if each.is_file())
    draw = random.Random(1)
    rooms = [0, 1, 500, *sorted(draw.randrange(size) for _ in range(12)), size - 1]
    path = tmp_path / "bank"
    failed = 0
    for room in rooms:
        with pytest.MonkeyPatch.context() as monkeypatch:
            disk = SmallDisk(monkeypatch, room)
            blocks = {each.name: each.read_bytes() for each in path.glob("scenes-*.parquet")}
            error = error_of_writing(path)
        # It is refused where something did not fit, and only there.
        assert (error is not None) == (disk.room < 0)
        if error is not None:
            failed += 1
            assert re.search(r"No space left.*making room on the disk", str(error))
        # What was there is still there, to the byte, and nothing half written is left.
        assert all((path / name).read_bytes() == data for name, data in blocks.items())
        assert not list(path.rglob("*.partial"))
    assert failed >= 4
    banks.write(path)
    assert_complete(path, whole)


def limit_file_size():
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))


def test_a_limit_of_the_real_system_is_explained(whole, tmp_path):
    # Blocks are larger than the limit, everything else is smaller.
    command = [sys.executable, "-m", "tests.helpers.banks", str(tmp_path / "bank"), "2"]
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, preexec_fn=limit_file_size, check=False
    )
    assert "File too large" in done.stderr
    assert "ulimit" in done.stderr
    banks.write(tmp_path / "bank")
    assert_complete(tmp_path / "bank", whole)


def test_a_second_writer_is_told_who_the_first_one_is(bank, whole, capsys):
    with banks.writer(bank, 512):
        with pytest.raises(BankError, match=f"process {os.getpid()} on") as caught:
            banks.writer(bank, 512)
        assert "waiting" in str(caught.value)
        # Readers are not in anybody's way.
        assert read_bank(bank).table.num_rows == 512
    assert_complete(bank, whole)
    # A lock file that nobody holds any more is nobody's lock.
    (bank / ".lock").write_text("{ of a machine that lost power")
    banks.write(bank)
    assert_complete(bank, whole)


def test_writers_that_race_take_turns(tmp_path, whole):
    path = tmp_path / "bank"
    with ProcessPoolExecutor(3, PROCESSES) as pool:
        racing = [pool.submit(banks.write, path) for _ in range(3)]
        errors = [each.exception() for each in racing]
    refused = [error for error in errors if error is not None]
    assert len(refused) < 3
    assert all("being written by" in str(error) for error in refused)
    assert_complete(path, whole)


STEPS = [
    *((Path, name) for name in ("is_dir", "exists", "iterdir", "unlink", "rmdir")),
    *((os, name) for name in ("mkdir", "open", "listdir", "stat", "lstat")),
    (fcntl, "flock"),
]
"""What looks at a bank's folder, or changes it, before the bank is begun."""


def at_step(patch, number, act):
    """From now on `act` is called before the step of this number; a list of how many there were so far."""
    count = [0]
    busy = []

    def step(call, *args, **kwargs):
        if not busy:
            count[0] += 1
            if count[0] == number:
                busy.append(True)
                act()
                busy.clear()
        return call(*args, **kwargs)

    for owner, name in STEPS:
        patch.setattr(owner, name, _stepped(owner, getattr(owner, name), step))
    # Once the bank is begun its folder is held.
    begin = BankWriter._begin

    def begun(*args):
        busy.append(True)
        return begin(*args)

    patch.setattr(BankWriter, "_begin", begun)
    return count


def _stepped(owner, call, step):
    # Called on a path, a function is given the path; those of modules are given nothing more.
    return (
        (lambda *args, **kwargs: step(call, *args, **kwargs))
        if owner is Path
        else partial(step, call)
    )


def write_whole(path, held):
    banks.write(path, 1)


def only_begin(path, held):
    held.append(banks.writer(path, BLOCK_SIZE))


def begin_and_fail(path, held):
    path.mkdir(exist_ok=True)
    FolderLock(path).release()
    with suppress(OSError):
        path.rmdir()


def refusal_of(call, errors):
    try:
        call()
    except BankError as error:
        errors.append(error)


@pytest.mark.parametrize("other", [write_whole, only_begin, begin_and_fail])
def test_a_writer_is_overtaken_at_each_step_of_its_beginning(tmp_path, other):
    """Whatever others do between two steps, a writer begins the bank, continues it, or is refused."""
    with pytest.MonkeyPatch.context() as patch:
        count = at_step(patch, 0, None)
        banks.write(tmp_path / "alone", 1)
    assert count[0] > 5
    for number in range(1, count[0] + 1):
        path = tmp_path / f"bank-{number}"
        held = []
        errors = []
        act = partial(refusal_of, partial(other, path, held), errors)
        with pytest.MonkeyPatch.context() as patch:
            at_step(patch, number, act)
            refusal_of(partial(banks.write, path, 1), errors)
        for each in held:
            each.close()
        assert len(errors) < 2
        assert all("is being written by" in str(error) for error in errors), (number, errors)
        banks.write(path, 1)
        assert_complete(path, tmp_path / "alone")


def test_what_another_has_just_begun_is_not_taken_for_something_else(tmp_path):
    path = tmp_path / "bank"
    (path / "assets").mkdir(parents=True)
    held = FolderLock(path)
    with pytest.raises(BankError, match="is being written by"):
        banks.writer(path, 512)
    held.release()
    with pytest.raises(BankError, match="is not a bank"):
        banks.writer(path, 512)


def test_a_killed_writer_loses_nothing(tmp_path):
    path = tmp_path / "bank"
    num_blocks = 60
    banks.write(tmp_path / "whole", num_blocks)
    draw = random.Random(2)
    kills = 0
    # Killed before the first block, and again whenever some more blocks are there, at any point of the next.
    for wanted in (0, 0, 1, 2, 8, 15, 30, 45):
        before = {each.name: each.read_bytes() for each in path.glob("scenes-*.parquet")}
        running = PROCESSES.Process(target=banks.write, args=(path, num_blocks))
        running.start()
        while (
            not (path / "bank.json").exists() or len(list(path.glob("scenes-*.parquet"))) < wanted
        ):
            assert running.is_alive()
            time.sleep(0.001)
        time.sleep(draw.uniform(0.0, 0.01))
        running.kill()
        running.join()
        kills += running.exitcode == -signal.SIGKILL
        assert all((path / name).read_bytes() == data for name, data in before.items())
        if wanted:
            # Whatever a killed writer leaves can be read as it is.
            assert read_bank(path).table.num_rows >= wanted * BLOCK_SIZE
    # A late one may have been done before the signal came.
    assert kills >= 4
    banks.write(path, num_blocks)
    assert_complete(path, tmp_path / "whole")


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_generate_killed_half_way_goes_on_to_the_same_bank(tmp_path):
    pool = write_pool(tmp_path / "trio", Pool("trio", tuple(trio())))
    more = [
        "--pool",
        str(pool),
        "--method",
        "random",
        "--num-objects",
        "2",
        "-n",
        "600",
        "--max-files",
        "0",
    ]
    assert main(["generate", "--out", str(tmp_path / "whole"), *more]) == 0
    command = [
        sys.executable,
        "-m",
        "cluttergen_jax",
        "generate",
        "--out",
        str(tmp_path / "bank"),
        *more,
    ]
    running = subprocess.Popen(command, cwd=ROOT)
    while running.poll() is None and not list((tmp_path / "bank").glob("scenes-*.parquet")):
        time.sleep(0.01)
    running.send_signal(signal.SIGKILL)
    assert running.wait() == -signal.SIGKILL
    assert read_bank(tmp_path / "bank").table.num_rows < 600
    assert main(["generate", "--out", str(tmp_path / "bank"), *more]) == 0
    assert read_bank(tmp_path / "bank").table.equals(read_bank(tmp_path / "whole").table)


def test_an_early_kill_leaves_a_folder_that_can_be_used(tmp_path, whole):
    (tmp_path / "bank").mkdir()
    (tmp_path / "bank" / ".lock").write_text("")
    (tmp_path / "bank" / ".bank.json.partial").write_text("{")
    banks.write(tmp_path / "bank")
    assert_complete(tmp_path / "bank", whole)


def test_a_place_that_cannot_be_written_is_explained(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(BankError):
        banks.write(tmp_path / "file" / "bank")
    with pytest.raises(BankError, match="name"):
        banks.write(tmp_path / ("x" * 300))


def test_a_write_that_fails_leaves_the_old_file(tmp_path):
    path = tmp_path / "file"
    write_atomically(path, b"old")
    with pytest.MonkeyPatch.context() as monkeypatch:
        SmallDisk(monkeypatch, 2)
        with pytest.raises(OSError, match="No space"):
            write_atomically(path, b"newer")
    assert path.read_bytes() == b"old"
    assert [each.name for each in tmp_path.iterdir()] == ["file"]


def test_placed_objects_have_finite_poses(tmp_path):
    table = banks.rows(0, 8).to_pylist()
    place = table[3]["is_placed"].index(True)
    table[3]["poses"][place][2] = float("nan")
    with banks.writer(tmp_path / "bank", 8) as bank:
        bank.write_block(0, pa.Table.from_pylist(table, schema=SCHEMA))
    with pytest.raises(BankError, match="not finite"):
        stats_of(read_bank(tmp_path / "bank"))


def test_stats_count_by_hand(bank, capsys):
    stats = stats_of(read_bank(bank))
    assert (stats.asked, stats.scenes, stats.success, stats.filled) == (512, 512, 384, 384)
    assert stats.verdicts == {"stable": 384, "displaced": 128}
    assert (stats.placed, stats.attempts) == (384 * 3 + 128 * 2, 384 * 4 + 128 * 8)
    tall = next(each for each in stats.objects if each.name == "tall")
    assert (tall.drawn, tall.placed, tall.attempts) == (512, 384, 384 + 128 * 5)
    assert stats.missing == stats.duplicates == ()
    assert main(["stats", str(bank)]) == 0
    assert "384 stable, 128 displaced" in capsys.readouterr().out
    assert main(["stats", str(bank), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["success"] == 384


def test_stats_report_what_is_missing_and_what_repeats(tmp_path):
    table = banks.rows(1, 20).to_pylist()
    # Scene 260 is 256 over again with its slots in another order; 261 differs in the last bit only.
    for name in (
        "objects",
        "poses",
        "object_index",
        "is_placed",
        "attempts",
        "steps",
        "rest_steps",
    ):
        table[4][name] = table[0][name][::-1]
        table[5][name] = json.loads(json.dumps(table[0][name]))
    table[5]["poses"][0][0] *= 1 + 2e-7
    with banks.writer(tmp_path / "bank", 600) as writer:
        writer.write_block(1, type(banks.rows(1)).from_pylist(table, schema=banks.rows(1).schema))
    bank = read_bank(tmp_path / "bank")
    stats = stats_of(bank)
    assert stats.missing == ((0, 255), (276, 599))
    assert stats.duplicates == ((256, 260),)
    assert "256 = 260" in stats_text(bank, stats)
    assert "0 to 255" in stats_text(bank, stats)


def test_card_says_what_is_there_and_respects_the_users_own(bank, capsys):
    assert main(["stats", str(bank), "--card"]) == 0
    text = (bank / CARD).read_text()
    for expected in (
        "512 cluttered",
        "384 (75.0%)",
        "| `poses` |",
        "Apache-2.0",
        "seed: 3",
        "`prism`",
    ):
        assert expected in text, expected
    assert str(bank.parent) not in text
    (bank / CARD).write_text("mine")
    assert main(["stats", str(bank), "--card"]) == 0
    assert "your own" in capsys.readouterr().out
    assert (bank / CARD).read_text() == "mine"
    assert write_card(read_bank(bank)) is None


def test_supports_have_a_digest_that_survives_the_disk(bank):
    table = cuboid_table()
    assert read_bank(bank).support.top == table.top
    other = replace(table, top=0.71)
    with pytest.raises(BankError, match="its support"):
        banks.BankWriter(bank, banks.RECIPE, 512, {a.name: a for a in trio()}, other)


def test_a_path_that_is_not_utf8_is_refused_before_anything_is_made(tmp_path, bank, capsys):
    """Arrow, MuJoCo and JSON cannot name it: scenes were made and then called damaged, again and again."""
    name = os.fsdecode(b"caf\xe9")
    out = str(tmp_path / name)
    assert main(["generate", "--num-scenes", "1", "--out", out]) == 2
    assert r"caf\xe9, which is not read as UTF-8" in capsys.readouterr().err
    assert not Path(out).exists()
    bank.rename(out)
    for use in (lambda: cg.verify(out), lambda: cg.load_bank(out), lambda: banks.writer(out, 3)):
        with pytest.raises(ConfigError, match="not read as UTF-8"):
            use()


def test_a_locale_without_utf8_refuses_what_it_cannot_read(tmp_path):
    variables = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    words = [sys.executable, "-m", "cluttergen_jax", "stats", str(tmp_path / "café")]
    done = subprocess.run(words, env=variables, capture_output=True, text=True)
    assert done.returncode == 2
    assert "which is not read as UTF-8" in done.stderr
    assert "PYTHONUTF8=1" in done.stderr
