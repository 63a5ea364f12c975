"""Banks of scenes made by hand: any bank's readers read them, and they grow scene by scene."""

import re
import shutil
import signal
import subprocess
import sys
import threading
import webbrowser
from dataclasses import replace

import jax
import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import BankError
from cluttergen_jax.generation import hand
from cluttergen_jax.generation.hand import HandBank, hand_setup
from cluttergen_jax.generation.sources import BankSource, viewing
from cluttergen_jax.placement.region import no_keep_out
from cluttergen_jax.placement.rules import empty_start
from cluttergen_jax.placement.setup import Setup
from cluttergen_jax.scene.bank import bank as reading
from cluttergen_jax.scene.bank import blocks, read_bank
from cluttergen_jax.scene.bank.stats import stats_of, stats_text
from cluttergen_jax.scene.bank.writer import BankWriter
from cluttergen_jax.spec import SceneSpec
from tests.helpers.problems import trio_problem

SEED = 7


@pytest.fixture(scope="module")
def setup():
    problem = trio_problem(history_stride=0, num_objects=2, min_margin=0.003)
    return Setup(problem, no_keep_out(), empty_start(3))


def opened(path, setup, **kinds):
    return HandBank(path, setup, (), SEED, **kinds)


def fill(bank, y=0.0):
    """A scene whose objects stand in a row; its poses."""
    scene = bank.begin()
    for place in range(len(scene.left)):
        scene.hold(0.15 * place - 0.1, y, 0.0)
        scene.lower()
        assert scene.drop().attempt.is_stable
    assert scene.check().verdict == 0
    return scene


def give_up(bank):
    """A scene of one object; the next was let go high up."""
    scene = bank.begin()
    scene.lower()
    scene.drop()
    scene.hold(0.15, 0.1, 0.0)
    scene.held = replace(scene.held, z=0.5)
    scene.drop()
    return scene


@pytest.fixture(scope="module")
def made(setup, tmp_path_factory):
    """A bank of a success, a failure and a success, and the poses that the scenes had."""
    path, kept = tmp_path_factory.mktemp("hand") / "bank", []
    with opened(path, setup) as bank:
        for scene in (fill, give_up, fill):
            scene = scene(bank)
            bank.keep(scene)
            kept.append((scene.all, scene.num_placed, scene.poses[scene.all], scene.clock.seconds))
        summary = bank.summary()
    return path, kept, summary


def test_the_rows_are_what_the_person_made(made):
    path, kept, _ = made
    bank = read_bank(path)
    assert bank.num_scenes == 3
    rows = bank.table.to_pylist()
    assert [row["index"] for row in rows] == [0, 1, 2]
    assert [row["is_success"] for row in rows] == [True, False, True]
    assert [row["is_filled"] for row in rows] == [True, False, True]
    names = bank.record["recipe"]["names"]
    for row, (everything, num_placed, poses, seconds) in zip(rows, kept, strict=True):
        assert row["objects"] == [names[k] for k in everything]
        assert row["is_placed"] == [k < num_placed for k in range(2)]
        np.testing.assert_array_equal(np.float32(row["poses"])[:num_placed], poses[:num_placed])
        assert row["seconds"] == np.float32(seconds) > 0
    assert rows[1]["attempts"] == [1, 1]
    assert rows[1]["verdict"] == "unsettled"
    assert rows[1]["num_unsettled"] == 1
    recipe = bank.record["recipe"]
    assert (recipe["method"], recipe["seed"], recipe["placement"]["min_margin"]) == ("hand", SEED, 0.003)
    # Nobody was asked to stop after so many.
    assert "max_attempts" not in recipe["placement"]


def test_every_reader_reads_it(made, tmp_path):
    path, _, summary = made
    assert "scenes     3, of which 2 succeed" in str(summary)
    report = cg.verify(path)
    assert report.is_sound
    assert [each.path.name for each in report.scenes] == ["000000.xml", "000002.xml"]
    stats = stats_of(read_bank(path))
    seconds = read_bank(path).table["seconds"].to_pylist()
    assert stats.hand_total == pytest.approx(sum(seconds))
    assert stats.hand_median == pytest.approx(np.median(seconds))
    text = stats_text(read_bank(path), stats)
    assert "made by hand with seed 7" in text
    assert "by hand    " in text
    assert "missing    nothing of the 3" in text
    cg.export(path, format="mjcf", out=tmp_path / "out")
    assert len(list((tmp_path / "out" / "scenes").glob("*.xml"))) == 2
    scene = jax.jit(cg.load_bank(path).reset)(jax.random.key(0))
    assert scene.is_placed.sum() == 2
    card = (path / "README.md").read_text()
    assert "| `seconds` | `float` | that the person who made the scene spent on it" in card
    assert "- method: hand" in card
    assert "- attempts per object: as many as were wanted" in card


def test_it_can_be_looked_at_but_its_attempts_are_nobodys(made):
    path, kept, _ = made
    source = BankSource(path)
    still = source.still(0)
    np.testing.assert_array_equal(still.poses, kept[0][2])
    with pytest.raises(BankError, match="made by hand: its attempts cannot be made again"):
        source.replay(0)
    # Others may place the same objects.
    assert source.methods == ("random", "clear", "drop", "spread")


def test_it_goes_on_where_it_ended_with_the_objects_that_come_next(made, setup, tmp_path):
    path, _, _ = made
    shutil.copytree(path, tmp_path / "bank")
    (tmp_path / "bank" / "scenes" / "000002.xml").unlink()
    with opened(tmp_path / "bank", setup) as bank:
        # What a killed writer left out is written.
        assert cg.verify(tmp_path / "bank").is_sound
        assert bank.num_kept == 3
        resumed = bank.begin()
        bank.keep(fill(bank, y=0.1))
    with opened(tmp_path / "other", setup) as bank:
        orders = []
        for _ in range(4):
            orders.append(bank.begin().all)
            bank.keep(give_up(bank))
    assert resumed.number == 3
    assert resumed.all == orders[3]
    assert len(set(map(tuple, orders))) > 1
    table = read_bank(tmp_path / "bank").table
    assert table.num_rows == read_bank(tmp_path / "bank").num_scenes == 4
    assert table.slice(0, 3).equals(read_bank(path).table)
    assert cg.verify(tmp_path / "bank").stands.tolist() == [True] * 3


def test_other_settings_do_not_go_on_with_it(made, setup):
    path, _, _ = made
    with pytest.raises(BankError, match="another seed"):
        HandBank(path, setup, (), SEED + 1)
    with pytest.raises(BankError, match="another keep_out"):
        HandBank(path, setup, [Rectangle((0.1, 0.1), (0.02, 0.02))], SEED)


def test_a_certificate_keeps_the_seconds_and_is_kept_when_scenes_are_added(made, setup, tmp_path):
    path, _, _ = made
    shutil.copytree(path, tmp_path / "bank")
    seconds = read_bank(path).table["seconds"]
    cg.certify(tmp_path / "bank", seconds=0.5)
    table = read_bank(tmp_path / "bank").table
    assert table["seconds"].equals(seconds)
    assert table["shake"].null_count == 1
    with opened(tmp_path / "bank", setup) as bank:
        bank.keep(fill(bank))
    grown = read_bank(tmp_path / "bank").table
    assert grown.slice(0, table.num_rows).equals(table)
    assert grown["shake"].null_count == 2
    cg.certify(tmp_path / "bank", seconds=0.5)
    assert read_bank(tmp_path / "bank").table["shake"].null_count == 1


def test_blocks_follow_one_another(setup, tmp_path, monkeypatch):
    for module in (hand, blocks, reading):
        monkeypatch.setattr(module, "BLOCK_SIZE", 2)
    for _ in range(2):
        with opened(tmp_path / "bank", setup) as bank:
            for _ in range(2):
                bank.keep(give_up(bank))
            bank.keep(fill(bank))
    table = read_bank(tmp_path / "bank").table
    assert table["index"].to_pylist() == list(range(6))
    assert table["is_success"].to_pylist() == [False, False, True] * 2
    assert len(list((tmp_path / "bank").glob("scenes-*.parquet"))) == 3


def test_a_scene_that_cannot_be_written_may_be_kept_later(setup, tmp_path, monkeypatch):
    with opened(tmp_path / "bank", setup) as bank:
        bank.keep(give_up(bank))
        scene, write = fill(bank), BankWriter.write_block

        def full(*_):
            raise BankError("the disk is full")

        monkeypatch.setattr(BankWriter, "write_block", full)
        with pytest.raises(BankError, match="the disk is full"):
            bank.keep(scene)
        # As after a writer that was killed: asked for, and not there.
        assert stats_of(read_bank(tmp_path / "bank")).missing == ((1, 1),)
        monkeypatch.setattr(BankWriter, "write_block", write)
        bank.keep(scene)
        assert scene.is_closed
    assert stats_of(read_bank(tmp_path / "bank")).missing == ()
    assert read_bank(tmp_path / "bank").table["is_success"].to_pylist() == [False, True]


def test_a_damaged_bank_is_not_written_over(made, setup, tmp_path):
    path, _, _ = made
    shutil.copytree(path, tmp_path / "bank")
    (block,) = (tmp_path / "bank").glob("scenes-*.parquet")
    data = block.read_bytes()
    block.write_bytes(data[:500] + bytes(200) + data[700:])
    damaged = block.read_bytes()
    with pytest.raises(BankError, match="made by hand cannot be made again"):
        opened(tmp_path / "bank", setup)
    assert block.read_bytes() == damaged
    # The lock is free again.
    block.write_bytes(data)
    opened(tmp_path / "bank", setup).close()


def test_an_empty_bank_says_so(setup, tmp_path):
    with opened(tmp_path / "bank", setup) as bank:
        bank.rehearse()
        assert bank.num_kept == 0
        assert "none was kept" in str(bank.summary())
    with pytest.raises(BankError, match="no scenes yet"):
        stats_of(read_bank(tmp_path / "bank"))


def test_the_problem_is_the_one_asked_for():
    box, region = Rectangle((0.1, 0.0), (0.02, 0.02)), Rectangle((0.0, 0.0), (0.15, 0.12), 0.1)
    given = {
        "pool": "dining",
        "num_objects": 2,
        "objects": ("mug", "bowl", "fork"),
        "exclude": (),
        "support": "table-0.40x0.40",
        "region": region,
        "containment": "footprint",
        "keep_out": [box],
        "min_margin": None,
        "overhang": "none",
        "repeat": False,
    }
    setup = hand_setup(SceneSpec(**given))
    placement = setup.problem.config.placement
    assert sorted(setup.problem.world.names) == ["bowl", "fork", "mug"]
    assert setup.problem.region == region
    assert placement == replace(
        placement, num_objects=2, containment="footprint", overhang="none", min_margin=0.003, ruin_after=0
    )
    np.testing.assert_allclose(setup.keep_out.center, [[0.1, 0.0]])
    assert hand_setup(SceneSpec(**given | {"min_margin": 0.0})).problem.config.placement.min_margin == 0


def test_options_of_the_two_uses_of_view_are_kept_apart(capsys):
    assert main(["view", "--region", "0.2x0.2"]) == 2
    assert "--region without --place" in capsys.readouterr().err
    assert main(["view", "--place", "--method", "drop"]) == 2
    assert "--method with --place" in capsys.readouterr().err


def test_an_unknown_pool_is_told_and_leaves_nothing_behind(tmp_path, capsys):
    pytest.importorskip("viser", reason="needs the extra viewer")
    assert (
        main(["view", "--place", "--pool", "no_such_pool", "--port", "0", "--out", str(tmp_path / "x")]) == 2
    )
    assert "no_such_pool" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


@pytest.mark.slow
def test_ctrl_c_ends_the_command_in_good_order(tmp_path):
    words = "view --place --objects mug bowl --num-objects 1 --support table-0.40x0.40 --port 0 --no-browser"
    command = [sys.executable, "-m", "cluttergen_jax", *words.split(), "--out", str(tmp_path / "bank")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as run:
        lines = []
        while not lines or not lines[-1].startswith("viewer"):
            lines.append(run.stdout.readline())
            assert lines[-1], lines
        run.send_signal(signal.SIGINT)
        rest = run.stdout.read()
        assert run.wait(60) == 0
    assert "scenes     none was kept" in rest
    assert read_bank(tmp_path / "bank").num_scenes == 1


@pytest.mark.slow
def test_a_session_ends_with_the_scenes_that_were_saved_and_the_next_adds_to_them(
    tmp_path, monkeypatch, request
):
    panels = []

    class Panel(viewing.PlacingPanel):
        def __init__(self, *given):
            super().__init__(*given)
            panels.append(self)

    def person(url):
        """Saves a scene, begins another, and goes."""

        def work():
            panel = panels[-1]
            try:
                for act in (panel.lower, panel.drop, panel.save, panel.new, panel.lower, panel.drop):
                    panel._worker.submit(panel._do, act).result()
            finally:
                signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)

        threading.Thread(target=work).start()

    monkeypatch.setattr(viewing, "PlacingPanel", Panel)
    monkeypatch.setattr(webbrowser, "open", person)
    # What a shell starts in the background ignores Ctrl-C.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, before))
    for number in (1, 2):
        told = []
        bank = cg.place_by_hand(
            tmp_path / "bank",
            objects=("mug", "bowl"),
            num_objects=1,
            support="table-0.40x0.40",
            port=0,
            show=told.append,
        )
        assert f"which holds {number - 1} scenes" in told[0]
        assert re.match(r"viewer     http://localhost:\d+/[\w-]{32}/ ", told[1])
        assert f"scenes     {number}, of which {number} succeed" in str(bank)
        assert bank.table["is_success"].to_pylist() == [True] * number
    assert cg.verify(tmp_path / "bank").is_sound
