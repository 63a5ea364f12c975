"""One writer at a time: what a command writes is held from its first check to its last write."""

import csv
import json
import os
import shlex
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from cluttergen_jax.assets import pool as pools
from cluttergen_jax.assets.object_files import object_hash
from cluttergen_jax.assets.pool import Pool, read_pool, user_root, write_pool
from cluttergen_jax.assets.support_file import user_supports
from cluttergen_jax.bank_reader import Bank
from cluttergen_jax.cli.main import COMMANDS, main
from cluttergen_jax.generation import hand
from cluttergen_jax.importing import cache, run, supports
from cluttergen_jax.kept_folder import FolderLock, lock_beside
from cluttergen_jax.learning.policies.embedded import pulled_root
from cluttergen_jax.rendering.viewer.viewer import _write_new
from tests.helpers import banks
from tests.helpers.imports import made_here
from tests.helpers.placing import seen_trio, write_bank
from tests.helpers.shapes import save_box
from tests.helpers.worlds import trio

OPTIONS = json.loads(Path(__file__).with_name("options.json").read_text())


@dataclass(frozen=True)
class Writing:
    """A command that writes: its words, and what it holds, in which {x} is x of the folder of the test.

    Attributes:
      is_beside: the lock's file lies beside what is held, which is made anew or is a single file.
    """

    words: str
    held: str = "{out}"
    is_beside: bool = False


WRITERS = {
    "generate": Writing("generate --pool {trio} --method random --num-objects 2 -n 1 --out {out}"),
    "certify": Writing("certify {bank}", "{bank}"),
    "stats": Writing("stats {bank} --card", "{bank}"),
    "push": Writing("push {bank} me/other --hub {hub}", "{bank}"),
    "pull": Writing("pull me/bank --hub {hub} --out {out}", is_beside=True),
    "pull policies": Writing("pull me/policies --hub {hub}", "{policies}"),
    "cut": Writing("cut {bank} --scenes 0 --out {out}"),
    "export": Writing("export {bank} --out {out}", is_beside=True),
    "export mjlab": Writing("export {bank} --format mjlab --out {out}", is_beside=True),
    "repair": Writing("repair {layout} --out {out}"),
    "repair json": Writing("repair {layout} --out {out}.json", "{out}.json", is_beside=True),
    "layout ask": Writing(
        "layout ask breakfast --model true --out {out}", "{out}.yaml", is_beside=True
    ),
    "render": Writing("render {bank} --no-picture --depth --out {out}"),
    "render bop": Writing("render {bank} --no-picture --bop --out {out}", "{out}/bop"),
    "judge": Writing("judge {scene} --seconds 0.1 --out {out}"),
    "dataset": Writing("dataset {bank} --no-colour --out {out}"),
    "dataset bop": Writing("dataset {bank} --no-colour --form bop --out {out}"),
    "train": Writing("train --pool {trio} --num-objects 2 --out {out}"),
    "train guided": Writing("train --variant guided --out {out}"),
    "pretrain": Writing("pretrain --out {out}"),
    "evaluate": Writing("evaluate --pools {trio} --methods random --num-objects 2 --out {out}"),
    "placer data": Writing("placer data {bank} --out {out}"),
    "placer train": Writing("placer train {out} --out {out}"),
    "placer eval": Writing("placer eval {out} --out {out}"),
    "robot grasps": Writing(
        "robot grasps {trio} --out {out}.parquet", "{out}.parquet", is_beside=True
    ),
    "robot place": Writing("robot place {bank} --out {out}", "{out}/place"),
    "robot place bank": Writing(
        "robot place --pool {trio} --num-objects 2 --out {out}", "{out}/bank"
    ),
    "robot record": Writing("robot record {bank} --out {out}"),
    "robot dataset": Writing("robot dataset {bank} --out {out}"),
    "robot check": Writing("robot check panda --picture {out}.png", "{out}.png", is_beside=True),
    "robot clear": Writing("robot clear {bank} --out {out}.json", "{out}.json", is_beside=True),
    "rearrange": Writing("rearrange --pool dining --out {out}", "{out}/paper"),
    "import": Writing("import {file} --pool new --time-limit 60", "{pools}/new", is_beside=True),
    "import add": Writing("import {file} --pool mine --add", "{pools}/mine", is_beside=True),
    "import support": Writing(
        "import --support {table} --name desk", "{supports}/desk", is_beside=True
    ),
    "pool pose": Writing("pool pose mine tall 1", "{pools}/mine", is_beside=True),
    "pool remove": Writing("pool remove mine", "{pools}/mine", is_beside=True),
    "inspect": Writing("inspect {trio} --out {out}.png", "{out}.png", is_beside=True),
}
READERS = {
    "verify": "reads; its one file, verification.json, is written whole, and the last one says what is so",
    "view": "reads; a screenshot gets a name of its own (`test_screenshots_get_names_of_their_own`)",
    "layout check": "reads",
    "layout schema": "reads",
    "list": "reads",
    "doctor": "reads",
}
"""Commands that hold nothing, and why."""


@pytest.fixture(scope="module")
def made_bank(tmp_path_factory):
    path = tmp_path_factory.mktemp("banks") / "bank"
    write_bank(path, 2)
    return path


@pytest.fixture
def places(tmp_path, home, monkeypatch, made_bank):
    """What the commands are given."""
    for module in (pools, supports):
        # What waits for others is refused at once here.
        monkeypatch.setattr(module, "PATIENCE", 0.0)
    found = {
        name: tmp_path / name
        for name in ("out", "bank", "hub", "layout.json", "cube.obj", "table.obj")
    }
    found = {name.partition(".")[0]: path for name, path in found.items()}
    shutil.copytree(made_bank, found["bank"])
    found |= {"pools": user_root(), "supports": user_supports(), "policies": pulled_root()}
    found["scene"] = tmp_path / "scene.xml"
    found["scene"].write_text(Bank(found["bank"]).xml(0))
    found["trio"] = write_pool(tmp_path / "trio", Pool("trio", tuple(trio())))
    write_pool(user_root() / "mine", Pool("mine", tuple(seen_trio())))
    for place in ("bank", "policies/dining-policy"):
        (found["hub"] / "me" / place).mkdir(parents=True)
    (found["hub"] / "me/policies/dining-policy/record.json").write_text("{}")
    (found["hub"] / "me/bank/bank.json").write_text("{}")
    record = {"pool": str(found["trio"]), "support": "table"}
    objects = [{"name": "box", "position": [0.0, 0.0, 0.75]}]
    found["layout"].write_text(json.dumps(record | {"objects": objects}))
    save_box(found["cube"])
    save_box(found["table"], 0.7)
    found["file"] = found["cube"]
    return found


def tree(*roots):
    """Every file and folder, and what files hold."""
    return {
        path: path.read_bytes() if path.is_file() else None
        for root in roots
        for path in sorted(root.rglob("*"))
        if "cache" not in path.parts
    }


@pytest.mark.parametrize("name", WRITERS)
def test_a_second_writer_is_refused_before_it_changes_anything(name, places, tmp_path, capsys):
    writing = WRITERS[name]
    held = Path(writing.held.format(**places))
    lock = lock_beside(held) if writing.is_beside else FolderLock(held)
    before = tree(tmp_path)
    assert main(shlex.split(writing.words.format(**places))) == 2
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert len(said) == 1
    assert f"is being written by process {os.getpid()} on" in said[0]
    assert tree(tmp_path) == before
    lock.release()


def test_every_command_that_writes_is_known():
    first = {name.split()[0] for name in WRITERS}
    assert first | {name.split()[0] for name in READERS} == set(COMMANDS)
    assert not first & READERS.keys()
    # Commands within a command.
    inner = {name for name in OPTIONS if " " in name}
    assert inner <= set(WRITERS) | set(READERS)
    assert not any("--out" in OPTIONS[name] for name in READERS if name != "view")


def test_what_comes_into_a_pool_while_an_import_works_is_kept(places, monkeypatch):
    """The pool was read before objects were made, and written after: what came meanwhile was lost."""
    make = run._make

    def make_late(*args):
        held = read_pool(user_root() / "mine")
        late = replace(held, objects=(*held.objects, replace(held.objects[0], name="late")))
        write_pool(user_root() / "mine", late, overwrite=True)
        return make(*args)

    monkeypatch.setattr(run, "_outcomes", made_here)
    monkeypatch.setattr(run, "_make", make_late)
    assert main(["import", str(places["file"]), "--pool", "mine", "--add"]) == 0
    assert set(read_pool(user_root() / "mine").names) == {"box", "prism", "tall", "late", "cube"}


def test_a_body_that_another_import_removes_from_the_cache_is_named(places, monkeypatch, capsys):
    make = run._make

    def make_in_vain(jobs, config):
        made = make(jobs, config)
        for job in jobs:
            cache.drop(job.key)
        return made

    monkeypatch.setattr(run, "_outcomes", made_here)
    monkeypatch.setattr(run, "_make", make_in_vain)
    assert main(["import", str(places["file"]), "--pool", "mine", "--add"]) == 1
    assert "cube: another import removed it from the cache meanwhile" in capsys.readouterr().err
    assert read_pool(user_root() / "mine").names == ("box", "prism", "tall")


def test_screenshots_get_names_of_their_own(tmp_path):
    paths = [_write_new(tmp_path, "a scene", bytes([number])) for number in range(3)]
    assert [path.read_bytes() for path in paths] == [b"\0", b"\1", b"\2"]


def test_scenes_by_hand_have_the_banks_owner(places):
    """`view --place` writes a bank as `generate` does."""
    assert hand.BankWriter is banks.BankWriter


def test_a_command_that_fails_leaves_no_folder(places, tmp_path, capsys):
    before = tree(tmp_path)
    for words in (
        "render {bank} --scenes 77 --out {out}/a/b",
        "train --pool nothing_of_this_name --out {out}/a/b",
        "placer train {hub} --out {out}/a/b",
        "evaluate --pools nothing_of_this_name --out {out}/a/b",
        "export {hub} --out {out}/a/b",
    ):
        assert main(shlex.split(words.format(**places))) == 2
        assert tree(tmp_path) == before, words
    capsys.readouterr()


def test_what_another_program_keeps_in_a_lock_file_stays(tmp_path):
    (tmp_path / ".lock").write_text("the lock of something else")
    with FolderLock(tmp_path):
        pass
    assert (tmp_path / ".lock").read_text() == "the lock of something else"


AT_ONCE = """
import sys, time
from pathlib import Path
from cluttergen_jax.cli.main import main
ready, go = map(Path, sys.argv[1:3])
ready.touch()
while not go.exists():
    time.sleep(0.001)
sys.exit(main(sys.argv[3:]))
"""


def run_at_once(tmp_path, *commands):
    """Runs command lines in processes that begin together: of each its status, and its errors."""
    go = tmp_path / "go"
    ready = [tmp_path / f"ready-{number}" for number in range(len(commands))]
    started = [
        subprocess.Popen(
            [sys.executable, "-c", AT_ONCE, str(mark), str(go), *shlex.split(words)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        for mark, words in zip(ready, commands, strict=True)
    ]
    while not all(mark.exists() for mark in ready):
        assert all(each.poll() is None for each in started)
        time.sleep(0.01)
    go.touch()
    said = [each.communicate()[1] for each in started]
    for mark in (go, *ready):
        mark.unlink()
    errors = [[line for line in text.splitlines() if line.startswith("error: ")] for text in said]
    return [(each.returncode, lines) for each, lines in zip(started, errors, strict=True)]


def assert_one_wins(results):
    """Or all, one after another."""
    assert any(status == 0 for status, _ in results)
    for status, errors in results:
        assert status in (0, 2), errors
        if status:
            assert len(errors) == 1
            assert " is being written by process " in errors[0] or " exists" in errors[0]


TWICE = {
    "generate": "generate --pool {trio} --method random --num-objects 2 -n 600 --max-files 0 --out {out}",
    "certify": "certify {bank} --seconds 0.1",
    "push": "push {bank} me/other --hub {hub}",
    "cut": "cut {bank} --scenes 1,0 --out {out}",
    "export": "export {bank} --out {out}",
    "repair": "repair {layout} --out {out}",
    "repair json": "repair {layout} --out {out}/one.json",
    "render": "render {bank} --no-picture --depth --segmentation --out {out}",
    "judge": "judge {scene} --seconds 0.1 --out {out}",
    "dataset": "dataset {bank} --no-colour --cameras free:2 --size 64x48 --out {out}",
    "pretrain": "pretrain --encoder set --num-shapes 2 --num-held-out 1 --num-epochs 1 --out {out}",
    "evaluate": "evaluate --pools {trio} --methods random --num-objects 2 --trials 8 --out {out}",
    "placer data": "placer data {bank} --num-pairs 4 --out {out}",
    "import support": "import --support {table} --name desk",
}
"""Commands that make equal files of equal words, but for what they say of when and how fast."""


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("name", TWICE)
def test_of_two_at_once_one_wins_or_both_do(name, places, tmp_path):
    alone = run_at_once(tmp_path, TWICE[name].format(**places | {"out": tmp_path / "alone"}))
    assert [status for status, _ in alone] == [0], alone
    words = TWICE[name].format(**places)
    assert_one_wins(run_at_once(tmp_path, words, words))
    # A run's state has files of names that are drawn.
    names = [
        sorted(each.relative_to(root) for each in root.rglob("*") if "state" not in each.parts)
        for root in (places["out"], tmp_path / "alone")
    ]
    assert names[0] == names[1]


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_two_trainings_at_once_leave_one_run(places, tmp_path):
    """Both said "done", one policy was lost, and progress.csv mixed both."""
    words = "train --pool {trio} --num-objects 2 --num-attempts 3200 --num-envs 16"
    words += " --eval-episodes 0 --out {out}"
    assert_one_wins(run_at_once(tmp_path, words.format(**places), words.format(**places)))
    with (places["out"] / "progress.csv").open() as file:
        updates = [float(row["update"]) for row in csv.DictReader(file)]
    assert updates == list(range(len(updates)))
    assert (places["out"] / "policy" / "weights.npz").is_file()


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_two_imports_into_one_pool_lose_no_object(places, tmp_path):
    """Both ended with 0, and one object was gone."""
    save_box(tmp_path / "other.obj", 0.04)
    save_box(tmp_path / "third.obj", 0.03)
    names = ("cube", "other", "third")
    words = [f"import {tmp_path / name}.obj --pool mine --add" for name in names]
    assert [status for status, _ in run_at_once(tmp_path, *words)] == [0, 0, 0]
    assert set(read_pool(user_root() / "mine").names) == {"box", "prism", "tall", *names}
    # A new pool is whose comes first; the other one's bodies are in the cache.
    words = [f"import {tmp_path / name}.obj --pool new" for name in names]
    results = run_at_once(tmp_path, *words)
    assert_one_wins(results)
    assert (
        [status for status, _ in results].count(0) == len(read_pool(user_root() / "new").names) == 1
    )


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_changes_of_one_pool_at_once_are_all_made(places, tmp_path):
    words = [
        "pool pose mine tall 1",
        "pool pose mine box 1",
        f"import {places['file']} --pool mine --add",
    ]
    before = read_pool(user_root() / "mine")
    assert [status for status, _ in run_at_once(tmp_path, *words)] == [0, 0, 0]
    after = read_pool(user_root() / "mine")
    assert after.names == (*before.names, "cube")
    changed = [
        name for name in before.names if object_hash(before[name]) != object_hash(after[name])
    ]
    assert changed == ["box", "tall"]
    results = run_at_once(tmp_path, "pool remove mine", "pool remove mine")
    assert sorted(status for status, _ in results) == [0, 2]
    assert "is not among your own" in "".join(error for _, errors in results for error in errors)
